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

}  // namespace

double chamfer_distance(const Cloud& a, const Cloud& b) {
  REDRIVE_CHECK(!a.empty() && !b.empty());
  return (mean_distance(a, b) + mean_distance(b, a)) / 2;
}

std::vector<std::int64_t> held_out_revolutions(const Run& run) {
  std::vector<std::int64_t> frames;
  if (!run.state.holds_out_lidar || !run.recording.body_from_lidar) return frames;
  const std::set<std::int64_t> held_out = held_out_frames(run.scene);
  for (const FrameFile& file : run.recording.lidar_files)
    if (held_out.contains(file.frame_id) && (frames.empty() || frames.back() != file.frame_id))
      frames.push_back(file.frame_id);
  return frames;
}

std::optional<LidarScore> score_lidar(const Run& run, kernels::Backend& backend,
                                      const std::vector<std::int64_t>& frames,
                                      const MovingObjects& moving,
                                      const std::function<void()>& scored) {
  LidarScore score;
  std::vector<double> errors;
  std::int64_t near = 0;
  double chamfer = 0;
  int with_chamfer = 0;
  ThreadPool pool(backend.threads());
  for (const std::int64_t frame : frames) {
    const LidarReturns recorded = load_lidar_returns(
        run.recording, run.scene, moving, pool, {[&](std::int64_t id) { return id == frame; }});
    const std::size_t n = recorded.n;
    const RenderedRays rendered =
        run.state.model->trace(backend, {static_cast<int>(n), recorded.origin, recorded.direction});
    Cloud measured, seen;
    for (std::size_t i = 0; i < n; ++i) {
      Eigen::Vector3f origin, direction;
      for (int k = 0; k < 3; ++k) {
        origin[k] = recorded.origin[k * n + i];
        direction[k] = recorded.direction[k * n + i];
      }
      measured.push_back(origin + recorded.range_m[i] * direction);
      if (!(rendered.opacity[i] >= kMinReturnOpacity && rendered.depth[i] >= kMinReturn_m &&
            rendered.depth[i] <= kMaxReturn_m))
        continue;
      seen.push_back(origin + rendered.depth[i] * direction);
      errors.push_back(std::abs(double(rendered.depth[i]) - double(recorded.range_m[i])));
      near += errors.back() <= kNearHit_m;
    }
    score.revolutions += n > 0;
    score.returns += static_cast<std::int64_t>(n);
    if (!seen.empty()) {
      chamfer += chamfer_distance(measured, seen);
      ++with_chamfer;
    }
    if (scored) scored();
  }
  if (score.returns == 0) return std::nullopt;
  const auto share = [&](double part) { return part / static_cast<double>(score.returns); };
  score.hit_rate = share(static_cast<double>(errors.size()));
  score.near_hit_rate = share(static_cast<double>(near));
  score.range_error_m = score.chamfer_m = std::numeric_limits<double>::quiet_NaN();
  if (errors.empty()) return score;
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  score.range_error_m = *middle;
  score.chamfer_m = chamfer / with_chamfer;
  return score;
}

}  // namespace redrive
