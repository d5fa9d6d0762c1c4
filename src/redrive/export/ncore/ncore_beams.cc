// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/ncore/ncore_beams.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <ranges>

#include "redrive/recording/lidar/scan_structure.h"

namespace redrive::ncore {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kFullTurn_rad = 2 * std::numbers::pi;

double azimuth_rad(const Rigid3d& body_from_lidar, const Eigen::Vector3f& in_body) {
  const Eigen::Vector3d p = body_from_lidar.inverse(Eigen::Isometry) * in_body.cast<double>();
  return std::atan2(p.y(), p.x());
}

}  // namespace

BeamModel::BeamModel(const LidarSensor& sensor, const Rigid3d& body_from_lidar,
                     std::span<const LidarPoint> points)
    : sensor_(sensor), body_from_lidar_(body_from_lidar) {
  const std::vector<std::uint8_t> beams = beams_of(points, body_from_lidar, sensor);
  std::optional<std::size_t> first;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (beams[i] != kNoRing && (!first || points[i].t_ns < points[*first].t_ns)) first = i;
  if (first)
    start_rad_ = azimuth_rad(body_from_lidar, points[*first].in_body_m) -
                 sensor.beams[beams[*first]].azimuth_rad;
}

Json BeamModel::json() const {
  const double step_rad = kFullTurn_rad / sensor_.azimuth_steps * (sensor_.clockwise ? -1 : 1);
  Json elevations = Json::array(), offsets = Json::array(), azimuths = Json::array();
  for (const LidarBeam& beam : std::views::reverse(sensor_.beams)) {
    elevations.push_back(beam.elevation_rad);
    offsets.push_back(beam.azimuth_rad);
  }
  for (int j = 0; j < sensor_.azimuth_steps; ++j)
    azimuths.push_back(std::remainder(start_rad_ + j * step_rad, kFullTurn_rad));
  return {{"type", "row-offset-spinning"},
          {"parameters",
           {{"spinning_frequency_hz", sensor_.rate_hz},
            {"spinning_direction", sensor_.clockwise ? "cw" : "ccw"},
            {"n_rows", sensor_.beams.size()},
            {"n_columns", sensor_.azimuth_steps},
            {"row_elevations_rad", elevations},
            {"column_azimuths_rad", azimuths},
            {"row_azimuth_offsets_rad", offsets}}}};
}

std::uint16_t BeamModel::column_of(const Eigen::Vector3f& in_body, std::uint8_t beam) const {
  const double left = azimuth_rad(body_from_lidar_, in_body) - sensor_.beams[beam].azimuth_rad -
                      start_rad_,
               turns = (sensor_.clockwise ? -left : left) / kFullTurn_rad;
  const long column = std::lround((turns - std::floor(turns)) * sensor_.azimuth_steps);
  return static_cast<std::uint16_t>(column % sensor_.azimuth_steps);
}

std::vector<std::uint16_t> BeamModel::elements(std::span<const LidarPoint> points) const {
  const std::vector<std::uint8_t> beams = beams_of(points, body_from_lidar_, sensor_);
  std::vector<std::uint16_t> elements;
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (beams[i] == kNoRing) return {};
    elements.push_back(static_cast<std::uint16_t>(sensor_.beams.size() - 1 - beams[i]));
    elements.push_back(column_of(points[i].in_body_m, beams[i]));
  }
  return elements;
}

}  // namespace redrive::ncore
