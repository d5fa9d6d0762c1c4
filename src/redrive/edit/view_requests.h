// SPDX-License-Identifier: Apache-2.0
// POSES.json, the views to render.
//   {"calibration": {as calibration.json, optional}, "images": [{"file", "camera", "frame_id",
//    "RT_ECEF_body" and/or "shift_body_m": [x, y, z]}]}
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Longest accepted shift along an axis; beyond it floats lose millimetres.
constexpr double kMaxShift_m = 1e4;

struct RequestedView {
  std::string file;  ///< output name, relative, no "..", ends in .png, .jpg or .jpeg
  std::string camera;
  std::int64_t frame_id = 0;
  std::optional<Rigid3d> global_from_body;      ///< places the body absolutely
  std::optional<Eigen::Vector3d> shift_body_m;  ///< moves the run's own pose of frame_id
};

struct ViewRequests {
  std::filesystem::path path;
  std::vector<CameraCalibration> cameras;  ///< empty: the run's own
  std::vector<RequestedView> views;        ///< every one has a pose, a shift or both
};

ViewRequests parse_view_requests(std::string_view text, const std::filesystem::path& file);
ViewRequests read_view_requests(const std::filesystem::path& file);

}  // namespace redrive
