// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/road_map.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <sstream>

#include <Eigen/QR>
#include <pugixml.hpp>

#include "redrive/export/bundle/find_lanes.h"
#include "redrive/export/bundle/fit_way.h"
#include "redrive/math/angles.h"

namespace redrive {
namespace {

using Eigen::Vector2d, Eigen::Vector3d;

// A pose belongs to the way if it is this far ahead of the one before; a way ends that far back.
constexpr double kAhead_m = 0.2, kBack_m = 0.5;
constexpr double kStation_m = 4;  // between heights along a road
// Ground that is further from what the poses say is a fault of its surface.
constexpr double kMostHeight_m = 0.1, kMostRoll_rad = 0.04;

/// Poses of a stretch that was driven forward.
using Stretch = std::vector<Rigid3d>;

std::vector<Stretch> forward_stretches(const std::vector<Rigid3d>& driven, double* reversed_m) {
  std::vector<Stretch> stretches;
  bool forward = false;
  const Rigid3d* anchor = nullptr;
  for (const Rigid3d& pose : driven) {
    if (!anchor) anchor = &pose;
    const Vector3d in_body =
        anchor->linear().transpose() * (pose.translation() - anchor->translation());
    const double ahead_m = in_body.x(), beside_m = std::abs(in_body.y());
    if (ahead_m >= (forward ? kAhead_m : kBack_m) && beside_m <= ahead_m) {
      if (!forward) stretches.push_back({*anchor});
      forward = true;
      stretches.back().push_back(pose);
      anchor = &pose;
    } else if (ahead_m <= (forward ? -kBack_m : -kAhead_m)) {
      forward = false;
      *reversed_m += -ahead_m;
      anchor = &pose;
    }
  }
  return stretches;
}

/// Points of the ground by squares of the plane.
class Ground {
 public:
  explicit Ground(std::span<const Vector3d> points) {
    for (const Vector3d& point : points) cells_[cell_of(point.head<2>())].push_back(point);
  }

  struct Plane {
    double height_m = 0, across = 0;  ///< across: rise to the left by distance
  };
  /// Returns the ground around a place of a road; nothing where it has too few points.
  std::optional<Plane> at(const PlanPose& place) const {
    constexpr double kReach_m = 2;
    constexpr int kRounds = 2;
    constexpr double kOutlier_m = 0.1;
    constexpr std::size_t kFewest = 20;
    const Vector2d ahead = place.ahead(), left(-ahead.y(), ahead.x());
    std::vector<Vector3d> near;  // along, across, height
    const Cell middle = cell_of(place.position());
    for (int x = -3; x <= 3; ++x)
      for (int y = -3; y <= 3; ++y) {
        const auto cell = cells_.find({middle.first + x, middle.second + y});
        if (cell == cells_.end()) continue;
        for (const Vector3d& point : cell->second) {
          const Vector2d from = point.head<2>() - place.position();
          const Vector3d local(from.dot(ahead), from.dot(left), point.z());
          if (local.head<2>().cwiseAbs().maxCoeff() <= kReach_m) near.push_back(local);
        }
      }
    Vector3d plane = Vector3d::Zero();  // height, slopes along and across
    for (int round = 0; round < kRounds; ++round) {
      if (round > 0)
        std::erase_if(near, [&](const Vector3d& p) {
          return std::abs(p.z() - plane.dot(Vector3d(1, p.x(), p.y()))) > kOutlier_m;
        });
      if (near.size() < kFewest) return std::nullopt;
      Eigen::MatrixXd terms(near.size(), 3);
      Eigen::VectorXd heights(near.size());
      for (std::size_t i = 0; i < near.size(); ++i) {
        const auto row = static_cast<Eigen::Index>(i);
        terms.row(row) << 1, near[i].x(), near[i].y();
        heights[row] = near[i].z();
      }
      plane = terms.colPivHouseholderQr().solve(heights);
    }
    return Plane{plane[0], plane[2]};
  }

 private:
  using Cell = std::pair<int, int>;
  static Cell cell_of(const Vector2d& at) {
    return {static_cast<int>(std::floor(at.x())), static_cast<int>(std::floor(at.y()))};
  }
  std::map<Cell, std::vector<Vector3d>> cells_;
};

/// A stretch with its pieces.
struct Road {
  std::vector<PlanPiece> pieces;
  std::vector<double> begin_m;  ///< where each piece begins along the road
  double length_m = 0, deviation_m = 0;
  std::vector<double> pose_m;  ///< place of each pose along the road

  PlanPose at(double along_m) const {
    const auto after = std::ranges::upper_bound(begin_m, along_m);
    const auto k =
        static_cast<std::size_t>(std::max<std::ptrdiff_t>(0, after - begin_m.begin() - 1));
    return pieces[k].at(along_m - begin_m[k]);
  }
};

Road road_of(const Stretch& stretch) {
  Road road;
  std::vector<Vector2d> points;
  for (const Rigid3d& pose : stretch) points.emplace_back(pose.translation().head<2>());
  road.pieces = fit_way(points);
  for (const PlanPiece& piece : road.pieces) {
    road.begin_m.push_back(road.length_m);
    road.length_m += piece.length_m;
  }
  std::size_t piece = 0;  // poses lie on the pieces in their order
  for (const Vector2d& point : points) {
    Foot foot = foot_on(road.pieces[piece], point);
    while (piece + 1 < road.pieces.size()) {
      const Foot next = foot_on(road.pieces[piece + 1], point);
      if (next.distance_m > foot.distance_m) break;
      foot = next;
      ++piece;
    }
    road.deviation_m = std::max(road.deviation_m, foot.distance_m);
    road.pose_m.push_back(road.begin_m[piece] + foot.along_m);
  }
  return road;
}

/// Height and roll (left side up) along a road.
struct Station {
  double along_m = 0, height_m = 0, roll_rad = 0;
};

/// Returns a value of the poses around a place: their mean, weighted by a triangle.
template <class Value>
double mean_near(const Road& road, const Stretch& stretch, double along_m, const Value& value) {
  double sum = 0, weights = 0;
  for (std::size_t i = 0; i < stretch.size(); ++i) {
    const double weight = std::max(1e-6, 1 - std::abs(road.pose_m[i] - along_m) / kStation_m);
    sum += weight * value(stretch[i]);
    weights += weight;
  }
  return sum / weights;
}

std::vector<Station> stations_of(const Road& road, const Stretch& stretch, const Ground& ground) {
  const int parts = std::max(1, static_cast<int>(std::lround(road.length_m / kStation_m)));
  std::vector<Station> stations;
  for (int i = 0; i <= parts; ++i) {
    Station station{road.length_m * i / parts};
    station.height_m = mean_near(road, stretch, station.along_m,
                                 [](const Rigid3d& pose) { return pose.translation().z(); });
    station.roll_rad = mean_near(road, stretch, station.along_m, [](const Rigid3d& pose) {
      return std::asin(std::clamp(pose.linear()(2, 1), -1.0, 1.0));
    });
    const auto plane = ground.at(road.at(station.along_m));
    if (plane && std::abs(plane->height_m - station.height_m) <= kMostHeight_m &&
        std::abs(std::atan(plane->across) - station.roll_rad) <= kMostRoll_rad) {
      station.height_m = plane->height_m;
      station.roll_rad = std::atan(plane->across);
    }
    stations.push_back(station);
  }
  return stations;
}

/// Returns the returns of the ground near a road.
std::vector<WayReturn> returns_beside(const Road& road, const std::vector<Station>& stations,
                                      std::span<const MapReturn> returns) {
  constexpr double kSample_m = 0.5, kReach_m = kLanesReach_m;
  constexpr double kHeight_m = 0.2, kCamber = 0.04;  // the road falls off to both sides
  struct Sample {
    double along_m;
    PlanPose place;
  };
  using Cell = std::pair<int, int>;
  const auto cell_of = [](const Vector2d& at) {
    return Cell{static_cast<int>(std::floor(at.x() / kReach_m)),
                static_cast<int>(std::floor(at.y() / kReach_m))};
  };
  std::map<Cell, std::vector<Sample>> samples;
  for (double s = 0; s <= road.length_m; s += kSample_m) {
    const PlanPose place = road.at(s);
    const auto [x0, y0] = cell_of(place.position());
    for (int x = x0 - 1; x <= x0 + 1; ++x)
      for (int y = y0 - 1; y <= y0 + 1; ++y) samples[{x, y}].push_back({s, place});
  }
  std::vector<WayReturn> beside;
  for (const MapReturn& one : returns) {
    const Vector2d at = one.position.head<2>();
    const auto cell = samples.find(cell_of(at));
    if (cell == samples.end()) continue;
    const Sample& nearest = *std::ranges::min_element(cell->second, {}, [&](const Sample& sample) {
      return (sample.place.position() - at).squaredNorm();
    });
    const Vector2d from = at - nearest.place.position(), ahead = nearest.place.ahead();
    const double along_m = nearest.along_m + from.dot(ahead),
                 across_m = from.dot(Vector2d(-ahead.y(), ahead.x()));
    const auto next = std::ranges::lower_bound(stations, along_m, {}, &Station::along_m);
    const Station& station = next == stations.end() ? stations.back() : *next;
    const double height_m = station.height_m + across_m * std::tan(station.roll_rad);
    // Between two stations the height changes by their slope.
    const Station& before = next == stations.begin() ? station : *std::prev(next);
    const double rise = station.along_m > before.along_m ? (station.height_m - before.height_m) /
                                                               (station.along_m - before.along_m)
                                                         : 0;
    const double above_m = one.position.z() - height_m - rise * (along_m - station.along_m);
    if (std::abs(across_m) <= kReach_m &&
        std::abs(above_m) <= kHeight_m + kCamber * std::abs(across_m))
      beside.push_back({along_m, across_m, above_m, one.intensity});
  }
  return beside;
}

/// Returns whether most vehicles on the lane to the left go along; nothing where there are none.
std::optional<bool> left_goes_along(const Road& road, const Lanes& lanes,
                                    std::span<const MapVehicle> vehicles) {
  constexpr double kSample_m = 1;
  if (!lanes.left_neighbour || vehicles.empty()) return std::nullopt;
  std::vector<PlanPose> samples;
  for (double s = 0; s <= road.length_m; s += kSample_m) samples.push_back(road.at(s));
  std::map<std::int64_t, int> places;  // number along less number against, by vehicle
  for (const MapVehicle& vehicle : vehicles) {
    const auto distance_m = [&](const PlanPose& place) {
      return (place.position() - vehicle.position).norm();
    };
    const PlanPose& nearest = *std::ranges::min_element(samples, {}, distance_m);
    if (distance_m(nearest) > kLanesReach_m) continue;
    const Vector2d ahead = nearest.ahead(), from = vehicle.position - nearest.position();
    const double across_m = from.dot(Vector2d(-ahead.y(), ahead.x()));
    if (across_m < lanes.left.across_m || across_m > lanes.left_neighbour->across_m) continue;
    places[vehicle.id] += vehicle.velocity.dot(ahead) > 0 ? 1 : -1;
  }
  if (places.empty()) return std::nullopt;
  const auto along = std::ranges::count_if(places, [](const auto& one) { return one.second > 0; });
  return 2 * along > std::ssize(places);
}

// ---- XML

void set(pugi::xml_node node, const char* name, double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.12g", value);
  node.append_attribute(name) = text;
}
void set(pugi::xml_node node, const char* name, const char* value) {
  node.append_attribute(name) = value;
}

/// Appends s, a, b, c, d.
void write_cubic(pugi::xml_node node, const char* s_name, double s,
                 const std::array<double, 4>& cubic) {
  set(node, s_name, s);
  for (int k = 0; k < 4; ++k) set(node, std::array{"a", "b", "c", "d"}[k], cubic[k]);
}

/// Appends a curve through a value of the stations whose slope is continuous (Catmull and Rom).
void write_profile(pugi::xml_node parent, const char* name, const std::vector<Station>& stations,
                   double Station::*value) {
  const auto slope = [&](std::size_t i) {
    const Station &a = stations[i > 0 ? i - 1 : 0],
                  &b = stations[std::min(i + 1, stations.size() - 1)];
    return (b.*value - a.*value) / (b.along_m - a.along_m);
  };
  for (std::size_t i = 0; i + 1 < stations.size(); ++i) {
    const double length = stations[i + 1].along_m - stations[i].along_m,
                 rise = (stations[i + 1].*value - stations[i].*value) / length, from = slope(i),
                 to = slope(i + 1);
    write_cubic(parent.append_child(name), "s", stations[i].along_m,
                {stations[i].*value, from, (3 * rise - 2 * from - to) / length,
                 (from + to - 2 * rise) / (length * length)});
  }
}

void write_plan(pugi::xml_node road, const Road& from) {
  pugi::xml_node plan = road.append_child("planView");
  for (std::size_t k = 0; k < from.pieces.size(); ++k) {
    const PlanPiece& piece = from.pieces[k];
    pugi::xml_node geometry = plan.append_child("geometry");
    set(geometry, "s", from.begin_m[k]);
    set(geometry, "x", piece.start.x);
    set(geometry, "y", piece.start.y);
    set(geometry, "hdg", piece.start.heading_rad);
    set(geometry, "length", piece.length_m);
    if (piece.curvature_rate_per_m2 != 0) {
      pugi::xml_node spiral = geometry.append_child("spiral");
      set(spiral, "curvStart", piece.curvature_per_m);
      set(spiral, "curvEnd", piece.end_curvature_per_m());
    } else if (piece.curvature_per_m != 0) {
      set(geometry.append_child("arc"), "curvature", piece.curvature_per_m);
    } else {
      geometry.append_child("line");
    }
  }
}

void write_mark(pugi::xml_node lane) {
  pugi::xml_node mark = lane.append_child("roadMark");
  set(mark, "sOffset", 0.0);
  set(mark, "type", "none");
  set(mark, "color", "standard");
}

void write_note(pugi::xml_node lane, const char* code, const char* value) {
  pugi::xml_node note = lane.append_child("userData");
  set(note, "code", code);
  set(note, "value", value);
}

/// How the width between two edges is known.
const char* width_note(const LaneEdge& a, const LaneEdge& b) {
  using enum LaneEdge::Kind;
  if (a.kind == kAssumed || b.kind == kAssumed) return "assumed";
  if (a.kind == kMarking && b.kind == kMarking) return "between markings";
  return a.kind == kKerb && b.kind == kKerb ? "between kerbs" : "between a marking and a kerb";
}

pugi::xml_node write_lane(pugi::xml_node side, int id, const LaneEdge& a, const LaneEdge& b) {
  pugi::xml_node lane = side.append_child("lane");
  set(lane, "id", std::to_string(id).c_str());
  set(lane, "type", "driving");
  set(lane, "level", "false");
  write_cubic(lane.append_child("width"), "sOffset", 0,
              {std::abs(a.across_m - b.across_m), 0, 0, 0});
  write_mark(lane);
  write_note(lane, "redrive:width", width_note(a, b));
  return lane;
}

/// Lanes in the driven direction lie to the right of the reference line, oncoming ones to its left.
/// `left_goes_along`: nothing where no vehicle shows it.
void write_lanes(pugi::xml_node road, const Lanes& found, std::optional<bool> left_goes_along) {
  const bool along = found.left_neighbour && left_goes_along.value_or(false);
  pugi::xml_node lanes = road.append_child("lanes");
  write_cubic(lanes.append_child("laneOffset"), "s", 0,
              {(along ? *found.left_neighbour : found.left).across_m, 0, 0, 0});
  pugi::xml_node section = lanes.append_child("laneSection");
  set(section, "s", 0.0);
  const auto note_direction = [&](pugi::xml_node lane) {
    write_note(lane, "redrive:direction", left_goes_along ? "as traffic" : "assumed");
  };
  if (found.left_neighbour && !along)
    note_direction(write_lane(section.append_child("left"), 1, *found.left_neighbour, found.left));
  pugi::xml_node centre = section.append_child("center").append_child("lane");
  set(centre, "id", "0");
  set(centre, "type", "none");
  set(centre, "level", "false");
  write_mark(centre);
  pugi::xml_node right = section.append_child("right");
  int id = 0;
  if (along) note_direction(write_lane(right, --id, *found.left_neighbour, found.left));
  pugi::xml_node driven = write_lane(right, --id, found.left, found.right);
  write_note(driven, "redrive:driven", "true");
  if (found.right_neighbour) write_lane(right, --id, found.right, *found.right_neighbour);
}

void write_header(pugi::xml_node map, const RoadMapInput& input, const std::vector<Road>& roads) {
  pugi::xml_node header = map.append_child("header");
  set(header, "revMajor", "1");
  set(header, "revMinor", "7");
  set(header, "name", input.name.c_str());
  set(header, "vendor", "redrive");
  Eigen::AlignedBox2d box;
  for (const Road& road : roads)
    for (double s = 0; s <= road.length_m; s += 1) box.extend(road.at(s).position());
  constexpr double kBeside_m = 10;
  set(header, "north", box.max().y() + kBeside_m);
  set(header, "south", box.min().y() - kBeside_m);
  set(header, "east", box.max().x() + kBeside_m);
  set(header, "west", box.min().x() - kBeside_m);
  if (!input.origin) return;
  // "+=alt_0" is the word by which CARLA's example finds the height; PROJ passes over it.
  char text[256];
  std::snprintf(text, sizeof text,
                "+proj=tmerc +lat_0=%.12f +lon_0=%.12f +k=1 +x_0=0 +y_0=0 +=alt_0=0 +ellps=WGS84 "
                "+units=m +no_defs",
                kDegreesPerRadian * input.origin->latitude_rad,
                kDegreesPerRadian * input.origin->longitude_rad);
  header.append_child("geoReference").append_child(pugi::node_cdata).set_value(text);
}

}  // namespace

RoadMap make_road_map(const RoadMapInput& input) {
  RoadMap out;
  std::vector<Road> roads;
  std::vector<std::vector<Station>> heights;
  std::vector<Lanes> lanes;
  const Ground ground(input.ground);
  for (const Stretch& stretch : forward_stretches(input.driven, &out.reversed_m)) {
    Road road = road_of(stretch);
    if (road.length_m < kShortestRoad_m) continue;
    heights.push_back(stations_of(road, stretch, ground));
    lanes.push_back(find_lanes(returns_beside(road, heights.back(), input.returns)));
    out.measured += lanes.back().is_measured();
    out.left += lanes.back().left_neighbour.has_value();
    out.right += lanes.back().right_neighbour.has_value();
    out.length_m += road.length_m;
    out.deviation_m = std::max(out.deviation_m, road.deviation_m);
    roads.push_back(std::move(road));
  }
  out.roads = static_cast<int>(roads.size());
  if (roads.empty()) return out;

  pugi::xml_document document;
  pugi::xml_node map = document.append_child("OpenDRIVE");
  write_header(map, input, roads);
  for (std::size_t r = 0; r < roads.size(); ++r) {
    pugi::xml_node road = map.append_child("road");
    set(road, "name", ("driven way " + std::to_string(r + 1)).c_str());
    set(road, "length", roads[r].length_m);
    set(road, "id", std::to_string(r + 1).c_str());
    set(road, "junction", "-1");
    set(road, "rule", "RHT");
    pugi::xml_node type = road.append_child("type");
    set(type, "s", 0.0);
    set(type, "type", "town");
    write_plan(road, roads[r]);
    write_profile(road.append_child("elevationProfile"), "elevation", heights[r],
                  &Station::height_m);
    write_profile(road.append_child("lateralProfile"), "superelevation", heights[r],
                  &Station::roll_rad);
    write_lanes(road, lanes[r], left_goes_along(roads[r], lanes[r], input.vehicles));
  }
  std::ostringstream text;
  document.save(text, " ");
  out.xml = text.str();
  return out;
}

}  // namespace redrive
