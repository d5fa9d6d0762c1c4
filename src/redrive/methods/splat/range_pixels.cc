// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/range_pixels.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "redrive/scene/moving_objects.h"
#include "redrive/scene/point_cloud.h"
#include "redrive/scene/project_shutter.h"

namespace redrive {

namespace {

constexpr std::size_t kReturnsOfChunk = 4096;  // some milliseconds of a spinning LiDAR
// maximum time between a return and an image that uses it
constexpr std::int64_t kApart_ns = 150'000'000;

/// Poses of a view's camera as they project points of the world.
struct Projection {
  const Camera& camera;
  ShutterPoses poses;
  Rigid3d camera_from_world = poses.at(0.5).inverse(Eigen::Isometry);  // at the middle row

  std::optional<RangePixel> operator()(const Eigen::Vector3d& in_world) const {
    const auto seen = project_shutter(camera, poses, camera_from_world, in_world);
    if (!seen) return std::nullopt;
    const auto index = pixel_index(camera.width, camera.height, seen->pixel);
    if (!index) return std::nullopt;
    const auto width = static_cast<std::size_t>(camera.width);
    return RangePixel{static_cast<std::uint16_t>(*index % width),
                      static_cast<std::uint16_t>(*index / width),
                      static_cast<float>(std::log(seen->in_camera.norm()))};
  }
};

}  // namespace

ReturnTimes::ReturnTimes(const LidarReturns& lidar) : n_(lidar.n) {
  for (std::size_t i = 0; i < n_; ++i) {
    const std::int64_t t_ns = lidar.t_ns[i];
    if (i % kReturnsOfChunk == 0) chunks_.push_back({t_ns, t_ns});
    chunks_.back().first_ns = std::min(chunks_.back().first_ns, t_ns);
    chunks_.back().last_ns = std::max(chunks_.back().last_ns, t_ns);
  }
}

std::vector<ReturnTimes::Range> ReturnTimes::ranges(std::int64_t first_ns,
                                                    std::int64_t last_ns) const {
  std::vector<Range> found;
  for (std::size_t c = 0; c < chunks_.size(); ++c)
    if (chunks_[c].first_ns <= last_ns && chunks_[c].last_ns >= first_ns)
      found.emplace_back(c * kReturnsOfChunk, std::min(n_, (c + 1) * kReturnsOfChunk));
  return found;
}

std::vector<ShownReturn> find_shown_returns(const TrainingSet& data, const ReturnTimes& times,
                                            std::size_t of_view) {
  constexpr int kCell = 8;  // pixels
  // a return farther by this part of the distance is hidden, as a logarithm
  constexpr float kBehind = 0.14f;
  const Scene& scene = data.scene;
  const View& view = scene.views[of_view];
  const RigCamera& rig = scene.rig[view.camera];
  const std::int64_t t_ns = scene.exposed_ns(view, Poses::kRecorded);
  const Projection pixel_of{
      rig.camera, ShutterPoses(scene.camera_during(view, Poses::kRecorded), rig.readout_by_column)};
  const Rigid3d body_from_world =
      scene.world_from_body(view, Poses::kRecorded).inverse(Eigen::Isometry);
  const LidarReturns& lidar = data.lidar;
  LidarPoses lidar_poses(scene, lidar, Poses::kRecorded);
  struct Shown {
    RangePixel pixel;
    ShownReturn in_body;
  };
  std::vector<Shown> all;
  std::vector<MovingBox> boxes;
  std::vector<std::pair<std::int64_t, Rigid3d>> actors;  // key: id; world_from_actor
  for (const MovingObject& actor : scene.actors)
    if (const auto world_from_actor = actor.world_from_box(t_ns, Poses::kRecorded)) {
      boxes.push_back({actor.id, world_from_actor->inverse(Eigen::Isometry), actor.size_m / 2});
      actors.emplace_back(actor.id, *world_from_actor);
    }
  const Eigen::Vector3d eye = pixel_of.poses.at(0.5).translation();
  const auto add_return = [&](std::size_t i) {
    if (scene.metric && std::abs(lidar.t_ns[i] - t_ns) > kApart_ns) return;
    const Eigen::Vector3d at = lidar_poses.in_world(i);
    const auto pixel = pixel_of(at);
    // An object may by now hide what the sensor saw then.
    if (pixel && std::ranges::none_of(
                     boxes, [&](const MovingBox& box) { return box.intersects(eye, at - eye, 1); }))
      all.push_back({*pixel, (body_from_world * at).cast<float>()});
  };
  const auto ranges = scene.metric ? times.ranges(t_ns - kApart_ns, t_ns + kApart_ns)
                                   : std::vector<ReturnTimes::Range>{{0, lidar.n}};
  for (const auto& [begin, end] : ranges)
    for (std::size_t i = begin; i < end; ++i) add_return(i);
  for (const LidarReturns::OnObject& at : lidar.on_objects) {
    if (std::abs(at.t_ns - t_ns) > kApart_ns) continue;
    const auto actor = std::ranges::find(actors, at.id, &std::pair<std::int64_t, Rigid3d>::first);
    if (actor == actors.end()) continue;
    const Eigen::Vector3d in_world = actor->second * at.in_box.cast<double>();
    if (const auto pixel = pixel_of(in_world))
      all.push_back({*pixel, (body_from_world * in_world).cast<float>()});
  }
  const int across = rig.camera.width / kCell + 1, down = rig.camera.height / kCell + 1;
  std::vector<float> nearest(static_cast<std::size_t>(across) * down, 1e9f);
  for (const auto& [p, in_body] : all) {
    float& least = nearest[static_cast<std::size_t>(p.y / kCell) * across + p.x / kCell];
    least = std::min(least, p.log_range);
  }
  std::erase_if(all, [&](const Shown& shown) {
    const RangePixel& p = shown.pixel;
    for (int dy = -1; dy <= 1; ++dy)
      for (int dx = -1; dx <= 1; ++dx) {
        const int cx = p.x / kCell + dx, cy = p.y / kCell + dy;
        if (cx < 0 || cy < 0 || cx >= across || cy >= down) continue;
        if (nearest[static_cast<std::size_t>(cy) * across + cx] < p.log_range - kBehind)
          return true;
      }
    return false;
  });
  std::vector<bool> taken(static_cast<std::size_t>(rig.camera.width) * rig.camera.height);
  std::vector<ShownReturn> shown;
  for (const auto& [p, in_body] : all) {
    const std::size_t pixel = static_cast<std::size_t>(p.y) * rig.camera.width + p.x;
    if (!taken[pixel]) shown.push_back(in_body);
    taken[pixel] = true;
  }
  shown.shrink_to_fit();
  return shown;
}

std::vector<RangePixel> range_pixels(const Scene& scene, const View& view,
                                     std::span<const ShownReturn> returns, ThreadPool& pool) {
  constexpr std::size_t kGrain = 2048;
  const RigCamera& rig = scene.rig[view.camera];
  const Projection pixel_of{rig.camera,
                            ShutterPoses(scene.camera_during(view), rig.readout_by_column)};
  const Rigid3d world_from_body = scene.world_from_body(view);
  std::vector<std::optional<RangePixel>> each(returns.size());
  pool.run_ranges(returns.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      each[i] = pixel_of(world_from_body * returns[i].cast<double>());
  });
  std::vector<RangePixel> pixels;
  pixels.reserve(each.size());
  for (const auto& pixel : each)
    if (pixel) pixels.push_back(*pixel);
  return pixels;
}

std::uint64_t shown_return_bytes(const Scene& scene, std::uint64_t returns) {
  constexpr double kShown = 1.0 / 3;  // share of the returns around the car that an image shows
  constexpr double kSeconds = 2e-9 * kApart_ns;
  const double seconds = scene.exposure(0, scene.frames.back().t_ns).t_s,
               part = scene.metric ? std::min(1.0, kSeconds / std::max(seconds, kSeconds)) : 1;
  const auto shown = static_cast<std::uint64_t>(kShown * part * static_cast<double>(returns));
  std::uint64_t pixels = 0;
  for (const View& view : scene.views) {
    const Camera& camera = scene.rig[view.camera].camera;
    if (!view.held_out) pixels += std::min(shown, std::uint64_t(camera.width) * camera.height);
  }
  return pixels * sizeof(ShownReturn);
}

}  // namespace redrive
