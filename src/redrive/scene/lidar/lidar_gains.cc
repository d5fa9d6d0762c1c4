// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_gains.h"

#include <algorithm>

#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

constexpr double kVoxel_m = 0.3;
constexpr int kLeastInVoxel = 3;  // returns of each sensor
constexpr std::size_t kLeastVoxels = 30, kMostReturns = 4'000'000, kReturnsOfPart = 4096;

struct Mean {
  double sum = 0;
  int n = 0;

  double value() const { return sum / n; }
};

}  // namespace

std::vector<float> estimate_gains(const Scene& scene, const LidarReturns& returns,
                                  ThreadPool& pool) {
  const std::size_t every = 1 + returns.n / kMostReturns, n = returns.n / every;
  std::vector<std::uint64_t> keys(n);
  pool.run_ranges(n, kReturnsOfPart, [&](std::size_t begin, std::size_t end) {
    LidarPoses poses(scene, returns, Poses::kRecorded);
    for (std::size_t i = begin; i < end; ++i)
      keys[i] = voxel_key(voxel_of(poses.in_world(every * i), kVoxel_m));
  });
  std::vector<float> full = returns.full_intensities();
  for (std::size_t k = 0; k < full.size(); ++k) full[k] /= returns.sensors[k].gain;
  std::vector<std::vector<double>> ratios(full.size());
  const VoxelGroups voxels(keys);
  for (std::size_t v = 0; v < voxels.size(); ++v) {
    std::vector<Mean> means(full.size());
    for (const std::uint32_t i : voxels[v]) {
      const std::size_t sensor = returns.sensor_of(every * i);
      means[sensor].sum += double(returns.intensity[every * i]) / double(full[sensor]);
      ++means[sensor].n;
    }
    if (means[0].n < kLeastInVoxel || !(means[0].sum > 0)) continue;
    for (std::size_t k = 1; k < means.size(); ++k)
      if (means[k].n >= kLeastInVoxel) ratios[k].push_back(means[k].value() / means[0].value());
  }
  std::vector<float> gains(full.size(), 1.0f);
  for (std::size_t k = 1; k < gains.size(); ++k) {
    if (ratios[k].size() < kLeastVoxels) continue;
    const auto middle = ratios[k].begin() + static_cast<std::ptrdiff_t>(ratios[k].size() / 2);
    std::ranges::nth_element(ratios[k], middle);
    if (*middle > 0) gains[k] = static_cast<float>(*middle);
  }
  return gains;
}

}  // namespace redrive
