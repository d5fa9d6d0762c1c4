// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_gains.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

constexpr double kVoxel_m = 0.3, kBeamVoxel_m = 0.2;
constexpr int kLeastInVoxel = 3;  // returns of each sensor
constexpr std::size_t kLeastVoxels = 30, kMostReturns = 4'000'000, kReturnsOfPart = 4096;

struct Mean {
  double sum = 0;
  int n = 0;

  double value() const { return sum / n; }
};

/// Returns the voxel of every `every`-th return.
std::vector<std::uint64_t> voxels_of(const Scene& scene, const LidarReturns& returns,
                                     std::size_t every, double voxel_m, ThreadPool& pool) {
  std::vector<std::uint64_t> keys(returns.n / every);
  pool.run_ranges(keys.size(), kReturnsOfPart, [&](std::size_t begin, std::size_t end) {
    LidarPoses poses(scene, returns, Poses::kRecorded);
    for (std::size_t i = begin; i < end; ++i)
      keys[i] = voxel_key(voxel_of(poses.in_world(every * i), voxel_m));
  });
  return keys;
}

/// Products of a beam's intensities and of what other beams measured there.
struct BeamSums {
  double both = 0, others = 0;
  std::size_t n = 0;
};

/// Returns the beam gains of a sensor. `keys`: voxels of every `every`-th return.
std::vector<BeamGain> beam_gains(const LidarReturns& returns, std::size_t sensor, std::size_t every,
                                 const std::vector<std::uint64_t>& keys) {
  constexpr int kRounds = 5;
  constexpr std::size_t kLeastReturns = 500;
  std::array<Mean, kNoRing> elevations;
  std::vector<std::uint32_t> own;
  std::vector<std::uint64_t> own_keys;
  int rings = 0;
  for (std::size_t i = 0; i < keys.size(); ++i) {
    const std::uint8_t ring = returns.ring[every * i];
    if (ring == kNoRing || returns.sensor_of(every * i) != sensor) continue;
    elevations[ring].sum +=
        std::asin(std::clamp(double(returns.direction[2 * returns.n + every * i]), -1.0, 1.0));
    ++elevations[ring].n;
    rings = std::max(rings, ring + 1);
    own.push_back(static_cast<std::uint32_t>(every * i));
    own_keys.push_back(keys[i]);
  }
  if (rings < 2) return {};
  std::vector<BeamGain> gains(static_cast<std::size_t>(rings));
  for (std::size_t r = 0; r < gains.size(); ++r)
    if (elevations[r].n > 0) gains[r].elevation_rad = static_cast<float>(elevations[r].value());
  const VoxelGroups voxels(own_keys);
  std::size_t known = 0;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<BeamSums> sums(gains.size());
    std::array<Mean, kNoRing> of_ring;
    for (std::size_t v = 0; v < voxels.size(); ++v) {
      Mean all;
      std::fill_n(of_ring.begin(), gains.size(), Mean());
      for (const std::uint32_t k : voxels[v]) {
        const std::uint8_t ring = returns.ring[own[k]];
        const double level = double(returns.intensity[own[k]]) / double(gains[ring].gain);
        all.sum += level, ++all.n;
        of_ring[ring].sum += level, ++of_ring[ring].n;
      }
      for (std::size_t r = 0; r < gains.size(); ++r) {
        const Mean& mine = of_ring[r];
        if (mine.n == 0 || all.n - mine.n < kLeastInVoxel) continue;
        const double others = (all.sum - mine.sum) / (all.n - mine.n);
        sums[r].both += double(gains[r].gain) * mine.sum * others;
        sums[r].others += mine.n * others * others;
        sums[r].n += static_cast<std::size_t>(mine.n);
      }
    }
    const auto tells = [&](std::size_t r) {
      return sums[r].n >= kLeastReturns && sums[r].both > 0 && sums[r].others > 0;
    };
    double log_sum = 0;
    known = 0;
    for (std::size_t r = 0; r < gains.size(); ++r)
      if (tells(r)) {
        gains[r].gain = static_cast<float>(sums[r].both / sums[r].others);
        log_sum += std::log(double(gains[r].gain));
        ++known;
      }
    const auto mean =
        static_cast<float>(std::exp(log_sum / double(std::max<std::size_t>(1, known))));
    for (std::size_t r = 0; r < gains.size(); ++r)
      if (tells(r)) gains[r].gain /= mean;
  }
  return known < 2 ? std::vector<BeamGain>() : gains;
}

/// Returns the blind directions of each sensor.
std::vector<BlindDirections> blind_directions(const Scene& scene, const LidarReturns& returns) {
  constexpr double kSteepest_z = -0.1;  // sine of the elevation: -6 degrees
  constexpr double kLeastDriven_m = 10, kLost = 0.97;
  constexpr std::uint32_t kLeastRays = 20;
  std::vector<BlindDirections> blind(returns.sensors.size());
  double driven_m = 0;  // steps would add up the noise of a parked car's poses
  const std::vector<PosedFrame> frames = scene.posed_frames();
  for (const PosedFrame& frame : frames)
    driven_m = std::max(driven_m, (frame.world_from_body.translation() -
                                   frames.front().world_from_body.translation())
                                      .norm());
  if (driven_m < kLeastDriven_m) return blind;
  struct Rays {
    std::uint32_t all = 0, hidden = 0;
  };
  std::vector<std::vector<Rays>> cells(blind.size(), std::vector<Rays>(BlindDirections::kCells));
  const auto count = [&](std::size_t sensor, const Eigen::Vector3d& direction, bool hidden) {
    const Eigen::Vector3d in_body = returns.sensors[sensor].body_from_sensor.linear() * direction;
    if (in_body.z() > kSteepest_z) return;
    Rays& cell = cells[sensor][BlindDirections::cell_of(in_body)];
    ++cell.all;
    cell.hidden += hidden;
  };
  LidarReturns::ScanEnd begin;
  for (const LidarReturns::ScanEnd& end : returns.scan_ends) {
    for (std::size_t i = begin.returns; i < end.returns; ++i)
      count(end.sensor, returns.direction_in_sensor(i), false);
    for (std::size_t i = begin.on_objects; i < end.on_objects; ++i)
      if (returns.on_objects[i].range_m > 0)
        count(end.sensor, returns.on_objects[i].direction.cast<double>(), false);
    for (std::size_t i = begin.lost; i < end.lost; ++i)
      count(end.sensor, returns.lost[i].direction.cast<double>(), true);
    begin = end;
  }
  for (std::size_t k = 0; k < blind.size(); ++k) {
    for (const Eigen::Vector3f& direction : returns.sensors[k].on_ego)
      count(k, direction.cast<double>(), true);
    for (std::size_t i = 0; i < cells[k].size(); ++i)
      if (cells[k][i].all >= kLeastRays && cells[k][i].hidden >= kLost * cells[k][i].all)
        blind[k].insert(i);
  }
  return blind;
}

}  // namespace

std::vector<LidarGains> estimate_gains(const Scene& scene, const LidarReturns& returns,
                                       ThreadPool& pool) {
  const std::size_t every = 1 + returns.n / kMostReturns;
  std::vector<LidarGains> gains(returns.sensors.size());
  std::vector<BlindDirections> blind = blind_directions(scene, returns);
  for (std::size_t k = 0; k < gains.size(); ++k) gains[k].blind = std::move(blind[k]);
  if (!returns.ring.empty()) {
    const std::vector<std::uint64_t> keys = voxels_of(scene, returns, every, kBeamVoxel_m, pool);
    pool.run(static_cast<int>(gains.size()), [&](int k) {
      gains[std::size_t(k)].beams = beam_gains(returns, std::size_t(k), every, keys);
    });
  }
  if (gains.size() < 2) return gains;
  const std::vector<std::uint64_t> keys = voxels_of(scene, returns, every, kVoxel_m, pool);
  std::vector<float> full = returns.full_intensities();
  for (std::size_t k = 0; k < full.size(); ++k) full[k] /= returns.sensors[k].gain;
  std::vector<std::vector<double>> ratios(full.size());
  const VoxelGroups voxels(keys, &pool);
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
  for (std::size_t k = 1; k < gains.size(); ++k) {
    if (ratios[k].size() < kLeastVoxels) continue;
    const auto middle = ratios[k].begin() + static_cast<std::ptrdiff_t>(ratios[k].size() / 2);
    std::ranges::nth_element(ratios[k], middle);
    if (*middle > 0) gains[k].gain = static_cast<float>(*middle);
  }
  return gains;
}

std::vector<LidarGains> mean_gains(const std::vector<std::vector<LidarGains>>& estimates) {
  struct Sum {
    double log_gain = 0, elevation_rad = 0;
    int n = 0;
    void add(const BeamGain& beam) {
      log_gain += std::log(double(beam.gain));
      elevation_rad += double(beam.elevation_rad);
      ++n;
    }
    BeamGain mean() const {
      return {static_cast<float>(elevation_rad / n), static_cast<float>(std::exp(log_gain / n))};
    }
  };
  std::vector<Sum> sensors;
  std::vector<std::vector<Sum>> beams;
  std::vector<std::vector<int>> blind;
  for (const std::vector<LidarGains>& estimate : estimates) {
    sensors.resize(std::max(sensors.size(), estimate.size()));
    beams.resize(sensors.size());
    blind.resize(sensors.size(), std::vector<int>(BlindDirections::kCells));
    for (std::size_t k = 0; k < estimate.size(); ++k) {
      sensors[k].add({0, estimate[k].gain});
      beams[k].resize(std::max(beams[k].size(), estimate[k].beams.size()));
      for (std::size_t b = 0; b < estimate[k].beams.size(); ++b)
        beams[k][b].add(estimate[k].beams[b]);
      for (const BlindDirections::Run& run : estimate[k].blind.runs())
        for (std::size_t cell = run[0]; cell < run[0] + run[1]; ++cell) ++blind[k][cell];
    }
  }
  std::vector<LidarGains> means;
  for (std::size_t k = 0; k < sensors.size(); ++k) {
    means.push_back({sensors[k].mean().gain, {}});
    for (const Sum& beam : beams[k]) means.back().beams.push_back(beam.mean());
    for (std::size_t cell = 0; cell < BlindDirections::kCells; ++cell)
      if (2 * blind[k][cell] > sensors[k].n) means.back().blind.insert(cell);
  }
  return means;
}

}  // namespace redrive
