// SPDX-License-Identifier: Apache-2.0
// The networks of the cpu backend one by one, at the level of tiles and chunks.
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "all_near.h"
#include "nerf_case.h"
#include "redrive/kernels/nerf/cpu/nerf_tile.h"

namespace redrive::kernels::conformance {
namespace {

struct Network {
  std::string name;
  Isa needs;
  double roundoff;
  std::unique_ptr<NerfNetwork> (*make)(const NerfConfig& config);
};
void PrintTo(const Network& network, std::ostream* out) { *out << network.name; }

class EveryNetwork : public testing::TestWithParam<Network> {
 protected:
  void SetUp() override {
    if (const auto obstacle = isa_obstacle(GetParam().needs))
      GTEST_SKIP() << GetParam().name << ": " << *obstacle;
  }
};

INSTANTIATE_TEST_SUITE_P(
    Networks, EveryNetwork,
    testing::Values(Network{"avx2", Isa::kAvx2, kFp32Roundoff, make_nerf_avx2},
                    Network{"avx512", Isa::kAvx512, kFp32Roundoff, make_nerf_avx512},
                    Network{"avx512_bf16", Isa::kAvx512Bf16, kBf16Roundoff, make_nerf_avx512_bf16}),
    [](const auto& info) { return info.param.name; });

/// Returns a case whose points are exact as floats in the unit cube, as in tiles: multiples of
/// 2^-20 below 2. (A cast to float and back does not work: g++ 12.2 drops it at -O2 when it
/// vectorises this loop.)
NerfCase tile_case(const NerfConfig& config) {
  NerfCase nerf(config);
  for (Point& point : nerf.points)
    for (int k = 0; k < 3; ++k) {
      point.position[k] = std::round(point.position[k] * 0x1p20) * 0x1p-20;
      point.position_error[k] = 0;
    }
  return nerf;
}

/// The rays [first, first + count) of a batch as a tile, with its part of an upstream gradient.
/// Rows of `raw` and `d_raw` are longer than the tile and NaN beyond it, which must not change any
/// result.
struct TileData {
  std::vector<float> position, direction, raw, d_raw, d_position;
  std::vector<int> point;
  NerfTile tile;
  int stride;

  TileData(const NerfCase& nerf, const NerfBatch& batch, int first, int count,
           const std::vector<double>& factor, const std::vector<std::array<double, 4>>& vector) {
    const int n = count * batch.per_ray, offset = first * batch.per_ray;
    point.assign(batch.point.begin() + offset, batch.point.begin() + offset + n);
    for (int k = 0; k < 3; ++k) {
      for (const int p : point) position.push_back(static_cast<float>(nerf.points[p].position[k]));
      for (int ray = first; ray < first + count; ++ray)
        direction.push_back(batch.direction[k * batch.n_rays + ray]);
    }
    stride = n + 5;
    raw.assign(4 * stride, NAN);
    d_position.assign(3 * n, NAN);
    d_raw = raw;
    for (int k = 0; k < 4; ++k)
      for (int i = 0; i < n; ++i)
        d_raw[k * stride + i] = static_cast<float>(factor[offset + i] * vector[point[i]][k]);
    tile = {count, batch.per_ray, position.data(), direction.data()};
  }
};

TEST_P(EveryNetwork, TwoChunksOfTiles) {
  for (const NerfConfig& config : {NerfConfig{32, 4, 2}, NerfConfig{64, 10, 4},
                                   NerfConfig{96, 1, 1}, NerfConfig{256, 10, 4}}) {
#ifdef REDRIVE_THREAD_SANITIZER
    if (config.width > 64) continue;  // the oracle's loops take too long; races show at any width
#endif
    SCOPED_TRACE("width " + std::to_string(config.width));
    const NerfCase nerf = tile_case(config);
    const auto network = GetParam().make(config);
    ThreadPool pool(2);
    network->pack(nerf.parameters, pool);
    for (const auto& [n_rays, per_ray] : {std::pair{3, 1}, {5, 3}, {33, 7}, {7, 48}, {3, 193}}) {
      SCOPED_TRACE(std::to_string(n_rays) + " x " + std::to_string(per_ray));
      const NerfBatch batch(nerf, n_rays, per_ray);
      std::vector<double> factor;
      const double factors[] = {0.5, 1, 2, -0.5, -1, -2};
      for (int s = 0; s < batch.samples(); ++s)
        factor.push_back(factors[static_cast<int>(3 * (1 + uniform(41, s)))]);
      std::vector<std::array<double, 4>> vector(NerfCase::kPoints);
      for (int p = 0; p < NerfCase::kPoints; ++p)
        for (int k = 0; k < 4; ++k)
          vector[p][k] = static_cast<float>(0x1p-10 * uniform(40, 4 * p + k));
      const Expected expected =
          NerfOracle(nerf, {GetParam().roundoff}).compute(&batch, factor, vector);
      ASSERT_GT(expected.smallest_margin, kDeviations / 2)
          << "a ReLU is at its kink: choose other points";

      // Chunk 0 runs the first ray, then another one; chunk 1 runs the others.
      std::vector<TileData> tiles;
      tiles.emplace_back(nerf, batch, 0, 1, factor, vector);
      tiles.emplace_back(nerf, batch, 1, 1, factor, vector);
      tiles.emplace_back(nerf, batch, 2, n_rays - 2, factor, vector);
      std::vector<std::unique_ptr<NerfChunk>> chunks;
      for (int chunk = 0; chunk < 2; ++chunk)
        chunks.push_back(network->make_chunk((n_rays - 2) * per_ray));
      pool.run(2, [&](int chunk) {
        chunks[chunk]->clear_gradients();
        for (const int tile : chunk == 0 ? std::vector<int>{0, 1} : std::vector<int>{2}) {
          TileData& data = tiles[tile];
          chunks[chunk]->forward(data.tile, true, data.raw.data(), data.stride);
          chunks[chunk]->backward(data.d_raw.data(), data.stride, data.d_position.data());
        }
      });
      std::vector<float> gradients(nerf.parameters.size());
      network->reduce(chunks, gradients, pool);

      for (const TileData& data : tiles)
        for (int k = 0; k < 4; ++k)
          ASSERT_TRUE(all_near(
              std::span(data.raw).subspan(k * data.stride, data.point.size()),
              [&](std::size_t i) { return expected.raw[data.point[i]][k]; },
              [&](std::size_t i) {
                return kDeviations * expected.raw_deviation[data.point[i]][k];
              }))
              << "channel " << k;
      for (int first = 0; const TileData& data : tiles) {
        const std::size_t n = data.point.size();
        const auto factor_of = [&](std::size_t i) { return factor[first + i % n]; };
        ASSERT_TRUE(all_near(
            data.d_position,
            [&](std::size_t i) {
              return factor_of(i) * expected.d_position[data.point[i % n]].value[i / n];
            },
            [&](std::size_t i) {
              return kDeviations * std::abs(factor_of(i)) *
                     std::sqrt(expected.d_position[data.point[i % n]].variance[i / n]);
            }));
        first += static_cast<int>(n);
      }
      ASSERT_TRUE(all_near(
          gradients, [&](std::size_t i) { return expected.gradient[i]; },
          [&](std::size_t i) {
            return kDeviations * expected.gradient_deviation[i] +
                   0x1p-23 * std::abs(expected.gradient[i]);
          }));

      // Runs again without keeping activations for a backward pass.
      TileData again = tiles[2];
      again.tile.position = again.position.data();
      again.tile.direction = again.direction.data();
      chunks[0]->forward(again.tile, false, again.raw.data(), again.stride);
      for (int k = 0; k < 4; ++k)
        ASSERT_TRUE(
            bit_equal(std::span(again.raw).subspan(k * again.stride, again.point.size()),
                      std::span(tiles[2].raw).subspan(k * again.stride, again.point.size())));
    }
  }
}

}  // namespace
}  // namespace redrive::kernels::conformance
