// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/lidar_score.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <limits>
#include <numeric>

#include <nanoflann.hpp>

#include "redrive/base/error.h"
#include "redrive/render/lidar_scan.h"

namespace redrive {
namespace {

using Cloud = std::vector<Eigen::Vector3f>;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

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

bool on_object(const std::vector<MovingBox>& boxes, const Eigen::Vector3d& in_world) {
  return std::ranges::any_of(boxes, [&](const MovingBox& box) {
    return is_on_object(box, box.box_from_world * in_world);
  });
}

/// Rays in the world and what is rendered along them.
struct Traced {
  LidarRays rays;
  RenderedRays rendered;

  bool comes_back(std::size_t i) const { return rendered.returned(i) >= kMinReturnOpacity; }
};

Traced trace(const Run& run, kernels::Backend& backend, std::span<const std::int64_t> t_ns,
             const std::function<Eigen::Vector3d(std::size_t)>& direction,
             const SensorPoses& world_from_sensor) {
  Traced out{fire(t_ns, direction, world_from_sensor, &backend.pool()), {}};
  out.rendered = run.field()->trace(
      backend, {static_cast<int>(t_ns.size()), out.rays.origin, out.rays.direction, t_ns},
      run.scene.actors);
  return out;
}

}  // namespace

double chamfer_distance(const Cloud& a, const Cloud& b) {
  REDRIVE_CHECK(!a.empty() && !b.empty());
  return (mean_distance(a, b) + mean_distance(b, a)) / 2;
}

std::vector<std::int64_t> held_out_revolutions(const Run& run) {
  if (run.recording.lidars.empty()) return {};
  const std::set<std::int64_t> held_out = held_out_frames(run.scene);
  std::set<std::int64_t> frames;
  for (const FrameFile& file : run.recording.lidar_files)
    if (held_out.contains(file.frame_id)) frames.insert(file.frame_id);
  return {frames.begin(), frames.end()};
}

struct LidarScores::Sums {
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
      RangeScore score{returns_, kNone, kNone, share(static_cast<double>(errors_.size())),
                       share(static_cast<double>(near_))};
      if (errors_.empty()) return score;
      const auto middle = errors_.begin() + static_cast<std::ptrdiff_t>(errors_.size() / 2);
      std::nth_element(errors_.begin(), middle, errors_.end());
      score.range_error_m = *middle;
      score.mean_range_error_m =
          std::reduce(errors_.begin(), errors_.end()) / static_cast<double>(errors_.size());
      return score;
    }
    std::int64_t returns() const { return returns_; }
    void add(const RangeErrors& other) {
      errors_.insert(errors_.end(), other.errors_.begin(), other.errors_.end());
      returns_ += other.returns_;
      near_ += other.near_;
    }

   private:
    std::vector<double> errors_;
    std::int64_t returns_ = 0, near_ = 0;
  };

  /// Adds up what is scored besides ranges.
  struct SignalErrors {
    double squares = 0;  // sum over the intensities of rendered returns
    double returned = 0, right_returned = 0, lost = 0, right_lost = 0;

    void add_return(bool rendered, double intensity_error) {
      ++returned;
      if (!rendered) return;
      ++right_returned;
      squares += intensity_error * intensity_error;
    }
    void add_lost(bool rendered) {
      ++lost;
      right_lost += !rendered;
    }
    void add(const SignalErrors& other) {
      squares += other.squares;
      returned += other.returned;
      right_returned += other.right_returned;
      lost += other.lost;
      right_lost += other.right_lost;
    }
    void set(LidarScore* score) const {
      if (right_returned > 0) score->intensity_rmse = std::sqrt(squares / right_returned);
      if (lost > 0)
        score->lost =
            LostRayScore{static_cast<std::int64_t>(returned + lost),
                         (right_returned + right_lost) / (returned + lost),
                         2 * right_lost / (right_lost + lost + returned - right_returned)};
    }
  };

  RangeErrors all, on_moving;
  SignalErrors signals;
  double chamfer = 0;
  int with_chamfer = 0, scans = 0;
};

LidarScores::LidarScores(const Run& run, kernels::Backend& backend, const MovingObjects& left_out)
    : run_(run),
      backend_(backend),
      drawn_(run.scene.actors),
      left_out_(left_out),
      sums_(std::make_unique<Sums>()) {}
LidarScores::~LidarScores() = default;

void LidarScores::add(const LidarScores& other) {
  const Sums& more = *other.sums_;
  sums_->all.add(more.all);
  sums_->on_moving.add(more.on_moving);
  sums_->signals.add(more.signals);
  sums_->chamfer += more.chamfer;
  sums_->with_chamfer += more.with_chamfer;
  sums_->scans += more.scans;
}

void LidarScores::add(const LidarReturns& scan, const SensorPoses& world_from_sensor) {
  if (scan.n == 0) return;
  const Traced traced = trace(
      run_, backend_, scan.t_ns, [&](std::size_t i) { return scan.direction_in_sensor(i); },
      world_from_sensor);
  const RenderedRays& rendered = traced.rendered;
  const bool has_signals = !rendered.lost.empty();
  const std::size_t sensor = scan.sensor_of(0);
  const std::vector<BeamGain>& beams = scan.sensors[sensor].beam_gains;
  const auto comes_back = [&](const Traced& of, std::size_t i, const Eigen::Vector3d& direction) {
    return of.comes_back(i) && !scan.sensors[sensor].is_blind(direction);
  };
  const float gain = scan.sensors[sensor].gain, full = scan.full_intensities()[sensor] / gain;
  Cloud measured, seen;
  std::vector<MovingBox> drawn, left_out;
  std::optional<std::int64_t> t_ns;
  for (std::size_t i = 0, end = 0; i < scan.n; i = end) {
    const LidarReturns::Ray ray = scan.ray_at(i, scan.n);
    end = ray.end;
    if (t_ns != scan.t_ns[i]) {
      t_ns = scan.t_ns[i];
      drawn = drawn_.at(*t_ns);
      left_out = left_out_.at(*t_ns);
    }
    const Eigen::Vector3f origin = traced.rays.origin_at(i),
                          direction = traced.rays.direction_at(i);
    const float depth_m = rendered.depth[i];
    const bool returned = comes_back(traced, i, scan.direction_in_sensor(i));
    std::optional<double> range_m;
    if (returned && depth_m >= kMinReturn_m && depth_m <= kMaxReturn_m) range_m = depth_m;
    std::size_t nearest = i;  // the ray's return nearest to the rendered one
    const auto off_m = [&](std::size_t k) { return std::abs(scan.range_m[k] - *range_m); };
    for (std::size_t k = i + 1; range_m && k < end; ++k)
      if (off_m(k) < off_m(nearest)) nearest = k;
    const auto at = [&](std::size_t k) {
      return Eigen::Vector3f(origin + scan.range_m[k] * direction);
    };
    const Eigen::Vector3d there = at(nearest).cast<double>();
    if (std::ranges::any_of(left_out, [&](const MovingBox& box) { return box.contains(there); }))
      continue;
    if (range_m) seen.push_back(origin + depth_m * direction);
    for (std::size_t k = i; k < end; ++k) measured.push_back(at(k));
    sums_->all.add(range_m, scan.range_m[nearest]);
    if (on_object(drawn, there)) sums_->on_moving.add(range_m, scan.range_m[nearest]);
    if (has_signals)
      sums_->signals.add_return(
          returned,
          double(gain * gain_of_ring(beams, scan.ring_of(ray.strongest)) * rendered.intensity[i] -
                 float(scan.intensity[ray.strongest]) / full));
  }
  ++sums_->scans;
  if (!seen.empty()) {
    sums_->chamfer += chamfer_distance(measured, seen);
    ++sums_->with_chamfer;
  }
  if (!has_signals || scan.lost.empty()) return;
  std::vector<std::int64_t> lost_ns;
  for (const LidarReturns::LostRay& ray : scan.lost) lost_ns.push_back(ray.t_ns);
  const Traced lost = trace(
      run_, backend_, lost_ns, [&](std::size_t i) { return scan.lost[i].direction.cast<double>(); },
      world_from_sensor);
  for (std::size_t i = 0; i < lost_ns.size(); ++i)
    sums_->signals.add_lost(comes_back(lost, i, scan.lost[i].direction.cast<double>()));
}

std::optional<LidarScore> LidarScores::score() {
  if (sums_->all.returns() == 0) return std::nullopt;
  LidarScore score;
  static_cast<RangeScore&>(score) = sums_->all.score();
  score.revolutions = sums_->scans;
  sums_->signals.set(&score);
  score.chamfer_m = sums_->with_chamfer > 0 ? sums_->chamfer / sums_->with_chamfer : kNone;
  if (sums_->on_moving.returns() > 0) score.moving = sums_->on_moving.score();
  return score;
}

std::optional<LidarScore> score_lidar(const Run& run, kernels::Backend& backend,
                                      const std::vector<std::int64_t>& frames,
                                      const MovingObjects& left_out, Progress* progress,
                                      std::map<std::string, LidarScore>* of_lidars) {
  const std::vector<RecordedLidar>& lidars = run.recording.lidars;
  std::deque<LidarScores> scores;
  for (std::size_t k = 0; k < lidars.size(); ++k) scores.emplace_back(run, backend, left_out);
  for (const std::int64_t frame : frames) {
    for (std::size_t k = 0; k < lidars.size(); ++k) {
      const LidarReturns recorded = load_lidar_returns(
          run.recording, run.scene, left_out, backend.pool(),
          {[&](std::int64_t id) { return id == frame; }, false, /*lost=*/true, /*lidar=*/k});
      scores[k].add(recorded, [&](std::int64_t t_ns) {
        return run.scene.world_from_body(t_ns) * lidars[k].body_from_lidar;
      });
    }
    if (progress) progress->count();
  }
  if (scores.empty()) return std::nullopt;
  for (std::size_t k = 0; of_lidars && lidars.size() > 1 && k < lidars.size(); ++k)
    if (const auto score = scores[k].score()) (*of_lidars)[lidars[k].name] = *score;
  for (std::size_t k = 1; k < lidars.size(); ++k) scores[0].add(scores[k]);
  return scores[0].score();
}

}  // namespace redrive
