// SPDX-License-Identifier: Apache-2.0
// Poses of a COLMAP model by its rigs and frames (COLMAP 3.12 and later): an image's pose is
// sensor_from_rig rig_from_world. images.txt and images.bin repeat that, and COLMAP 4.2.0 leaves
// stale poses there after it adjusted rigs.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string_view>
#include <vector>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/photographs/colmap_files.h"

namespace redrive::colmap {

/// An entry of rigs.txt or rigs.bin; sensors other than cameras are left out.
struct RigRecord {
  std::int64_t id = 0;
  /// By camera: the identity of the reference one, nothing where the file knows no pose.
  std::map<std::int64_t, std::optional<Rigid3d>> camera_from_rig;
};

/// An entry of frames.txt or frames.bin.
struct FrameRecord {
  std::int64_t id = 0, rig_id = 0;
  Rigid3d rig_from_world;
  std::map<std::int64_t, std::int64_t> camera_of_image;  ///< key: image
};

// InputError as the parsers of recording/formats/photographs/colmap_files.h.
std::vector<RigRecord> parse_rigs_text(std::string_view text, const std::filesystem::path& file);
std::vector<RigRecord> parse_rigs_binary(std::string_view bytes, const std::filesystem::path& file);
std::vector<FrameRecord> parse_frames_text(std::string_view text,
                                           const std::filesystem::path& file);
std::vector<FrameRecord> parse_frames_binary(std::string_view bytes,
                                             const std::filesystem::path& file);

/// Replaces the poses of images that differ from their rigs' poses by more than rounding: 0.001
/// degrees, or 1e-5 of the cameras' extent. A finding counts them.
void take_poses_of_rigs(const std::vector<RigRecord>& rigs, const std::vector<FrameRecord>& frames,
                        std::vector<ImageRecord>* images, std::vector<Finding>* findings);

}  // namespace redrive::colmap
