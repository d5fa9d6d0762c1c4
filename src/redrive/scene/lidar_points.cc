// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar_points.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>

#include "redrive/base/error.h"
#include "redrive/scene/project_shutter.h"

namespace redrive {
namespace {

constexpr std::size_t kReturnsPerRange = 16384;
constexpr std::size_t kNearestViews =
    32;  // of a cloud's origin; further ones hardly see its points
// Views of each camera nearest in time that may see a return, and then further ones: what a camera
// passes it saw ahead of it before.
constexpr int kViewsInTime = 2, kMoreViewsInTime = 24;

/// A training view that may see a return.
struct ColourView {
  const Camera* camera;
  const Image8* image;
  ShutterPoses world_from_camera;
  Rigid3d camera_from_world;  ///< of the middle row
  Eigen::Vector3d position_in_world_m;
  std::int64_t t_ns;  ///< of the middle row's exposure

  std::optional<std::size_t> pixel_of(const Eigen::Vector3d& in_world) const {
    const auto seen = project_shutter(*camera, world_from_camera, camera_from_world, in_world);
    return seen ? static_pixel(*image, seen->pixel) : std::nullopt;
  }
};

class Colouring {
 public:
  Colouring(const Scene& scene, const std::vector<Image8>& images) : of_camera_(scene.rig.size()) {
    for (std::size_t i = 0; i < scene.views.size(); ++i) {
      const View& view = scene.views[i];
      if (view.held_out) continue;
      const RigCamera& rig = scene.rig[view.camera];
      const ShutterPoses poses = scene.shutter_poses(view);
      const Rigid3d middle = poses.at(0.5);
      of_camera_[view.camera].push_back(static_cast<int>(views_.size()));
      views_.push_back({&rig.camera, &images[i], poses, middle.inverse(Eigen::Isometry),
                        middle.translation(), scene.frames[view.frame].t_ns + rig.time_offset_ns});
    }
    for (auto& views : of_camera_)
      std::ranges::stable_sort(views, {}, [&](int v) { return views_[v].t_ns; });
  }

  /// Sets the `most` views of each camera nearest in time to t_ns, the nearest first.
  void nearest_in_time(std::int64_t t_ns, int most, std::vector<int>* views) const {
    views->clear();
    const auto apart_ns = [&](int v) { return std::abs(views_[v].t_ns - t_ns); };
    for (const auto& of_camera : of_camera_) {
      const auto after =
          std::ranges::lower_bound(of_camera, t_ns, {}, [&](int v) { return views_[v].t_ns; });
      auto begin = after, end = after;
      for (int k = 0; k < most; ++k) {
        const bool earlier = begin != of_camera.begin(), later = end != of_camera.end();
        if (earlier && (!later || apart_ns(begin[-1]) <= apart_ns(*end)))
          --begin;
        else if (later)
          ++end;
      }
      views->insert(views->end(), begin, end);
    }
    std::ranges::stable_sort(*views, {}, apart_ns);
  }

  /// Returns the views nearest to a position, the nearest first.
  std::vector<int> nearest_in_space(const Eigen::Vector3d& in_world) const {
    std::vector<int> views(views_.size());
    for (std::size_t v = 0; v < views.size(); ++v) views[v] = static_cast<int>(v);
    std::ranges::stable_sort(
        views, {}, [&](int v) { return (views_[v].position_in_world_m - in_world).squaredNorm(); });
    views.resize(std::min(views.size(), kNearestViews));
    return views;
  }

  std::optional<ColouredPoint> colour(const Eigen::Vector3d& in_world,
                                      const std::vector<int>& nearest) const {
    for (const int v : nearest)
      if (const auto pixel = views_[v].pixel_of(in_world))
        return ColouredPoint{in_world.cast<float>(), colour_at(*views_[v].image, *pixel),
                             views_[v].position_in_world_m.cast<float>()};
    return std::nullopt;
  }

 private:
  std::vector<ColourView> views_;
  std::vector<std::vector<int>> of_camera_;  ///< views by time
};

Eigen::Vector3d vector_at(const std::vector<float>& values, std::size_t n, std::size_t i) {
  return {values[i], values[n + i], values[2 * n + i]};
}

}  // namespace

PointCloud lidar_points(const Scene& scene, const std::vector<Image8>& images,
                        const LidarReturns& returns, ThreadPool& pool) {
  REDRIVE_CHECK_OP(images.size(), ==, scene.views.size());
  const Colouring colouring(scene, images);
  std::unordered_map<std::int64_t, std::vector<int>> of_origin;  // a cloud's origin has one time
  for (std::size_t i = 0; i < returns.n && !scene.metric; ++i)
    if (const auto [at, is_new] = of_origin.try_emplace(returns.t_ns[i]); is_new)
      at->second = colouring.nearest_in_space(vector_at(returns.origin, returns.n, i));

  std::vector<std::vector<ColouredPoint>> parts((returns.n + kReturnsPerRange - 1) /
                                                kReturnsPerRange);
  pool.run_ranges(returns.n, kReturnsPerRange, [&](std::size_t begin, std::size_t end) {
    std::vector<int> in_time, in_more_time;
    for (std::size_t i = begin; i < end; ++i) {
      const std::int64_t t_ns = returns.t_ns[i];
      if (scene.metric && (i == begin || t_ns != returns.t_ns[i - 1])) {
        colouring.nearest_in_time(t_ns, kViewsInTime, &in_time);
        in_more_time.clear();
      }
      const Eigen::Vector3d in_world =
          vector_at(returns.origin, returns.n, i) +
          double(returns.range_m[i]) * vector_at(returns.direction, returns.n, i);
      auto point = colouring.colour(in_world, scene.metric ? in_time : of_origin.at(t_ns));
      if (!point && scene.metric) {
        if (in_more_time.empty()) colouring.nearest_in_time(t_ns, kMoreViewsInTime, &in_more_time);
        point = colouring.colour(in_world, in_more_time);
      }
      if (point) parts[begin / kReturnsPerRange].push_back(*point);
    }
  });
  return make_point_cloud(parts);
}

}  // namespace redrive
