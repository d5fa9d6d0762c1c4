// SPDX-License-Identifier: Apache-2.0
// Compares the network's encoded inputs, in both forms, with field/positional_encoding.h in double.
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/field/positional_encoding.h"
#include "redrive/kernels/nerf/cpu/bf16/bf16_testing.h"
#include "redrive/kernels/nerf/cpu/bf16/network.h"

namespace redrive::kernels::bf16 {
namespace {

/// bf16 has 8 significant bits, so it rounds by at most 2^-8 of the value; the fp32 arithmetic
/// before it is within 5e-6 (encode.cc).
double tolerance(double value) { return std::abs(value) * 0x1p-8 + 5e-6; }

class EncodeTest : public testing::TestWithParam<NerfConfig> {};

TEST_P(EncodeTest, MatchesTheFormulaInBothLayouts) {
  SKIP_WITHOUT_BF16();
  const NerfConfig config = GetParam();
  Network network(config);
  const Plan& plan = network.plan();
  for (const auto& [n_rays, per_ray] : {std::pair{1, 1}, {3, 11}, {17, 5}, {2, 48}, {70, 1}}) {
    const int samples = n_rays * per_ray, n = (samples + 31) / 32;
    std::vector<float> position(3 * samples), direction(3 * n_rays);
    for (std::size_t i = 0; i < position.size(); ++i) position[i] = 2 * random_unit(1, i) - 1;
    for (std::size_t i = 0; i < direction.size(); ++i) direction[i] = 2 * random_unit(2, i) - 1;
    const float special[] = {0, 1, -1, 0.5f, -0.25f, 3.7f, -1000.3125f, 0x1p24f};
    for (std::size_t i = 0; i < std::size(special) && i < position.size(); ++i)
      position[i] = special[i];

    Chunk chunk(network, samples);
    const ChunkMemory& memory = chunk.memory();
    encode_tile(plan, memory, TileInput{n_rays, per_ray, position.data(), direction.data()}, true);

    const auto check = [&](const Bf16* next, const Bf16* keep, int blocks, int octaves,
                           auto&& point_of) {
      for (int i = 0; i < samples; ++i) {
        double point[3], expected[64] = {};
        point_of(i, point);
        positional_encoding(point, octaves, expected);
        for (int f = 0; f < blocks * 32; ++f) {
          const Bf16 a = next[(i / 32 * blocks + f / 32) * kBlockSize + pair_form(f % 32, i % 32)];
          const Bf16 b = keep[(f / 32 * n + i / 32) * kBlockSize + row_form(f % 32, i % 32)];
          ASSERT_EQ(a, b) << "sample " << i << " feature " << f;
          if (f >= encoded_size(octaves)) {
            ASSERT_EQ(a, 0) << "padding, feature " << f;
          } else {
            ASSERT_NEAR(from_bf16(a), expected[f], tolerance(expected[f]))
                << "sample " << i << " feature " << f;
          }
        }
      }
    };
    check(memory.position_next, memory.position_keep, plan.position_blocks, config.position_octaves,
          [&](int i, double* p) {
            for (int d = 0; d < 3; ++d) p[d] = position[d * samples + i];
          });
    check(memory.direction_next, memory.direction_keep, plan.direction_blocks,
          config.direction_octaves, [&](int i, double* p) {
            for (int d = 0; d < 3; ++d) p[d] = direction[d * n_rays + i / per_ray];
          });
  }
}

INSTANTIATE_TEST_SUITE_P(
    Octaves, EncodeTest,
    testing::Values(NerfConfig{.width = 32},
                    NerfConfig{.width = 32, .position_octaves = 4, .direction_octaves = 1}),
    [](const auto& test) { return "position" + std::to_string(test.param.position_octaves); });

}  // namespace
}  // namespace redrive::kernels::bf16
