// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/drive_path.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <limits>
#include <optional>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/export/own_path.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/egomotion_json.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// Returns the number after `prefix`; nothing for another path. UsageError.
std::optional<double> number_of(const std::string& path, std::string_view prefix, double least,
                                double most, const char* rule) {
  if (!path.starts_with(prefix)) return std::nullopt;
  double number = 0;
  const char* const end = path.data() + path.size();
  const auto [at, error] = std::from_chars(path.data() + prefix.size(), end, number);
  if (error != std::errc{} || at != end || !(number >= least && number <= most))
    throw UsageError("--path", path, rule);
  return number;
}
std::optional<double> sideways_m(const std::string& path) {
  return number_of(path, "sideways:", -1e4, 1e4,
                   "must be sideways:METRES to the left, at most 1e4");
}
std::optional<double> speed_factor(const std::string& path) {
  return number_of(path, "speed:", 0.1, 10, "must be speed:FACTOR, 0.1 to 10");
}

/// Drops frames, and their views, that come later.
void end_scene_at(std::int64_t t_ns, Scene* scene) {
  std::erase_if(scene->frames, [&](const Frame& frame) { return frame.t_ns > t_ns; });
  std::erase_if(scene->views, [&](const View& view) {
    return view.frame >= static_cast<int>(scene->frames.size());
  });
}

/// Poses of the scene's frames from a file.
std::vector<FramePose> trajectory_of_file(const fs::path& file, const Scene& scene) {
  std::vector<FramePose> poses = parse_egomotion(read_file(file), file);
  for (const Frame& frame : scene.frames) {
    const auto pose = std::ranges::lower_bound(poses, frame.id, {}, &FramePose::id);
    if (pose == poses.end() || pose->id != frame.id)
      throw InputError(file, "frame " + std::to_string(frame.id), "",
                       "is missing: a path has a pose for each frame of the run");
    constexpr std::int64_t kSame_ns = 1'000'000;  // seconds as doubles
    if (std::abs(pose->t_ns - frame.t_ns) > kSame_ns)
      throw InputError(file, "time of frame " + std::to_string(frame.id),
                       std::to_string(pose->t_ns), "must be the run's, to 1 ms");
    pose->t_ns = frame.t_ns;
  }
  return poses;
}

/// UsageError where a path leads far away from the driven way.
void require_near(const Scene& driven, const Scene& on_path, const std::string& path) {
  constexpr double kFar_m = 1000;
  std::vector<Eigen::Vector3d> way;
  for (const Frame& frame : driven.frames)
    way.push_back(driven.world_from_body(frame.t_ns).translation());
  for (const Frame& frame : on_path.frames) {
    const Eigen::Vector3d place = on_path.world_from_body(frame.t_ns).translation();
    double square = std::numeric_limits<double>::infinity();
    for (const Eigen::Vector3d& other : way)
      square = std::min(square, (other - place).squaredNorm());
    const double nearest_m = std::sqrt(square);
    if (!(nearest_m <= kFar_m))
      throw UsageError("--path", path,
                       "leads " + std::to_string(std::llround(std::min(nearest_m, 1e15))) +
                           " m away from the driven way: is it in another world?");
  }
}

}  // namespace

void check_path(const std::string& path) {
  if (path == "drive" || sideways_m(path) || speed_factor(path)) return;
  std::error_code error;
  if (!fs::is_regular_file(path, error))
    throw UsageError("--path", path,
                     "must be drive, sideways:METRES, speed:FACTOR, or a file, and there is none");
}

Scene scene_on_path(const Scene& scene, const std::string& path) {
  Scene out = scene;
  const std::vector<RigCamera> rig = scene.rig;
  out.trajectory = scene.corrected_trajectory();
  out.correct({});
  out.rig = rig;
  for (View& view : out.views) view.motion.reset();
  if (path == "drive") return out;
  if (const auto left_m = sideways_m(path)) {
    for (FramePose& pose : out.trajectory)
      pose.global_from_body = pose.global_from_body * Eigen::Translation3d(0, *left_m, 0);
  } else if (const auto factor = speed_factor(path)) {
    const std::vector<FramePose> way = out.trajectory;
    const std::int64_t first_ns = scene.frames.front().t_ns;
    const auto on_way = [&](std::int64_t t_ns) {
      return first_ns + std::llround(*factor * static_cast<double>(t_ns - first_ns));
    };
    for (FramePose& pose : out.trajectory) pose.global_from_body = pose_at(way, on_way(pose.t_ns));
    const double most_ns = double(scene.frames.back().t_ns - first_ns) / std::max(*factor, 1.0);
    end_scene_at(first_ns + std::llround(most_ns), &out);
  } else if (has_extension(path, {".csv"})) {
    const std::vector<FramePose> poses = poses_on_own_path(read_file(path), path, scene);
    end_scene_at(poses.back().t_ns, &out);
    out.trajectory = poses;
  } else {
    out.trajectory = trajectory_of_file(path, scene);
  }
  require_near(scene, out, path);
  return out;
}

}  // namespace redrive
