// SPDX-License-Identifier: Apache-2.0
#include "redrive/field/hash_grid.h"

#include <limits>
#include <map>
#include <set>
#include <tuple>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

using Vertex = std::tuple<std::uint32_t, std::uint32_t, std::uint32_t>;
using Levels = std::vector<HashGridLevel>;

double uniform(std::uint64_t stream, std::uint64_t i) {
  return random_unit(random_key(41, kStreamTest, stream), i);
}

std::vector<double> random_table(const HashGridConfig& config) {
  std::vector<double> table(hash_grid_size(config));
  for (std::size_t i = 0; i < table.size(); ++i) table[i] = 2 * uniform(1, i) - 1;
  return table;
}

std::vector<double> encode(const HashGridConfig& config, const std::vector<double>& table,
                           const double position[3], double footprint = 0) {
  std::vector<double> features(config.outputs());
  const Levels levels = hash_grid_levels(config);
  hash_grid_encode(config, levels, table.data(), position, footprint, features.data());
  return features;
}

/// Returns the position of a vertex; exact if the number of cells is a power of two.
std::array<double, 3> position_of(const HashGridLevel& level, const Vertex& v) {
  const auto& [x, y, z] = v;
  return {(x - 0.5) / level.resolution, (y - 0.5) / level.resolution, (z - 0.5) / level.resolution};
}

TEST(HashGridLevels, GrowGeometrically) {
  const HashGridConfig config{8, 4, 16, 2048, 17};
  const Levels levels = hash_grid_levels(config);
  ASSERT_EQ(levels.size(), 8u);
  // 2048 / 16 = 2^7 in seven steps: each level doubles.
  for (int l = 0; l < 8; ++l) EXPECT_EQ(levels[l].resolution, 16 << l);
  EXPECT_EQ(hash_grid_levels({1, 1, 5, 900, 17})[0].resolution, 5);
  const Levels uneven = hash_grid_levels({16, 2, 16, 524288, 19});
  EXPECT_EQ(uneven.front().resolution, 16);
  EXPECT_EQ(uneven.back().resolution, 524288);
  for (int l = 0; l < 16; ++l) EXPECT_NEAR(uneven[l].resolution, 16 * std::exp2(l), 0.5);
}

TEST(HashGridLevels, HaveOneRowPerVertexUpToTheHashmapSize) {
  // (14 + 2)^3 = 2^12 vertices: dense with 2^12 rows, and one cell more is not.
  for (const auto& [resolution, dense, rows] :
       {std::tuple{14, true, 4096u}, {15, false, 4096u}, {4, true, 216u}}) {
    const HashGridLevel level = hash_grid_levels({1, 2, resolution, resolution, 12})[0];
    EXPECT_EQ(level.dense, dense) << resolution;
    EXPECT_EQ(level.rows, rows) << resolution;
  }
  // 128 + 2 cubed is above 2^21, and doubles may not round that away: 2^21 = 128^3.
  EXPECT_TRUE(hash_grid_levels({1, 1, 126, 126, 21})[0].dense);
  EXPECT_FALSE(hash_grid_levels({1, 1, 127, 127, 21})[0].dense);
}

TEST(HashGridLevels, AreConsecutiveAndAlignedToCacheLines) {
  for (const HashGridConfig& config :
       {HashGridConfig{8, 4, 16, 2048, 14}, HashGridConfig{5, 1, 3, 100, 10},
        HashGridConfig{16, 2, 1, 1 << 20, 4}}) {
    std::size_t end = 0;
    for (const HashGridLevel& level : hash_grid_levels(config)) {
      EXPECT_EQ(level.offset % 16, 0u);
      EXPECT_GE(level.offset, end);
      EXPECT_LT(level.offset, end + 16);
      end = level.offset + std::size_t(level.rows) * config.features_per_level;
    }
    EXPECT_GE(hash_grid_size(config), end);
    EXPECT_LT(hash_grid_size(config), end + 16);
  }
}

TEST(HashGridLevels, RejectConfigsOutOfRange) {
  for (const HashGridConfig& bad :
       {HashGridConfig{0, 4, 16, 2048, 17}, HashGridConfig{17, 4, 16, 2048, 17},
        HashGridConfig{8, 3, 16, 2048, 17}, HashGridConfig{8, 16, 16, 2048, 17},
        HashGridConfig{8, 4, 0, 2048, 17}, HashGridConfig{8, 4, 16, 15, 17},
        HashGridConfig{8, 4, 16, (1 << 20) + 1, 17}, HashGridConfig{8, 4, 16, 2048, 3},
        HashGridConfig{8, 4, 16, 2048, 25}, HashGridConfig{8, 4, 16, 2048, 17, -0.1f},
        HashGridConfig{8, 4, 16, 2048, 17, 1}})
    EXPECT_THROW(hash_grid_levels(bad), std::logic_error);
}

TEST(HashGridRow, IsUniqueInDenseLevels) {
  for (const int resolution : {1, 2, 13, 14}) {
    const HashGridLevel level = hash_grid_levels({1, 1, resolution, resolution, 12})[0];
    ASSERT_TRUE(level.dense);
    std::set<std::uint32_t> rows;
    const std::uint32_t side = resolution + 2;
    for (std::uint32_t z = 0; z < side; ++z)
      for (std::uint32_t y = 0; y < side; ++y)
        for (std::uint32_t x = 0; x < side; ++x) rows.insert(hash_grid_row(level, x, y, z));
    EXPECT_EQ(rows.size(), side * side * side);
    EXPECT_EQ(*rows.begin(), 0u);
    EXPECT_EQ(*rows.rbegin(), level.rows - 1);
  }
}

TEST(HashGridRow, UsesAllRowsOfAHashedLevel) {
  const HashGridLevel level = hash_grid_levels({1, 1, 62, 62, 12})[0];
  ASSERT_FALSE(level.dense);
  std::vector<int> count(level.rows);
  for (std::uint32_t z = 0; z < 64; ++z)
    for (std::uint32_t y = 0; y < 64; ++y) {
      std::set<std::uint32_t> line;
      for (std::uint32_t x = 0; x < 64; ++x) {
        const std::uint32_t row = hash_grid_row(level, x, y, z);
        ASSERT_LT(row, level.rows);
        line.insert(row);
        ++count[row];
      }
      EXPECT_EQ(line.size(), 64u);  // x is not multiplied: neighbours along it never meet
    }
  // 2^18 vertices on 2^12 rows, 64 each. 4096 lines of 64 rows, each row in 64 of them: if the
  // lines began at random rows, its count would have a standard deviation of 8; seven of these for
  // 4096 rows.
  for (const int n : count) EXPECT_NEAR(n, 64, 7 * 8);
}

TEST(HashGridRow, NeighboursAlongXAreConsecutive) {
  for (const int resolution : {14, 62}) {  // dense and hashed
    const HashGridLevel level = hash_grid_levels({1, 1, resolution, resolution, 12})[0];
    ASSERT_EQ(level.dense, resolution == 14);
    for (std::uint32_t z = 0; z < 16; ++z)
      for (std::uint32_t y = 0; y < 16; ++y)
        for (std::uint32_t x = 0; x < 15; ++x)
          ASSERT_EQ(hash_grid_row(level, x + 1, y, z),
                    (hash_grid_row(level, x, y, z) + 1) % level.rows);
  }
}

TEST(HashGrid, EncodesALinearFunctionExactly) {
  const HashGridConfig config{3, 4, 4, 16, 13};  // (16 + 2)^3 = 5832 rows: all dense
  const Levels levels = hash_grid_levels(config);
  std::vector<double> table(hash_grid_size(config));
  const double slope[4][3] = {{1, 0, 0}, {0, -2, 0}, {0, 0, 3}, {0.5, 0.25, -1}},
               at_zero[4] = {0, 1, -1, 0.5};
  const auto linear = [&](int f, const double p[3]) {
    return at_zero[f] + slope[f][0] * p[0] + slope[f][1] * p[1] + slope[f][2] * p[2];
  };
  for (const HashGridLevel& level : levels) {
    ASSERT_TRUE(level.dense);
    const std::uint32_t side = level.resolution + 2;
    for (std::uint32_t z = 0; z < side; ++z)
      for (std::uint32_t y = 0; y < side; ++y)
        for (std::uint32_t x = 0; x < side; ++x)
          for (int f = 0; f < 4; ++f)
            table[level.offset + hash_grid_row(level, x, y, z) * 4 + f] =
                linear(f, position_of(level, {x, y, z}).data());
  }
  for (int i = 0; i < 200; ++i) {
    double p[3] = {uniform(2, 3 * i), uniform(2, 3 * i + 1), uniform(2, 3 * i + 2)};
    if (i < 27)  // faces, edges, corners and the centre
      for (int k = 0, n = i; k < 3; ++k, n /= 3) p[k] = 0.5 * (n % 3);
    const std::vector<double> features = encode(config, table, p);
    // Eight products of three shares (up to 18 steps of 2^-53 in a fraction) and numbers up to 4.
    for (int o = 0; o < config.outputs(); ++o)
      EXPECT_NEAR(features[o], linear(o % 4, p), 64 * 4 * 0x1p-53) << i;
  }
}

TEST(HashGrid, VertexWeightsSumToOne) {
  const HashGridConfig config{6, 2, 3, 3000, 8};
  const Levels levels = hash_grid_levels(config);
  ASSERT_TRUE(levels.front().dense);
  ASSERT_FALSE(levels.back().dense);
  const std::vector<double> ones(hash_grid_size(config), 1.0);
  for (int i = 0; i < 100; ++i) {
    const double p[3] = {uniform(3, 3 * i), uniform(3, 3 * i + 1), uniform(3, 3 * i + 2)};
    for (const HashGridLevel& level : levels) {
      const HashGridCell<double> cell(level, p);
      for (int c = 0; c < 8; ++c) EXPECT_GE(cell.weight(c), 0);
    }
    for (const double feature : encode(config, ones, p)) EXPECT_NEAR(feature, 1, 16 * 0x1p-53);
  }
}

TEST(HashGrid, LevelsFinerThanTheFootprintWeighLess) {
  HashGridLevel level;
  level.resolution = 64;
  level.min_weight = 0.2f;
  EXPECT_EQ(hash_grid_level_weight(level, 0.0), 1);
  EXPECT_EQ(hash_grid_level_weight(level, 1.0 / 128), 1);
  EXPECT_NEAR(hash_grid_level_weight(level, (1 + 1e-12) / 128), 1, 2e-12);
  EXPECT_NEAR(hash_grid_level_weight(level, 1.0 / 32), 0.05 / 0.8, 1e-7);
  EXPECT_NEAR(hash_grid_level_weight(level, 1.0 / 64), 0.3 / 0.8, 1e-7);
  EXPECT_EQ(hash_grid_level_weight(level, 1.0 / 25), 0);
  EXPECT_EQ(hash_grid_level_weight(level, std::numeric_limits<double>::infinity()), 0);
  // The whole encoding: level by level the plain one times this.
  const HashGridConfig config{4, 2, 4, 32, 8};
  const Levels levels = hash_grid_levels(config);
  const std::vector<double> table = random_table(config);
  const double p[3] = {0.3, 0.8, 0.55}, footprint = 0.05;
  const std::vector<double> sharp = encode(config, table, p),
                            blurred = encode(config, table, p, footprint);
  for (int o = 0; o < config.outputs(); ++o)
    EXPECT_DOUBLE_EQ(blurred[o], sharp[o] * hash_grid_level_weight(levels[o / 2], footprint));
  EXPECT_EQ(blurred[0], sharp[0]);          // 2 x 4 x 0.05 is below 1
  EXPECT_NE(blurred.back(), sharp.back());  // 2 x 32 x 0.05 is not
}

TEST(HashGrid, CollidingVerticesShareARow) {
  const HashGridConfig config{1, 2, 16, 16, 6};
  const Levels levels = hash_grid_levels(config);
  ASSERT_FALSE(levels[0].dense);
  std::map<std::uint32_t, Vertex> seen;
  Vertex a, b;
  for (std::uint32_t i = 0; a == b; ++i) {  // vertices inside of the cube: 1..16
    b = {1 + i % 16, 1 + i / 16 % 16, 1 + i / 256};
    a = seen.insert({hash_grid_row(levels[0], 1 + i % 16, 1 + i / 16 % 16, 1 + i / 256), b})
            .first->second;
  }
  ASSERT_NE(a, b);
  const auto& [x, y, z] = a;
  const std::size_t row = hash_grid_row(levels[0], x, y, z);
  std::vector<double> table(hash_grid_size(config)), d_table(table.size());
  table[2 * row] = 3;
  table[2 * row + 1] = -7;
  const double d_features[2] = {1, 10};
  for (const Vertex& v : {a, b}) {
    const std::vector<double> features = encode(config, table, position_of(levels[0], v).data());
    EXPECT_EQ(features[0], 3);
    EXPECT_EQ(features[1], -7);
    hash_grid_adjoint<double>(config, levels, table.data(), position_of(levels[0], v).data(), 0.0,
                              d_features, d_table.data(), nullptr);
  }
  EXPECT_EQ(d_table[2 * row], 2);
  EXPECT_EQ(d_table[2 * row + 1], 20);
}

TEST(HashGrid, ClampsPositionsToTheUnitCube) {
  const HashGridConfig config{5, 2, 2, 1 << 20, 9};
  const std::vector<double> table = random_table(config);
  constexpr double kInfinity = std::numeric_limits<double>::infinity(),
                   kNan = std::numeric_limits<double>::quiet_NaN();
  const struct {
    double position[3], face[3];
  } cases[] = {{{-3, 0.4, 7}, {0, 0.4, 1}},
               {{0.2, -1e300, -0.0}, {0.2, 0, 0}},
               {{kInfinity, -kInfinity, 0.9}, {1, 0, 0.9}},
               {{kNan, 0.1, 0.7}, {0, 0.1, 0.7}},
               {{0.6, kNan, kNan}, {0.6, 0, 0}}};
  for (const auto& [position, face] : cases)
    EXPECT_EQ(encode(config, table, position), encode(config, table, face));
}

template <class T>
void expect_vertices_inside(const HashGridLevel& level, T x) {
  const T p[3] = {x, x, x};
  const HashGridCell<T> cell(level, p);
  EXPECT_LE(cell.corner[0] + 1, static_cast<std::uint32_t>(level.resolution) + 1) << x;
  EXPECT_GE(cell.fraction[0], 0) << x;
  EXPECT_LE(cell.fraction[0], 1) << x;
}

TEST(HashGrid, VerticesStayInsideTheLevel) {
  for (const int resolution : {1, 2, 3, 1000, 4096, 1 << 20}) {
    HashGridLevel level;
    level.resolution = resolution;
    for (const float x : {0.0f, 0x1p-149f, 0.5f, 1 - 0x1p-24f, 1.0f}) {
      expect_vertices_inside(level, x);
      expect_vertices_inside(level, static_cast<double>(x));
    }
  }
}

TEST(HashGridAdjoint, AgreesWithJets) {
  const HashGridConfig config{2, 2, 2, 5, 6};  // 4^3 rows, dense, and as many for 7^3 vertices
  const Levels levels = hash_grid_levels(config);
  ASSERT_TRUE(levels[0].dense);
  ASSERT_FALSE(levels[1].dense);
  constexpr int kTable = 256;
  ASSERT_EQ(hash_grid_size(config), std::size_t(kTable));
  using Jet = ceres::Jet<double, kTable + 3>;
  const std::vector<double> table = random_table(config);
  for (int i = 0; i < 40; ++i) {
    const double p[3] = {uniform(4, 3 * i), uniform(4, 3 * i + 1), uniform(4, 3 * i + 2)};
    const double footprint = i % 3 == 0 ? 0 : 0.3 * uniform(5, i);
    std::vector<Jet> x(kTable), features(config.outputs());
    for (int k = 0; k < kTable; ++k) x[k] = Jet(table[k], k);
    const Jet at[3] = {Jet(p[0], kTable), Jet(p[1], kTable + 1), Jet(p[2], kTable + 2)};
    hash_grid_encode(config, levels, x.data(), at, Jet(footprint), features.data());

    std::vector<double> d_features(config.outputs()), d_table(kTable, 0.25), without(kTable, 0.25);
    for (int o = 0; o < config.outputs(); ++o) d_features[o] = 2 * uniform(6, 10 * i + o) - 1;
    double d_position[3] = {0.25, 0.25, 0.25};
    hash_grid_adjoint(config, levels, table.data(), p, footprint, d_features.data(), d_table.data(),
                      d_position);
    hash_grid_adjoint<double>(config, levels, table.data(), p, footprint, d_features.data(),
                              without.data(), nullptr);
    EXPECT_EQ(without, d_table);
    for (int k = 0; k < kTable + 3; ++k) {
      double expected = 0.25;  // adjoints are added to it
      for (int o = 0; o < config.outputs(); ++o) expected += d_features[o] * features[o].v[k];
      // Sums of up to 2 x 8 x 2 terms of at most five times a share, six roundings each.
      EXPECT_NEAR(k < kTable ? d_table[k] : d_position[k - kTable], expected, 32 * 6 * 5 * 0x1p-53)
          << k;
    }
  }
}

TEST(HashGridInitialize, IsUniformAndFollowsTheSeed) {
  const HashGridConfig config{4, 4, 8, 64, 12};
  const std::size_t n = hash_grid_size(config);
  std::vector<float> a(n, 1e9f), b(n), c(n);
  hash_grid_initialize(config, 1, a);
  hash_grid_initialize(config, 1, b);
  hash_grid_initialize(config, 2, c);
  EXPECT_EQ(a, b);
  EXPECT_NE(a, c);
  double sum = 0, squares = 0;
  for (const float x : a) {
    EXPECT_LE(std::abs(x), 1e-4f);
    sum += x;
    squares += double(x) * x;
  }
  // U(-r, r): mean 0 with standard error r / sqrt(3 n); mean square r^2 / 3 with r^2 sqrt(4 / 45
  // n). Five of each.
  EXPECT_NEAR(sum / n, 0, 5e-4 / std::sqrt(3.0 * n));
  EXPECT_NEAR(squares / n, 1e-8 / 3, 5e-8 * std::sqrt(4 / (45.0 * n)));
  std::vector<float> wrong(n - 1);
  EXPECT_THROW(hash_grid_initialize(config, 1, wrong), std::logic_error);
}

}  // namespace
}  // namespace redrive
