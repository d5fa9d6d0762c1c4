// SPDX-License-Identifier: Apache-2.0
// The relative brightness of the blocks of a divided run (train/files/blocks.h). A block explains
// an image as its field's colours times the gains of the image's camera and time (Trainee,
// Exposure), so its field is known up to a factor for each camera and channel, which the
// regularisers choose. Frames that two blocks share give the quotient of both factors.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/model/trainee.h"
#include "redrive/scene/lidar/lidar_gains.h"
#include "redrive/train/files/blocks.h"

namespace redrive {

using LogGains = std::array<double, 3>;  ///< natural logarithms of factors of r, g, b

/// log_gains[block][camera]: exp of them, times what the block renders with gains of 1, has the
/// same brightness in all blocks. So where block B is to be rendered as the camera exposed it at a
/// time that block A trained on: B's image with gains of 1, times exp(log gains of B +
/// image_log_gains of A's model at that time - log gains of A). They sum to 0 over the blocks of
/// each group that shares frames; 0 where no shared frame determines them. Shading
/// (field/shading.h) is no part of them.
struct SeamExposure {
  std::vector<std::string> cameras;              ///< in the order of names
  std::vector<std::vector<LogGains>> log_gains;  ///< [block of blocks.json][camera]
  /// Gains of the recording's LiDARs, by which all blocks' intensities are multiplied; empty: not
  /// known.
  std::vector<LidarGains> lidar_gains = {};

  int camera_index(const std::string& name) const;  ///< -1 if there is none
  /// Returns 0 for an unknown camera.
  LogGains of(std::size_t block, const std::string& camera) const;
};

/// Log gains of one image in two blocks that share its frame.
struct SharedImage {
  int camera = 0;  ///< index of SeamExposure::cameras
  int block_a = 0, block_b = 0;
  LogGains log_gains_a, log_gains_b;  ///< image_log_gains of their models
};

/// Solves for the log gains by least squares over the shared images, minimal in their sum of
/// squares where these leave a choice.
SeamExposure solve_seam_exposure(std::vector<std::string> cameras, int blocks,
                                 const std::vector<SharedImage>& images);

/// Returns the log gains that a model has trained for a camera of its run's rig at a time; 0 of
/// models without any.
LogGains image_log_gains(Trainee& model, const Exposure& exposure);

std::filesystem::path exposure_file(const std::filesystem::path& run);
/// Reads exposure.json; with all log gains 0 and no cameras if there is no such file yet.
/// InputError naming file, field and value.
SeamExposure read_seam_exposure(const std::filesystem::path& run, std::size_t blocks);
void write_seam_exposure(const std::filesystem::path& run, const SeamExposure& exposure);
/// Parses and makes the bytes of exposure.json; `file` is for messages.
SeamExposure parse_seam_exposure(std::string_view bytes, const std::filesystem::path& file,
                                 std::size_t blocks);
std::string seam_exposure_text(const SeamExposure& exposure);

}  // namespace redrive
