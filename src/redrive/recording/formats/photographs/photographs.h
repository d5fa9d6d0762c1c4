// SPDX-License-Identifier: Apache-2.0
// Shared by all formats of posed photographs: no clock, no metre, and a body that is the camera.
#pragma once

#include <filesystem>
#include <string>

#include "redrive/recording/core/recording.h"

namespace redrive::photographs {

constexpr std::int64_t kFrameTime_ns = 1'000'000'000;  ///< Recording::metric
/// Maximum distance of a camera or a point from the origin, in any unit; as for ECEF in metres.
constexpr double kMaxDistance = 1e7;

/// Columns: the camera's x (right), y (down) and z (forward) in body axes x forward, y left, z up.
inline Rigid3d body_from_camera() {
  Rigid3d body_from_camera = Rigid3d::Identity();
  body_from_camera.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  return body_from_camera;
}

/// Changes a pose between OpenGL's camera axes (x right, y up, z backward) and ours (x right, y
/// down, z forward), either way.
inline Rigid3d with_opengl_axes(Rigid3d world_from_camera) {
  world_from_camera.linear().rightCols<2>() *= -1;
  return world_from_camera;
}

/// Scales the intrinsics of cameras whose images all have another size of the calibration's aspect,
/// to a pixel: they were made smaller after calibration. A finding says so.
void fit_to_images(Recording* recording);

/// Returns the image that a file of other software names: by the whole name, relative to `folder`,
/// else below it by the name's last parts, with the extension in another case or one of the usual
/// extensions added. Empty if there is none.
std::filesystem::path find_image(const std::filesystem::path& folder, const std::string& name);

/// Adds a finding that names images which find_image found elsewhere, if there are any.
void note_found_elsewhere(const std::vector<std::string>& images, std::vector<Finding>* findings);

/// Throws InputError for a recording without any of its images; `first` is the name of one.
[[noreturn]] void refuse_without_images(const std::filesystem::path& folder,
                                        const std::string& first);
/// A finding lists the clouds of points in the folders that are not `read`.
void report_unread_points(const std::vector<std::filesystem::path>& folders,
                          const std::filesystem::path& read, std::vector<Finding>* findings);

inline Recording empty_recording(const std::filesystem::path& root) {
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  recording.metric = false;
  return recording;
}

}  // namespace redrive::photographs
