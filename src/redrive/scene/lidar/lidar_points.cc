// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_points.h"

#include <algorithm>
#include <cmath>
#include <span>
#include <unordered_map>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/scene/project_shutter.h"

namespace redrive {
namespace {

constexpr std::size_t kReturnsPerRange = 16384;
/// each image is read once for this many
constexpr std::size_t kReturnsAtOnce = std::size_t{1} << 19;
constexpr std::size_t kNearestViews =
    32;  // origins of a cloud's points, at most; further ones hardly see its points
// Views of each camera nearest in time that may see a return, and more of them: a camera saw what
// it passes ahead of it before.
constexpr int kViewsInTime = 2, kMoreViewsInTime = 24;

/// A training view that may see a return.
struct ColourView {
  const Camera* camera;
  std::size_t view;
  ShutterPoses world_from_camera;
  Rigid3d camera_from_world;  ///< pose of the middle row
  Eigen::Vector3d position_in_world_m;
  std::int64_t t_ns;  ///< exposure of the middle row

  std::optional<std::size_t> pixel_of(const Eigen::Vector3d& in_world) const {
    const auto seen = project_shutter(*camera, world_from_camera, camera_from_world, in_world);
    return seen ? pixel_index(camera->width, camera->height, seen->pixel) : std::nullopt;
  }
};

class Colouring {
 public:
  explicit Colouring(const Scene& scene) : of_camera_(scene.rig.size()) {
    for (std::size_t i = 0; i < scene.views.size(); ++i) {
      const View& view = scene.views[i];
      if (view.held_out) continue;
      const RigCamera& rig = scene.rig[view.camera];
      const ShutterPoses poses = scene.shutter_poses(view);
      const Rigid3d middle = poses.at(0.5);
      of_camera_[view.camera].push_back(static_cast<int>(views_.size()));
      views_.push_back({&rig.camera, i, poses, middle.inverse(Eigen::Isometry),
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

  const ColourView& view(int v) const { return views_[static_cast<std::size_t>(v)]; }

 private:
  std::vector<ColourView> views_;
  std::vector<std::vector<int>> of_camera_;  ///< views by time
};

/// A return whose colour is being searched.
struct Uncoloured {
  std::size_t i;          ///< index of the return
  int tried = 0;          ///< views tried, out of those that may see it
  int seen_by = -1;       ///< the next view into which it projects; -1: none is left
  std::size_t pixel = 0;  ///< its pixel there
};

/// Views to try first for the returns of each origin of a cloud, which has one time; empty where
/// the drive is metric and time says which views are near.
using ViewsOfOrigin = std::unordered_map<std::int64_t, std::vector<int>>;

/// Advances each return to the next view into which it projects, whatever its image has there.
void find_views(const Scene& scene, const LidarReturns& returns, const Colouring& colouring,
                const ViewsOfOrigin& of_origin, std::span<Uncoloured> points) {
  std::int64_t near_ns = 0, more_ns = 0;
  std::vector<int> in_time, in_more_time;
  LidarPoses poses(scene, returns);
  for (Uncoloured& point : points) {
    const std::int64_t t_ns = returns.t_ns[point.i];
    if (scene.metric && (in_time.empty() || t_ns != near_ns))
      colouring.nearest_in_time(near_ns = t_ns, kViewsInTime, &in_time);
    const std::vector<int>& first = scene.metric ? in_time : of_origin.at(t_ns);
    const int of_first = static_cast<int>(first.size());
    const Eigen::Vector3d at = poses.in_world(point.i);
    point.seen_by = -1;
    while (point.seen_by < 0) {
      int v;
      if (point.tried < of_first) {
        v = first[point.tried];
      } else {
        if (!scene.metric) break;
        if (in_more_time.empty() || t_ns != more_ns)
          colouring.nearest_in_time(more_ns = t_ns, kMoreViewsInTime, &in_more_time);
        if (point.tried - of_first >= std::ssize(in_more_time)) break;
        v = in_more_time[point.tried - of_first];
      }
      ++point.tried;
      if (const auto pixel = colouring.view(v).pixel_of(at)) {
        point.seen_by = v;
        point.pixel = *pixel;
      }
    }
  }
}

}  // namespace

PointCloud lidar_points(const Scene& scene, const ViewImages& images, const LidarReturns& returns,
                        ThreadPool& pool) {
  REDRIVE_CHECK_OP(images.size(), ==, scene.views.size());
  const Colouring colouring(scene);
  ViewsOfOrigin of_origin;
  LidarPoses origins(scene, returns);
  for (std::size_t i = 0; i < returns.n && !scene.metric; ++i)
    if (const auto [at, is_new] = of_origin.try_emplace(returns.t_ns[i]); is_new)
      at->second = colouring.nearest_in_space(origins.at(i).translation());

  std::vector<std::vector<ColouredPoint>> parts;
  Progress progress("colouring LiDAR points", static_cast<std::int64_t>(returns.n));
  for (std::size_t begin = 0; begin < returns.n; begin += kReturnsAtOnce) {
    const std::size_t n = std::min(kReturnsAtOnce, returns.n - begin);
    std::vector<std::optional<ColouredPoint>> coloured(n);
    std::vector<Uncoloured> points(n);
    for (std::size_t k = 0; k < n; ++k) points[k].i = begin + k;
    while (!points.empty()) {
      pool.run_ranges(points.size(), kReturnsPerRange, [&](std::size_t from, std::size_t to) {
        find_views(scene, returns, colouring, of_origin,
                   std::span(points).subspan(from, to - from));
      });
      std::erase_if(points, [](const Uncoloured& point) { return point.seen_by < 0; });
      // One list per view, so that each image is read once.
      std::vector<std::vector<std::uint32_t>> of_view(scene.views.size());
      for (std::size_t k = 0; k < points.size(); ++k)
        of_view[colouring.view(points[k].seen_by).view].push_back(static_cast<std::uint32_t>(k));
      std::vector<std::size_t> seeing;
      for (std::size_t v = 0; v < of_view.size(); ++v)
        if (!of_view[v].empty()) seeing.push_back(v);
      pool.run(static_cast<int>(seeing.size()), [&](int chunk) {
        const ImagePointer image = images[seeing[chunk]];
        LidarPoses poses(scene, returns);
        for (const std::uint32_t k : of_view[seeing[chunk]]) {
          const Uncoloured& point = points[k];
          if (is_static(*image, point.pixel))
            coloured[point.i - begin] =
                ColouredPoint{poses.in_world(point.i).cast<float>(), colour_at(*image, point.pixel),
                              colouring.view(point.seen_by).position_in_world_m.cast<float>(),
                              static_cast<std::uint32_t>(point.i)};
        }
      });
      std::erase_if(points,
                    [&](const Uncoloured& point) { return coloured[point.i - begin].has_value(); });
    }
    parts.emplace_back();
    for (const auto& point : coloured)
      if (point) parts.back().push_back(*point);
    progress.count(static_cast<std::int64_t>(n));
  }
  return make_point_cloud(parts);
}

}  // namespace redrive
