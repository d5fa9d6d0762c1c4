// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/planes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "redrive/math/plane_fit.h"
#include "redrive/math/voxel_grid.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

constexpr int kMinPoints = 10;
constexpr std::int64_t kApart_ns = 50'000'000;  // half a revolution
constexpr int kMinTimes = 3;
constexpr std::size_t kMaxSamplesOfPatch =
    40;  // more points of one patch add little: they share its roughness
constexpr double kMinSigma_m = 0.005;
constexpr double kMinInliers = 0.75;  // share of a cell's points that have to lie on its plane

/// Samples and their positions by the present corrections.
struct WorldSamples {
  const std::vector<LidarSample>& samples;
  std::vector<Eigen::Vector3d> in_world;
};

/// The number of times, at least kApart_ns apart, at which the chosen samples were measured.
int count_times(const WorldSamples& points, const std::vector<int>& chosen) {
  std::vector<std::int64_t> times;
  for (const int i : chosen) times.push_back(points.samples[i].t_ns);
  std::sort(times.begin(), times.end());
  int count = 0;
  std::int64_t last = times.front() - kApart_ns;
  for (const std::int64_t t : times)
    if (t - last >= kApart_ns) {
      ++count;
      last = t;
    }
  return count;
}

/// Fits a plane by principal axes, and again three times to the inliers of the last fit.
std::optional<PlanarPatch> fit(const WorldSamples& points, const std::vector<int>& chosen,
                               const PlaneOptions& options) {
  std::vector<int> on = chosen;
  PlanarPatch patch;
  double sigma_m = 0;
  for (int round = 0; round < 4; ++round) {
    if (static_cast<int>(on.size()) < kMinPoints) return std::nullopt;
    const PlaneFit plane = fit_plane(on, [&](int i) { return points.in_world[i]; });
    const Eigen::Vector3d sd = plane.extent();
    sigma_m = sd[0];
    if (sd[1] < 0.08 || sd[1] < 3 * sd[0]) return std::nullopt;  // a line or a volume
    patch.plane.centre = plane.mean;
    patch.plane.axes = plane.axes.rowwise().reverse();
    if (round == 3) break;
    on.clear();
    const double far_m = std::max(2.5 * sigma_m, 0.02);
    for (const int i : chosen)
      if (std::abs(plane.normal().dot(points.in_world[i] - plane.mean)) <= far_m) on.push_back(i);
  }
  if (sigma_m > options.max_plane_sigma_m ||
      static_cast<double>(on.size()) < kMinInliers * static_cast<double>(chosen.size()))
    return std::nullopt;
  if (count_times(points, on) < kMinTimes) return std::nullopt;
  const double n = static_cast<double>(on.size());
  patch.sigma_m = std::max(kMinSigma_m, sigma_m * std::sqrt(n / (n - 3)));
  patch.samples = std::move(on);
  return patch;
}

void divide(const WorldSamples& points, const std::vector<int>& chosen,
            const Eigen::Vector3d& corner, double edge_m, const PlaneOptions& options,
            std::vector<PlanarPatch>* patches) {
  if (static_cast<int>(chosen.size()) < kMinPoints) return;
  if (auto patch = fit(points, chosen, options)) {
    patches->push_back(std::move(*patch));
    return;
  }
  const double half_m = edge_m / 2;
  if (half_m < options.min_cell_m) return;
  std::array<std::vector<int>, 8> parts;
  for (const int i : chosen) {
    const Eigen::Vector3d inside = points.in_world[i] - corner;
    parts[(inside.x() >= half_m) + 2 * (inside.y() >= half_m) + 4 * (inside.z() >= half_m)]
        .push_back(i);
  }
  for (int k = 0; k < 8; ++k)
    divide(points, parts[k], corner + half_m * Eigen::Vector3d(k & 1, k >> 1 & 1, k >> 2), half_m,
           options, patches);
}

/// Keeps at most max_values of them, evenly chosen, in their order.
template <class T>
void keep_evenly(std::vector<T>* values, std::size_t max_values) {
  const std::size_t n = values->size();
  if (n <= max_values) return;
  for (std::size_t i = 0; i < max_values; ++i)
    if (const std::size_t from = i * n / max_values; from != i)
      (*values)[i] = std::move((*values)[from]);
  values->resize(max_values);
}

/// Reduces patches to max_samples in all. A third of them goes to patches that face along each axis
/// of the world: on a motorway nearly all patches are road, and the few that constrain the motion
/// along it must not be dropped.
void subsample_patches(std::vector<PlanarPatch>* patches, int max_samples) {
  std::size_t all = 0;
  for (const PlanarPatch& patch : *patches) all += patch.samples.size();
  if (all <= static_cast<std::size_t>(max_samples)) return;
  std::array<std::vector<PlanarPatch>, 3> facing;
  for (PlanarPatch& patch : *patches) {
    keep_evenly(&patch.samples, kMaxSamplesOfPatch);
    Eigen::Index axis = 0;
    patch.plane.axes.col(2).cwiseAbs().maxCoeff(&axis);
    facing[axis].push_back(std::move(patch));
  }
  std::ranges::sort(facing, {}, [](const std::vector<PlanarPatch>& a) { return a.size(); });
  std::size_t left = static_cast<std::size_t>(max_samples);
  patches->clear();
  for (std::size_t k = 0; k < 3; ++k) {
    keep_evenly(&facing[k], left / (3 - k) / kMaxSamplesOfPatch);
    for (PlanarPatch& patch : facing[k]) {
      left -= std::min(left, patch.samples.size());
      patches->push_back(std::move(patch));
    }
  }
}

}  // namespace

std::vector<LidarSample> lidar_samples(const Recording& recording, const LidarReturns& returns) {
  std::vector<LidarSample> samples;
  samples.reserve(returns.n);
  if (returns.n == 0) return samples;
  std::vector<float> unit = returns.full_intensities();
  for (float& of_sensor : unit) of_sensor = 255 / of_sensor;
  for (std::size_t i = 0; i < returns.n; ++i) {
    const std::int64_t t_ns = returns.t_ns[i];
    if (t_ns < recording.frames.front().t_ns || t_ns > recording.frames.back().t_ns) continue;
    const std::size_t sensor = returns.sensor_of(i);
    samples.push_back({returns.sensors[sensor].body_from_sensor * returns.in_sensor(i), t_ns,
                       unit[sensor] * returns.intensity[i], sensor});
  }
  return samples;
}

std::vector<LidarSample> load_lidar_samples(const Recording& recording, const Scene& scene,
                                            const MovingObjects& moving, ThreadPool& pool) {
  return lidar_samples(recording, load_lidar_returns(recording, scene, moving, pool));
}

std::vector<LidarSample> subsample_evenly(std::vector<LidarSample> samples,
                                          std::size_t max_samples) {
  keep_evenly(&samples, max_samples);
  return samples;
}

std::vector<PlanarPatch> find_planar_patches(const RigModel& model,
                                             const std::vector<LidarSample>& samples,
                                             const PlaneOptions& options, ThreadPool& pool) {
  WorldSamples points{samples, std::vector<Eigen::Vector3d>(samples.size())};
  std::vector<std::uint64_t> keys(samples.size());
  transform_samples(model, samples, pool, [&](std::size_t i, const Eigen::Vector3d& in_world) {
    points.in_world[i] = in_world;
    keys[i] = voxel_key(voxel_of(in_world, options.max_cell_m));
  });
  const VoxelGroups cells(keys, &pool);
  std::vector<std::vector<PlanarPatch>> found(cells.size());
  pool.run_ranges(found.size(), 64, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const std::vector<int> chosen(cells[c].begin(), cells[c].end());
      const Eigen::Vector3d corner =
          options.max_cell_m *
          voxel_of(points.in_world[chosen[0]], options.max_cell_m).cast<double>();
      divide(points, chosen, corner, options.max_cell_m, options, &found[c]);
    }
  });
  std::vector<PlanarPatch> patches;
  for (std::vector<PlanarPatch>& of_cell : found)
    for (PlanarPatch& patch : of_cell) patches.push_back(std::move(patch));
  subsample_patches(&patches, options.max_terms);
  return patches;
}

}  // namespace redrive
