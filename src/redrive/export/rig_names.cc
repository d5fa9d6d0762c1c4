// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/rig_names.h"

#include <cmath>
#include <numbers>
#include <set>
#include <utility>

namespace redrive {
namespace {

/// Degrees between a camera's axis and a heading, in the plane.
double apart_deg(const CameraCalibration& camera, const RigPlace& place) {
  const Eigen::Vector3d axis = camera.body_from_sensor.linear().col(2);
  const double heading_deg = std::atan2(axis.y(), axis.x()) * 180 / std::numbers::pi;
  return std::abs(std::remainder(heading_deg - place.heading_deg, 360.0));
}

}  // namespace

std::vector<std::string> names_in_rig(
    const std::vector<RecordedCamera>& cameras, std::span<const RigPlace> rig,
    const std::function<std::string(const std::string&)>& own_name) {
  constexpr double kMost_deg = 30;
  std::vector<std::string> names(cameras.size());
  std::set<std::string> taken;
  for (std::size_t c = 0; c < cameras.size(); ++c)
    for (const RigPlace& place : rig)
      if (cameras[c].calibration.name == place.name) taken.insert(names[c] = place.name);
  while (true) {  // the nearest pair of a camera and a place
    double least_deg = kMost_deg;
    std::pair<std::size_t, const char*> nearest{cameras.size(), nullptr};
    for (std::size_t c = 0; c < cameras.size(); ++c)
      for (const RigPlace& place : rig)
        if (const double deg = apart_deg(cameras[c].calibration, place);
            names[c].empty() && !taken.contains(place.name) && deg < least_deg) {
          least_deg = deg;
          nearest = {c, place.name};
        }
    if (!nearest.second) break;
    taken.insert(names[nearest.first] = nearest.second);
  }
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    if (!names[c].empty()) continue;
    const std::string own = own_name(cameras[c].calibration.name);
    std::string name = own;
    for (int n = 2; taken.contains(name); ++n) name = own + "_" + std::to_string(n);
    taken.insert(names[c] = name);
  }
  return names;
}

}  // namespace redrive
