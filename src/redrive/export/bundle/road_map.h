// SPDX-License-Identifier: Apache-2.0
// The driven way as an OpenDRIVE 1.7 map (ASAM): a road for each stretch that was driven forward,
// with the lane that was driven and those beside it.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/math/wgs84.h"

namespace redrive {

/// Shorter stretches are left out.
constexpr double kShortestRoad_m = 5;

/// A LiDAR return in the map.
struct MapReturn {
  Eigen::Vector3d position;
  double intensity = 0;
};

/// A place where a vehicle moves, in the map.
struct MapVehicle {
  std::int64_t id = 0;
  Eigen::Vector2d position, velocity;
};

struct RoadMapInput {
  std::string name;
  std::vector<Rigid3d> driven;          ///< poses of the body in the map, in driving order
  std::vector<Eigen::Vector3d> ground;  ///< points of the ground in the map; may be empty
  std::vector<MapReturn> returns;       ///< LiDAR returns in the map; may be empty
  std::vector<MapVehicle> vehicles;     ///< several places of each; may be empty
  std::optional<Geodetic> origin;       ///< place of the map, with x to the east; height 0
};

struct RoadMap {
  std::string xml;              ///< empty: no stretch is long enough
  int roads = 0, measured = 0;  ///< measured: roads whose lane lies between markings or kerbs
  int left = 0, right = 0;      ///< roads with a lane beside the driven one
  double length_m = 0;
  double deviation_m = 0;  ///< greatest distance of a pose from its road
  double reversed_m = 0;   ///< driven backwards, which is left out
};

/// Roads follow the poses by fit_way. A stretch ends where the body goes back by half a metre;
/// standstill and jitter add nothing. Elevation and superelevation come from the ground beside the
/// way, or from the poses where it has too few points or lies more than 10 cm or 2.3 degrees off.
/// Lanes come from export/bundle/find_lanes.h. The lane to the left goes the other way, unless most
/// vehicles seen there go along; the one to the right goes along.
RoadMap make_road_map(const RoadMapInput& input);

}  // namespace redrive
