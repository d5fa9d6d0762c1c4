// SPDX-License-Identifier: Apache-2.0
// Benchmarks of method splat (model/benchmark.h).
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/splat_model.h"

namespace redrive::bench {
namespace {

void fill_street(const SyntheticDrive& drive, int n, Trainee* trainee) {
  auto& model = static_cast<SplatModel&>(*trainee);
  const Rigid3d world_from_camera = drive.scene.world_from_camera(drive.scene.views[0]);
  const std::uint64_t key = random_key(1, kStreamTest);
  const int actors = static_cast<int>(drive.scene.actors.size()),
            of_actors = actors > 0 ? n / 4 : 0;
  std::vector<GaussianList> lists(1 + drive.scene.actors.size());
  const auto unit = [&](int i, int k) {
    return double(random_unit(key, 8 * std::uint64_t(i) + std::uint64_t(k)));
  };
  const auto put = [&](int i, const Eigen::Vector3d& at, double size, double distance,
                       GaussianList* list) {
    list->rows.resize(list->rows.size() + kGaussianRows);
    float* const rows = &*(list->rows.end() - kGaussianRows);
    for (int k = 0; k < 3; ++k) {
      rows[kPositionRow + k] = static_cast<float>(at[k]);
      rows[kLogScaleRow + k] = static_cast<float>(std::log(size * (0.3 + unit(i, 3 + k))));
      rows[kColourRow + k] = static_cast<float>(unit(i, 5 + k));
    }
    rows[kQuaternionRow] = 1;
    rows[kOpacityRow] = static_cast<float>(3 * unit(i, 6));
    rows[kDistanceRow] = static_cast<float>(distance);
  };
  for (int i = 0; i < n - of_actors; ++i) {
    // Distances as LiDAR and images have them: even in their logarithm, 3 to 100 m.
    const double z = 3 * std::pow(100.0 / 3, unit(i, 0)), side = 2 * unit(i, 1) - 1;
    const int surface = static_cast<int>(3 * unit(i, 2));  // road, left, right
    const Eigen::Vector3d at = surface == 0   ? Eigen::Vector3d(8 * side, 1.5, z)
                               : surface == 1 ? Eigen::Vector3d(-8, 1.5 - 10 * unit(i, 1), z)
                                              : Eigen::Vector3d(8, 1.5 - 10 * unit(i, 1), z);
    const double size = 0.5 * z * std::sqrt(3 * 16 * std::log(100.0 / 3) / (z * n));
    put(i, world_from_camera * at, size, at.norm(), lists.data());
  }
  for (int i = n - of_actors; i < n; ++i) {
    const auto actor = static_cast<std::size_t>(i % actors);
    const Eigen::Vector3d at =
        Eigen::Vector3d(unit(i, 0), unit(i, 1), unit(i, 2)) - Eigen::Vector3d::Constant(0.5);
    put(i, drive.scene.actors[actor].size_m.cwiseProduct(at), 0.05, 10, &lists[1 + actor]);
  }
  model.set_gaussians(lists, drive.scene.actors);
}

}  // namespace
}  // namespace redrive::bench

namespace redrive {

bench::MethodBenchmarks splat_benchmarks() { return {.fill = bench::fill_street}; }

}  // namespace redrive
