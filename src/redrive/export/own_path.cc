// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/own_path.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/parse/text_lines.h"

namespace redrive {
namespace {

struct Place {
  double t_s = 0;
  Eigen::Vector2d xy = Eigen::Vector2d::Zero();
};

constexpr std::array<const char*, 3> kColumns{"t_s", "x_m", "y_m"};

std::vector<Place> parse_places(std::string_view csv, const std::filesystem::path& file) {
  constexpr double kMost_s = 1e5, kMost_m = 1e5;
  std::string text(csv);
  std::ranges::replace(text, ',', ' ');
  std::ranges::replace(text, '\r', ' ');
  const std::vector<TextLine> lines = text_lines(text, file);
  std::array<std::size_t, 3> column{};
  for (std::size_t k = 0; k < kColumns.size(); ++k) {
    while (!lines.empty() && column[k] < lines[0].size() && lines[0].word(column[k]) != kColumns[k])
      ++column[k];
    if (lines.empty() || column[k] == lines[0].size())
      throw InputError(file, "line 1", "", "must name the columns t_s, x_m and y_m");
  }
  std::vector<Place> places;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const TextLine& line = lines[i];
    if (line.size() == 0) continue;
    line.expect_size(lines[0].size(), "values, as line 1");
    Place place{line.number(column[0], kColumns[0], -kMost_s, kMost_s),
                {line.number(column[1], kColumns[1], -kMost_m, kMost_m),
                 line.number(column[2], kColumns[2], -kMost_m, kMost_m)}};
    if (!places.empty() && place.t_s <= places.back().t_s)
      line.fail(column[0], kColumns[0], "must be later than the line before");
    places.push_back(place);
  }
  if (places.size() < 2) throw InputError(file, "", "", "must have two places at least");
  if (places.front().t_s > 0)
    throw InputError(file, kColumns[0], std::to_string(places.front().t_s),
                     "must begin at 0, the first frame, or before");
  return places;
}

Eigen::Vector2d place_at(const std::vector<Place>& places, double t_s) {
  const auto after = std::ranges::upper_bound(places, t_s, {}, &Place::t_s);
  if (after == places.begin()) return places.front().xy;
  if (after == places.end()) return places.back().xy;
  const Place& before = *(after - 1);
  const double share = (t_s - before.t_s) / (after->t_s - before.t_s);
  return before.xy + share * (after->xy - before.xy);
}

/// Returns the direction of the way around a time; nothing where the car stands.
std::optional<Eigen::Vector2d> heading_at(const std::vector<Place>& places, double t_s) {
  constexpr double kAround_s = 0.5, kStands_m = 0.05;
  const Eigen::Vector2d moved =
      place_at(places, t_s + kAround_s) - place_at(places, t_s - kAround_s);
  if (moved.norm() < kStands_m) return std::nullopt;
  return moved.normalized();
}

/// Returns the driven pose that is nearest to a place.
const Rigid3d& nearest_to(const Eigen::Vector2d& xy, const std::vector<Rigid3d>& driven) {
  return *std::ranges::min_element(driven, {}, [&](const Rigid3d& pose) {
    return (pose.translation().head<2>() - xy).squaredNorm();
  });
}

}  // namespace

std::vector<FramePose> poses_on_own_path(std::string_view text, const std::filesystem::path& file,
                                         const Scene& scene) {
  const std::vector<Place> places = parse_places(text, file);
  const std::int64_t first_ns = scene.frames.front().t_ns;
  std::vector<Rigid3d> driven;
  for (const Frame& frame : scene.frames) driven.push_back(scene.world_from_body(frame.t_ns));
  std::optional<Eigen::Vector2d> heading;
  for (std::size_t i = 0; i < places.size() && !heading; ++i)
    heading = heading_at(places, places[i].t_s);
  if (!heading) heading = driven.front().linear().col(0).head<2>().normalized();
  std::vector<FramePose> poses;
  for (const Frame& frame : scene.frames) {
    const double t_s = 1e-9 * static_cast<double>(frame.t_ns - first_ns);
    if (t_s > places.back().t_s) break;
    if (const auto now = heading_at(places, t_s)) heading = now;
    const Eigen::Vector2d xy = place_at(places, t_s);
    const Rigid3d& road = nearest_to(xy, driven);
    const Eigen::Vector3d up = road.linear().col(2), ahead(heading->x(), heading->y(), 0),
                          left = up.cross(ahead).normalized();
    const Eigen::Vector2d beside = xy - road.translation().head<2>();
    Rigid3d pose = Rigid3d::Identity();
    pose.linear().col(0) = left.cross(up);
    pose.linear().col(1) = left;
    pose.linear().col(2) = up;
    pose.translation() << xy, road.translation().z() - up.head<2>().dot(beside) / up.z();
    poses.push_back({frame.id, frame.t_ns, scene.global_from_world * pose});
  }
  return poses;
}

}  // namespace redrive
