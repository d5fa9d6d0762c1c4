// SPDX-License-Identifier: Apache-2.0
// Cuts the stages of --method grid into ranges and chunks. Sums are kept by chunk and added in
// their order, so that the number of threads changes nothing. A grid's gradients are parallel over
// its levels.
#include "redrive/kernels/grid/cpu/cpu_grid_stages.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/cpu/composite_range.h"
#include "redrive/kernels/grid/check_grid_sizes.h"
#include "redrive/kernels/grid/check_ray_sizes.h"
#include "redrive/kernels/grid/cpu/packed_network.h"
#include "redrive/kernels/grid/plain_grid_stages.h"

namespace redrive::kernels {
namespace {

constexpr std::size_t kPointsPerRange = 8192;  // a level's table is read once per range
constexpr int kTileSamples = 256;  // a network's activations stay in the second-level cache
constexpr int kBf16TileSamples =
    384;  // as above, in half the memory; 16 rays of 24 are whole strips

std::vector<GridLevel> levels_of(const HashGrid& grid) {
  std::vector<GridLevel> levels;
  for (const HashGridLevel& level : hash_grid_levels(grid.config))
    levels.push_back({level.resolution, level.rows - 1, level.dense,
                      grid.table.data() + level.offset, level.min_weight});
  return levels;
}

/// Points [begin, end).
GridPoints range_of(const UnitPoints& points, std::size_t begin, std::size_t end) {
  return {end - begin, points.position.data() + begin, points.stride > 0 ? points.stride : points.n,
          points.footprint.data() + begin};
}

class CpuGridStages final : public PlainGridStages {
 public:
  CpuGridStages(Isa isa, ThreadPool* pool)
      : PlainGridStages(pool),
        kernels_(isa == Isa::kAvx2 ? avx2::kGridKernels : avx512::kGridKernels),
        bf16_(isa == Isa::kAvx512Bf16 ? &avx512_bf16::kGridBf16Kernels : nullptr),
        pool_(*pool) {}

  void contract(const Contraction& contraction, const Rays& rays,
                std::span<const float> pixel_angle, const Intervals& intervals, float least_width,
                std::span<float> position, std::span<float> footprint) override {
    const int per_ray = intervals.per_ray;
    check_contract(rays, intervals, pixel_angle.size(), position.size(), footprint.size());
    const std::size_t n = interval_count(rays.n, per_ray);
    pool_.run_ranges(rays.n, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      kernels_.contract({.n_rays = static_cast<int>(end - begin),
                         .per_ray = per_ray,
                         .origin = rays.origin.data() + begin,
                         .direction = rays.direction.data() + begin,
                         .ray_stride = static_cast<std::size_t>(rays.n),
                         .pixel_angle = pixel_angle.data() + begin,
                         .edges = intervals.edges.data() + begin * (per_ray + 1),
                         .center = contraction.center.data(),
                         .half_m = contraction.half_m,
                         .unbounded = contraction.unbounded,
                         .least_width = least_width,
                         .position = position.data() + begin * per_ray,
                         .footprint = footprint.data() + begin * per_ray,
                         .stride = n});
    });
  }

  void encode(const HashGrid& grid, const UnitPoints& points, std::span<float> features) override {
    check_encode(grid, points, features.size());
    for_each_level_range(
        grid, points,
        [&](const GridLevel& level, std::size_t first_feature, const GridPoints& range) {
          kernels_.encode(grid.config.features_per_level, level, range,
                          features.data() + first_feature);
        });
  }

  void encode_backward(const HashGrid& grid, const UnitPoints& points,
                       std::span<const float> d_features, std::span<float> d_table,
                       std::span<float> d_position) override {
    check_encode_backward(grid, points, d_features.size(), d_table.size(), d_position.size());
    backward_of_levels(grid, points, d_features.data(), points.n * grid.config.features_per_level,
                       d_table);
    if (d_position.empty()) return;
    std::ranges::fill(d_position, 0.0f);
    const auto levels = levels_of(grid);
    pool_.run_ranges(points.n, kPointsPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t l = 0; l < levels.size(); ++l)
        kernels_.encode_backward(
            grid.config.features_per_level, levels[l], range_of(points, begin, end),
            d_features.data() + (l * points.n + begin) * grid.config.features_per_level, nullptr,
            d_position.data() + begin);
    });
  }

  void network_forward(const GridNetwork& network, int n_rays, int per_ray,
                       std::span<const float> features, std::span<const float> harmonics,
                       std::span<float> raw) override {
    check_network(network, n_rays, per_ray, features.size(), harmonics.size(), raw.size());
    with_weights(network, [&](const auto& kernels, const auto& weights) {
      for_each_tile(network, n_rays, per_ray, [&](int, int first, int count, float* scratch) {
        kernels.network_forward(
            weights, tile_of(network, n_rays, per_ray, first, count, features, harmonics),
            raw.data() + interval_count(first, per_ray), scratch);
      });
    });
  }

  void network_backward(const GridNetwork& network, int n_rays, int per_ray,
                        std::span<const float> features, std::span<const float> harmonics,
                        std::span<const float> d_raw, std::span<float> d_weights,
                        std::span<float> d_features) override {
    check_network_backward(network, n_rays, per_ray, features.size(), harmonics.size(),
                           d_raw.size(), d_weights.size(), d_features.size());
    const std::size_t size = network.weights.size();
    std::vector<Buffer<float>> sums(kChunksPerBatch);
    for (Buffer<float>& sum : sums) sum = Buffer<float>(size);
    with_weights(network, [&](const auto& kernels, const auto& weights) {
      for_each_tile(network, n_rays, per_ray, [&](int chunk, int first, int count, float* scratch) {
        const std::size_t sample = interval_count(first, per_ray);
        const auto at = [&](int layer) {
          return sums[chunk].data() + grid_layer(network.config, layer).offset;
        };
        kernels.network_backward(
            weights, tile_of(network, n_rays, per_ray, first, count, features, harmonics),
            d_raw.data() + sample,
            {at(kGridDensity0), at(kGridDensity1), at(kGridColour0), at(kGridColour1),
             at(kGridColourOut)},
            d_features.data() + sample * network.config.grid.features_per_level, scratch);
      });
    });
    for (const Buffer<float>& sum : sums)
      for (std::size_t i = 0; i < size; ++i) d_weights[i] += sum[i];
  }

  void proposal_density(const HashGrid& grid, float density_scale, const UnitPoints& points,
                        std::span<float> density) override {
    check_proposal_density(grid, points, density.size());
    const auto levels = levels_of(grid);
    pool_.run_ranges(points.n, kPointsPerRange, [&](std::size_t begin, std::size_t end) {
      kernels_.density(levels.data(), static_cast<int>(levels.size()), density_scale,
                       range_of(points, begin, end), density.data() + begin);
    });
  }

  void proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                 std::span<const float> density, std::span<const float> d_density,
                                 std::span<float> d_table) override {
    check_proposal_density_backward(grid, points, density.size(), d_density.size(), d_table.size());
    std::vector<float> d_sum(points.n);
    pool_.run_ranges(points.n, kPointsPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) d_sum[i] = density[i] * d_density[i];
    });
    backward_of_levels(grid, points, d_sum.data(), 0, d_table);
  }

  void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
               std::span<float> weights) override {
    const int per_ray = intervals.per_ray;
    check_weights(n_rays, intervals, density.size(), weights.size());
    pool_.run_ranges(n_rays, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      Buffer<float> scratch(per_ray + 16);
      kernels_.weights(static_cast<int>(end - begin), per_ray,
                       &intervals.edges[begin * (per_ray + 1)], &density[begin * per_ray],
                       &weights[begin * per_ray], scratch.data());
    });
  }

  void weights_backward(int n_rays, const Intervals& intervals, std::span<const float> density,
                        std::span<const float> weights, std::span<const float> d_weights,
                        std::span<float> d_density) override {
    const int per_ray = intervals.per_ray;
    check_weights_backward(n_rays, intervals, density.size(), weights.size(), d_weights.size(),
                           d_density.size());
    pool_.run_ranges(n_rays, kRaysPerRange, [&](std::size_t begin, std::size_t end) {
      Buffer<float> scratch(per_ray + 16);
      const std::size_t first = begin * per_ray;
      kernels_.weights_backward(
          static_cast<int>(end - begin), per_ray, &intervals.edges[begin * (per_ray + 1)],
          &density[first], &weights[first], &d_weights[first], &d_density[first], scratch.data());
    });
  }

 private:
  /// visit(level, first feature, points) for all points, the coarsest level first: so that one
  /// table at a time is in the caches.
  template <class Visit>
  void for_each_level_range(const HashGrid& grid, const UnitPoints& points, const Visit& visit) {
    const auto levels = levels_of(grid);
    const std::size_t ranges = (points.n + kPointsPerRange - 1) / kPointsPerRange;
    pool_.run(static_cast<int>(levels.size() * ranges), [&](int task) {
      const std::size_t l = task / ranges, begin = task % ranges * kPointsPerRange;
      visit(levels[l], (l * points.n + begin) * grid.config.features_per_level,
            range_of(points, begin, std::min(points.n, begin + kPointsPerRange)));
    });
  }

  /// Level l takes d[l * step ...], [n, features]. Starts with the finest, which takes longest.
  void backward_of_levels(const HashGrid& grid, const UnitPoints& points, const float* d,
                          std::size_t step, std::span<float> d_table) {
    const auto levels = levels_of(grid);
    pool_.run(static_cast<int>(levels.size()), [&](int task) {
      const std::size_t l = levels.size() - 1 - task;
      kernels_.encode_backward(grid.config.features_per_level, levels[l],
                               range_of(points, 0, points.n), d + l * step,
                               d_table.data() + (levels[l].rows - grid.table.data()), nullptr);
    });
  }

  static GridNetworkTile tile_of(const GridNetwork& network, int n_rays, int per_ray, int first,
                                 int count, std::span<const float> features,
                                 std::span<const float> harmonics) {
    return {
        .n_rays = count,
        .per_ray = per_ray,
        .features = features.data() +
                    interval_count(first, per_ray) * network.config.grid.features_per_level,
        .harmonics = harmonics.data() + static_cast<std::size_t>(first) * kHarmonics,
        .n_levels = network.config.grid.n_levels,
        .features_per_level = network.config.grid.features_per_level,
        .level_stride = interval_count(n_rays, per_ray) * network.config.grid.features_per_level,
        .raw_stride = interval_count(n_rays, per_ray)};
  }

  /// visit(kernels, weights) with the networks' arithmetic.
  template <class Visit>
  void with_weights(const GridNetwork& network, const Visit& visit) {
    if (bf16_)
      visit(*bf16_, PackedBf16Network(network).weights());
    else
      visit(kernels_, PackedNetwork(network).weights());
  }

  /// visit(chunk, first ray, rays, scratch) for tiles of whole rays; the tiles of a chunk are
  /// consecutive and in order.
  template <class Visit>
  void for_each_tile(const GridNetwork& network, int n_rays, int per_ray, const Visit& visit) {
    const int rays = bf16_ ? std::clamp(kBf16TileSamples / per_ray, 1, kGridBf16Rays)
                           : std::max(1, kTileSamples / per_ray),
              tiles = (n_rays + rays - 1) / rays;
    pool_.run(kChunksPerBatch, [&](int chunk) {
      const int begin = static_cast<int>(std::int64_t{tiles} * chunk / kChunksPerBatch),
                end = static_cast<int>(std::int64_t{tiles} * (chunk + 1) / kChunksPerBatch);
      if (begin == end) return;
      Buffer<float>& scratch = scratch_[chunk];
      const int width = network.config.width, inputs = network.config.grid.outputs();
      const std::size_t size =
          bf16_ ? grid_bf16_scratch(rays * per_ray, width, inputs)
                : grid_network_scratch(interval_count(rays, per_ray), rays, width, inputs);
      if (scratch.size() < size) scratch = Buffer<float>(size);
      for (int tile = begin; tile < end; ++tile)
        visit(chunk, tile * rays, std::min(rays, n_rays - tile * rays), scratch.data());
    });
  }

  const GridKernels& kernels_;
  const GridBf16Kernels* const bf16_;  ///< the networks', unless they are fp32
  ThreadPool& pool_;
  /// scratch of the networks, one per chunk; kept from call to call
  Buffer<float> scratch_[kChunksPerBatch];
};

}  // namespace

std::unique_ptr<GridStages> make_cpu_grid_stages(Isa isa, ThreadPool* pool) {
  return std::make_unique<CpuGridStages>(isa, pool);
}

}  // namespace redrive::kernels
