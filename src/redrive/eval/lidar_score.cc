// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/lidar_score.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <nanoflann.hpp>

#include "redrive/base/error.h"
#include "redrive/render/lidar_scan.h"

namespace redrive {
namespace {

using Cloud = std::vector<Eigen::Vector3f>;

/// Points for nanoflann.
struct CloudSet {
  const Cloud& points;
  std::size_t kdtree_get_point_count() const { return points.size(); }
  float kdtree_get_pt(std::size_t i, std::size_t k) const {
    return points[i][static_cast<Eigen::Index>(k)];
  }
  template <class Box>
  bool kdtree_get_bbox(Box&) const {
    return false;
  }
};

/// Returns the mean distance of each point of `from` to the nearest of `to`.
double mean_distance(const Cloud& from, const Cloud& to) {
  using Tree = nanoflann::KDTreeSingleIndexAdaptor<nanoflann::L2_Simple_Adaptor<float, CloudSet>,
                                                   CloudSet, 3, std::uint32_t>;
  const CloudSet set{to};
  Tree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  tree.buildIndex();
  double sum = 0;
  for (const Eigen::Vector3f& point : from) {
    std::uint32_t nearest = 0;
    float square = 0;
    tree.knnSearch(point.data(), 1, &nearest, &square);
    sum += std::sqrt(double(square));
  }
  return sum / static_cast<double>(from.size());
}

/// Adds up errors of returns.
class RangeErrors {
 public:
  /// `rendered_m`: a return's range; nothing: none is rendered.
  void add(std::optional<double> rendered_m, double recorded_m) {
    ++returns_;
    if (!rendered_m) return;
    errors_.push_back(std::abs(*rendered_m - recorded_m));
    near_ += errors_.back() <= kNearHit_m;
  }
  RangeScore score() {
    const auto share = [&](double part) { return part / static_cast<double>(returns_); };
    RangeScore score{returns_, std::numeric_limits<double>::quiet_NaN(),
                     share(static_cast<double>(errors_.size())), share(static_cast<double>(near_))};
    if (errors_.empty()) return score;
    const auto middle = errors_.begin() + static_cast<std::ptrdiff_t>(errors_.size() / 2);
    std::nth_element(errors_.begin(), middle, errors_.end());
    score.range_error_m = *middle;
    return score;
  }
  std::int64_t returns() const { return returns_; }

 private:
  std::vector<double> errors_;
  std::int64_t returns_ = 0, near_ = 0;
};

/// Renders rays of a scan.
RenderedRays rendered_rays(const Run& run, kernels::Backend& backend, const LidarReturns& scan) {
  const LidarRays in_world = rays_in_world(run.scene, scan, backend.pool());
  return run.field()->trace(
      backend, {static_cast<int>(scan.n), in_world.origin, in_world.direction, scan.t_ns},
      run.scene.actors);
}

/// Returns the lost rays of a scan in place of its returns.
LidarReturns lost_rays_of(const LidarReturns& scan) {
  LidarReturns out;
  out.n = scan.lost.size();
  out.body_from_sensor = scan.body_from_sensor;
  for (int k = 0; k < 3; ++k)
    for (const LidarReturns::LostRay& ray : scan.lost) out.direction.push_back(ray.direction[k]);
  for (const LidarReturns::LostRay& ray : scan.lost) out.t_ns.push_back(ray.t_ns);
  return out;
}

/// Adds up what is scored besides ranges.
struct SignalErrors {
  double squares = 0;      // sum over the intensities of rendered returns
  double intensities = 0;  // their number
  double returned = 0, right_returned = 0, lost = 0, right_lost = 0;

  void add(const Run& run, kernels::Backend& backend, const LidarReturns& scan,
           const RenderedRays& rendered) {
    if (rendered.lost.empty()) return;
    const float full = scan.full_intensity();
    for (std::size_t i = 0; i < scan.n; ++i) {
      if (i > 0 && scan.same_ray(i)) continue;
      const bool comes_back = rendered.returned(i) >= kMinReturnOpacity;
      ++returned;
      right_returned += comes_back;
      if (!comes_back) continue;
      ++intensities;
      squares += std::pow(double(rendered.intensity[i] - float(scan.intensity[i]) / full), 2);
    }
    if (scan.lost.empty()) return;
    const RenderedRays of_lost = rendered_rays(run, backend, lost_rays_of(scan));
    for (std::size_t i = 0; i < scan.lost.size(); ++i) {
      ++lost;
      right_lost += of_lost.returned(i) < kMinReturnOpacity;
    }
  }
  void set(LidarScore* score) const {
    if (intensities > 0) score->intensity_rmse = std::sqrt(squares / intensities);
    if (lost > 0)
      score->lost = LostRayScore{static_cast<std::int64_t>(returned + lost),
                                 (right_returned + right_lost) / (returned + lost),
                                 2 * right_lost / (right_lost + lost + returned - right_returned)};
  }
};

bool on_object(const std::vector<MovingBox>& boxes, const Eigen::Vector3d& in_world) {
  return std::ranges::any_of(boxes, [&](const MovingBox& box) {
    return is_on_object(box, box.box_from_world * in_world);
  });
}

}  // namespace

double chamfer_distance(const Cloud& a, const Cloud& b) {
  REDRIVE_CHECK(!a.empty() && !b.empty());
  return (mean_distance(a, b) + mean_distance(b, a)) / 2;
}

std::vector<std::int64_t> held_out_revolutions(const Run& run) {
  std::vector<std::int64_t> frames;
  if (!run.recording.body_from_lidar) return frames;
  const std::set<std::int64_t> held_out = held_out_frames(run.scene);
  for (const FrameFile& file : run.recording.lidar_files)
    if (held_out.contains(file.frame_id) && (frames.empty() || frames.back() != file.frame_id))
      frames.push_back(file.frame_id);
  return frames;
}

std::optional<LidarScore> score_lidar(const Run& run, kernels::Backend& backend,
                                      const std::vector<std::int64_t>& frames,
                                      const MovingObjects& left_out, Progress* progress) {
  LidarScore score;
  RangeErrors all, on_moving;
  SignalErrors signals;
  double chamfer = 0;
  int with_chamfer = 0;
  const MovingObjects drawn(run.scene.actors);
  for (const std::int64_t frame : frames) {
    const LidarReturns recorded =
        load_lidar_returns(run.recording, run.scene, left_out, backend.pool(),
                           {[&](std::int64_t id) { return id == frame; }, false, /*lost=*/true});
    const std::size_t n = recorded.n;
    const LidarRays in_world = rays_in_world(run.scene, recorded, backend.pool());
    const RenderedRays rendered = rendered_rays(run, backend, recorded);
    signals.add(run, backend, recorded, rendered);
    Cloud measured, seen;
    std::vector<MovingBox> boxes;
    for (std::size_t i = 0, end = 0; i < n; i = end) {
      const Eigen::Vector3f origin = in_world.origin_at(i), direction = in_world.direction_at(i);
      for (end = i + 1; end < n && recorded.same_ray(end);) ++end;
      std::optional<double> range_m;
      if (rendered.returned(i) >= kMinReturnOpacity && rendered.depth[i] >= kMinReturn_m &&
          rendered.depth[i] <= kMaxReturn_m) {
        range_m = rendered.depth[i];
        seen.push_back(origin + rendered.depth[i] * direction);
      }
      std::size_t nearest = i;  // the ray's return nearest to the rendered one
      const auto off_m = [&](std::size_t k) { return std::abs(recorded.range_m[k] - *range_m); };
      for (std::size_t k = i; k < end; ++k) {
        measured.push_back(origin + recorded.range_m[k] * direction);
        if (range_m && off_m(k) < off_m(nearest)) nearest = k;
      }
      all.add(range_m, recorded.range_m[nearest]);
      if (i == 0 || recorded.t_ns[i] != recorded.t_ns[i - 1]) boxes = drawn.at(recorded.t_ns[i]);
      const Eigen::Vector3f at = origin + recorded.range_m[nearest] * direction;
      if (on_object(boxes, at.cast<double>())) on_moving.add(range_m, recorded.range_m[nearest]);
    }
    score.revolutions += n > 0;
    if (!seen.empty()) {
      chamfer += chamfer_distance(measured, seen);
      ++with_chamfer;
    }
    if (progress) progress->count();
  }
  if (all.returns() == 0) return std::nullopt;
  static_cast<RangeScore&>(score) = all.score();
  signals.set(&score);
  score.chamfer_m =
      with_chamfer > 0 ? chamfer / with_chamfer : std::numeric_limits<double>::quiet_NaN();
  if (on_moving.returns() > 0) score.moving = on_moving.score();
  return score;
}

}  // namespace redrive
