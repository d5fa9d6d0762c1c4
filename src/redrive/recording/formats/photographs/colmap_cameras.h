// SPDX-License-Identifier: Apache-2.0
// Camera models of COLMAP (src/colmap/sensor/models.h) as calibrations. COLMAP's principal point
// counts from the image's corner, so the first pixel's centre is at 0.5; ours is at 0.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/camera/calibration.h"

namespace redrive::colmap {

/// A line of cameras.txt, or a record of cameras.bin.
struct CameraRecord {
  std::int64_t id = 0;
  int model_id = 0;
  std::int64_t width = 0, height = 0;
  std::vector<double> params;
};

struct CameraModel {
  int id;
  std::string_view name;
  std::string_view redrive;                  ///< CameraModelInfo::name
  std::vector<std::string_view> parameters;  ///< "f" or "fx" and "fy", "cx", "cy", ours by name
};

/// The models that redrive has, those with fewer parameters first.
const std::vector<CameraModel>& camera_models();
/// Null if there is none.
const CameraModel* find_camera_model(std::string_view name);
const CameraModel* find_camera_model(int id);
/// "SIMPLE_PINHOLE, PINHOLE, ...", for messages.
std::string camera_model_names();

/// Returns the calibration, without name and extrinsics, of a record whose model is known and which
/// has as many parameters as the model. InputError names camera, parameter and value: sizes, focal
/// lengths and parameters out of range.
CameraCalibration to_calibration(const CameraRecord& record, const std::filesystem::path& file);

/// Returns the record of the model with the fewest parameters that is exactly this camera, or
/// nothing if COLMAP has none. Extrinsics and times are not part of it.
std::optional<CameraRecord> to_record(const CameraCalibration& calibration);

}  // namespace redrive::colmap
