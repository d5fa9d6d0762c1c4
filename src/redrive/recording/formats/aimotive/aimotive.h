// SPDX-License-Identifier: Apache-2.0
// The aiMotive layout (Matuszka et al., arXiv:2211.09445): sensor/calibration/calibration.json
// (recording/formats/calibration_json.h), sensor/gnssins/egomotion2.json or egomotion.json
// (recording/formats/egomotion_json.h), sensor/camera/<CAM>/<CAM>_<7-digit id>.jpg,
// dynamic/box/3d_body (recording/formats/aimotive/aimotive_boxes.h), dynamic/raw-revolutions
// (recording/lidar/las.h). Made recordings also have sensor/calibration/calibration_true.json and
// sensor/gnssins/egomotion2_true.json: the same files without errors.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "redrive/recording/formats/recording_reader.h"

namespace redrive::aimotive {

bool looks_like(const std::filesystem::path& root);
Recording open(const std::filesystem::path& root, PoseSource source);
/// `frames`: sorted by id; LiDAR returns whose file has no times have their frame's.
std::shared_ptr<const RecordingReader> make_reader(std::vector<FramePose> frames = {});

}  // namespace redrive::aimotive
