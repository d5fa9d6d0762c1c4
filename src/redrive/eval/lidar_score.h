// SPDX-License-Identifier: Apache-2.0
// Scores a run by LiDAR scans: each return is rendered from the sensor's position at its time along
// its own direction.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "redrive/base/progress.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// A rendered return within this of the recorded one counts for LidarScore::near_hit_rate.
constexpr double kNearHit_m = 0.2;

/// Errors over returns. NaN without a rendered return.
struct RangeScore {
  /// Recorded ones that did not train. A ray with two counts once, with the nearer to the rendered.
  std::int64_t returns = 0;
  double range_error_m = 0;       ///< median of |rendered - recorded| over the rendered returns
  double mean_range_error_m = 0;  ///< its mean
  double hit_rate = 0;            ///< fraction for which a return is rendered (render/lidar_scan.h)
  double near_hit_rate = 0;       ///< fraction for which one within kNearHit_m is
};

/// Rays of which nothing comes back, among all that were fired.
struct LostRayScore {
  std::int64_t rays = 0;  ///< lost and returned
  double accuracy = 0;    ///< share of the rays that are lost, or returned, as recorded
  double f1 = 0;          ///< 2 TP / (2 TP + FP + FN) of the lost rays; NaN where none is
};

/// Over all returns but those on moving objects that the run does not draw.
struct LidarScore : RangeScore {
  int revolutions = 0;
  double chamfer_m = 0;  ///< chamfer_distance of the recorded points and the rendered ones, mean
                         ///< over revolutions
  /// RMS error over the rendered returns, of 0..1; nothing where the method renders none.
  std::optional<double> intensity_rmse;
  /// Nothing where the method has no lost rays, or the beams of the sensor are unknown.
  std::optional<LostRayScore> lost;
  std::optional<RangeScore> moving;  ///< score of the returns on moving objects that the run draws
};

/// Returns the mean of the mean distances of each point of one set to the nearest of the other, in
/// both directions. Both must have points.
double chamfer_distance(const std::vector<Eigen::Vector3f>& a,
                        const std::vector<Eigen::Vector3f>& b);

/// Adds up the scores of scans, one after the other.
class LidarScores {
 public:
  /// `left_out`: objects whose returns do not count. All must outlive this.
  LidarScores(const Run& run, kernels::Backend& backend, const MovingObjects& left_out);
  ~LidarScores();
  /// Renders a scan and scores it.
  void add(const LidarReturns& scan, const SensorPoses& world_from_sensor);
  /// Adds the errors of other scans of the same run.
  void add(const LidarScores& other);
  /// Nothing without a return.
  std::optional<LidarScore> score();

 private:
  struct Sums;
  const Run& run_;
  kernels::Backend& backend_;
  MovingObjects drawn_;
  const MovingObjects& left_out_;
  std::unique_ptr<Sums> sums_;
};

/// Returns the frames whose scans did not train: none where no frame is held out, where the
/// recording has no scans, or where the run is of an earlier build, which trained on all.
std::vector<std::int64_t> held_out_revolutions(const Run& run);

/// Scores the scans of `frames` and counts them. `left_out`: objects whose returns do not count.
/// Nothing if they have no return. `of_lidars`: gets the score of each LiDAR, by its name, where
/// the recording has several.
std::optional<LidarScore> score_lidar(const Run& run, kernels::Backend& backend,
                                      const std::vector<std::int64_t>& frames,
                                      const MovingObjects& left_out, Progress* progress = nullptr,
                                      std::map<std::string, LidarScore>* of_lidars = nullptr);

}  // namespace redrive
