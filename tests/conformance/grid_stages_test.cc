// SPDX-License-Identifier: Apache-2.0
// Every backend and instruction set x every stage of --method grid x sizes, against the oracle.
// Tolerances count roundings to fp32, u = 2^-24 each: all of them in the stages of one ray or
// point, statistically in the networks (grid_case.h).
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <set>
#include <vector>

#include <gtest/gtest.h>

#include "all_near.h"
#include "candidates.h"
#include "grid_case.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/optim/proposal_loss.h"

namespace redrive::kernels::conformance {
namespace {

constexpr double u = kFp32Roundoff;

/// Ray counts and lengths that are no multiples of a vector width, alone and together.
std::vector<BatchSize> batch_sizes() {
  std::vector<BatchSize> sizes;
  for (const int n_rays : {1, 7, 100})
    for (const int per_ray : {1, 3, 24, 64}) sizes.push_back({n_rays, per_ray});
  return sizes;
}

class GridStagesTest : public BackendConformance {};

INSTANTIATE_TEST_SUITE_P(Backends, GridStagesTest, testing::ValuesIn(candidates()), name_of);

const RaySpacing kSpacing{0.5f, 500, 20};

/// Intervals of rays, some of length 0.
struct Rows {
  BatchSize size;
  std::vector<float> edges;

  explicit Rows(BatchSize size, std::uint64_t key = 5)
      : size(size), edges(size.n_rays * (size.per_ray + 1)) {
    const std::vector<float> unused(3 * size.n_rays);
    make_ref_backend()->grid().sample_uniform({size.n_rays, unused, unused},
                                              {size.per_ray, kSpacing, {}, true, key}, edges);
    for (int ray = 0; ray < size.n_rays; ++ray)
      for (int i = 1; i < size.per_ray; ++i) {
        float* const edge = &edges[ray * (size.per_ray + 1) + i];
        if ((ray + i) % 13 == 5) *edge = edge[-1];
      }
  }
  std::size_t count() const { return static_cast<std::size_t>(size.n_rays) * size.per_ray; }
  Intervals intervals() const { return {size.per_ray, edges}; }
  const float* of(int ray) const {
    return &edges[static_cast<std::size_t>(ray) * (size.per_ray + 1)];
  }
};

TEST_P(GridStagesTest, SampleUniform) {
  // The result must equal the scalar function's bit by bit.
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes())
    for (const bool jitter : {false, true})
      for (const bool unbounded : {false, true}) {
        SCOPED_TRACE(trace(size));
        // Origins outside and inside of the cube, rays towards it and away.
        const std::vector<float> origin = random_floats(3 * size.n_rays, 227, -20, 20),
                                 direction = random_floats(3 * size.n_rays, 228, -1, 1);
        const UniformSampling how{size.per_ray, kSpacing, {{1, 2, 3}, 12, unbounded}, jitter, 77};
        std::vector<float> edges(size.n_rays * (size.per_ray + 1), NAN), expected(edges.size());
        backend->grid().sample_uniform({size.n_rays, origin, direction}, how, edges);
        ref->grid().sample_uniform({size.n_rays, origin, direction}, how, expected);
        ASSERT_TRUE(bit_equal(edges, expected));
      }
}

TEST_P(GridStagesTest, SamplePdf) {
  // Bit by bit as above: the inverse is steep where weights vanish, so no tolerance would be
  // useful.
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes())
    for (const int to : {1, 3, 24, 64}) {
      SCOPED_TRACE(trace(size) + " to " + std::to_string(to));
      const Rows from(size);
      std::vector<float> weights =
          random_floats(from.count(), 220, -0.5 / size.per_ray, 1.0 / size.per_ray);
      for (float& w : weights) w = std::max(w, 0.0f);
      std::fill_n(weights.begin(), size.per_ray, 0.0f);  // the first ray has no weight
      std::vector<float> edges(size.n_rays * (to + 1), NAN), expected(edges.size());
      backend->grid().sample_pdf(size.n_rays, from.intervals(), weights, {to, 0.05f, true, 78},
                                 edges);
      ref->grid().sample_pdf(size.n_rays, from.intervals(), weights, {to, 0.05f, true, 78},
                             expected);
      ASSERT_TRUE(bit_equal(edges, expected));
    }
}

TEST_P(GridStagesTest, Contract) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes())
    for (const auto& [unbounded, least_width] :
         {std::pair(false, 0.0f), {false, 0.3f}, {true, 0.0f}, {true, 0.3f}}) {
      SCOPED_TRACE(trace(size));
      const Contraction contraction{{3, -7, 1.5f}, 24, unbounded};
      const Rows rows(size);
      const std::size_t n_rays = size.n_rays, n = rows.count();
      const std::vector<float> origin = random_floats(3 * n_rays, 230, -40, 40),
                               angle = random_floats(n_rays, 231, 1e-4, 2e-2);
      std::vector<float> direction = random_floats(3 * n_rays, 232, -1, 1);
      const Rays rays{size.n_rays, origin, direction};
      std::vector<float> position(3 * n, NAN), footprint(n, NAN), expected(3 * n),
          expected_footprint(n);
      backend->grid().contract(contraction, rays, angle, rows.intervals(), least_width, position,
                               footprint);
      ref->grid().contract(contraction, rays, angle, rows.intervals(), least_width, expected,
                           expected_footprint);
      // u_k = (o - c) / half + t d / half: each term rounds up to four times. This error is
      // multiplied by d unit / d u, whose rows sum up to at most 1/2 (bounded) or, where m > 1, 3 /
      // (4 m). The map itself rounds five times, up to 1 (or more, outside a bounded scene).
      std::vector<double> of_u(n), m(n);
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t ray = i / size.per_ray;
        const float* const edge = rows.of(static_cast<int>(ray)) + i % size.per_ray;
        const double t = 0.5 * (double(edge[0]) + edge[1]);
        for (int k = 0; k < 3; ++k) {
          const double o = origin[k * n_rays + ray] - double(contraction.center[k]),
                       along = t * direction[k * n_rays + ray];
          of_u[i] = std::max(of_u[i], 4 * u * (std::abs(o) + std::abs(along)) / contraction.half_m);
          m[i] = std::max(m[i], std::abs(o + along) / contraction.half_m);
        }
      }
      ASSERT_TRUE(all_near(
          position, [&](auto i) { return expected[i]; },
          [&](std::size_t i) {
            const double reach = unbounded ? 0.75 / std::max(1.0, m[i % n]) : 0.5;
            return reach * of_u[i % n] + 5 * u * std::max(1.0, double(std::abs(expected[i])));
          }));
      // The cube root is accurate to 1e-5, and volumes below 1e-30 count as 1e-30. To that add cube
      // roots of ten more roundings and of the factor's error by the error of u; the factor
      // contains powers of m up to 4/3.
      ASSERT_TRUE(all_near(
          footprint, [&](auto i) { return expected_footprint[i]; },
          [&](std::size_t i) {
            return (1e-5 + 4 * u + 2 * of_u[i] / std::max(1.0, m[i])) * expected_footprint[i] +
                   1.001e-10 / contraction.half_m;
          }));
    }
}

TEST_P(GridStagesTest, ContractSamplesOfKnownSize) {
  // A pixel is 0.02 m wide at 2 m. The intervals are 1 m and 2 m long, and a metre is an eighth of
  // the cube's side.
  const std::vector<float> origin{0, 0, 0}, direction{1, 0, 0}, angle{0.01f},
      edges{1.5f, 2.5f, 4.5f};
  std::vector<float> position(6), footprint(2);
  const auto of = [&](float least_width) {
    make()->grid().contract({{0, 0, 0}, 4, false}, {1, origin, direction}, angle, {2, edges},
                            least_width, position, footprint);
    return footprint;
  };
  const double near = std::cbrt(0.02 * 0.02 * 1), far = std::cbrt(0.035 * 0.035 * 2);
  EXPECT_NEAR(of(0)[0], near / 8, 1e-6);
  EXPECT_NEAR(of(0)[1], far / 8, 1e-6);
  EXPECT_NEAR(of(0.5f)[0], 0.5 / 8, 1e-6) << "half the interval's length";
  EXPECT_NEAR(of(0.5f)[1], 1.0 / 8, 2e-6);
  EXPECT_NEAR(of(0.01f)[0], near / 8, 1e-6) << "the box is larger";
  EXPECT_NEAR(position[0], 0.5 + 2.0 / 8, 1e-6);
  EXPECT_NEAR(position[1], 0.5 + 3.5 / 8, 1e-6);
}

TEST_P(GridStagesTest, ContractBackward) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes())
    for (const bool unbounded : {false, true}) {
      SCOPED_TRACE(trace(size));
      const Contraction contraction{{3, -7, 1.5f}, 24, unbounded};
      const Rows rows(size);
      const std::size_t n_rays = size.n_rays, n = rows.count();
      const std::vector<float> origin = random_floats(3 * n_rays, 235, -40, 40),
                               direction = random_floats(3 * n_rays, 236, -1, 1),
                               d_position = random_floats(3 * n, 237, -1, 1);
      const Rays rays{size.n_rays, origin, direction};
      std::vector<float> d_origin(3 * n_rays, NAN), d_direction(3 * n_rays, NAN),
          expected_origin(3 * n_rays), expected_direction(3 * n_rays);
      backend->grid().contract_backward(contraction, rays, rows.intervals(), d_position, d_origin,
                                        d_direction);
      ref->grid().contract_backward(contraction, rays, rows.intervals(), d_position,
                                    expected_origin, expected_direction);
      // A sample's term is at most three times the scale times the sum of |d_position|. Its
      // factors, and the powers of m down to -4 in them, round ten times; m itself is off by four
      // roundings of its terms. Then per_ray terms are added up.
      std::vector<double> of_origin(n_rays), of_direction(n_rays);
      for (std::size_t i = 0; i < n; ++i) {
        const std::size_t ray = i / size.per_ray;
        const float* const edge = rows.of(static_cast<int>(ray)) + i % size.per_ray;
        const double t = 0.5 * (double(edge[0]) + edge[1]);
        double terms = 0, m = 1, d = 0;
        for (int k = 0; k < 3; ++k) {
          const double o = origin[k * n_rays + ray] - double(contraction.center[k]),
                       along = t * direction[k * n_rays + ray];
          terms = std::max(terms, (std::abs(o) + std::abs(along)) / contraction.half_m);
          m = std::max(m, std::abs(o + along) / contraction.half_m);
          d += std::abs(d_position[k * n + i]);
        }
        const double part = 3 * 0.5 / contraction.half_m * d,
                     error = part * (10 + 16 * terms / m + size.per_ray) * u;
        of_origin[ray] += error;
        of_direction[ray] += t * error;
      }
      ASSERT_TRUE(all_near(
          d_origin, [&](auto i) { return expected_origin[i]; },
          [&](std::size_t i) { return of_origin[i % n_rays]; }));
      ASSERT_TRUE(all_near(
          d_direction, [&](auto i) { return expected_direction[i]; },
          [&](std::size_t i) { return of_direction[i % n_rays]; }));
    }
}

std::vector<HashGridConfig> grids() {
  // Dense and hashed levels each. All levels have an odd number of cells times at most 2^10, see
  // Points.
  return {
      {8, 4, 4, 512, 12, 0.25f}, {4, 8, 5, 300, 11, 0}, {16, 2, 3, 700, 10}, {5, 1, 6, 160, 13}};
}
std::string trace(const HashGridConfig& grid) {
  return std::to_string(grid.n_levels) + " x " + std::to_string(grid.features_per_level);
}

/// Points whose coordinates are odd multiples of 2^-12, so that their position in a cell is exact
/// in float, and none is on the border of a cell: times 2^a odd cells, a <= 10, they are odd
/// multiples of 2^(a - 12), never half-integers. Runs of 24 are a ray's neighbours that often share
/// a cell.
struct Points {
  std::vector<float> position, footprint;

  explicit Points(std::size_t n, bool with_outside = false) : position(3 * n), footprint(n) {
    for (std::size_t i = 0; i < n; ++i) {
      const std::uint64_t ray = i / 24;
      for (int k = 0; k < 3; ++k) {
        const int start = static_cast<int>(2048 * (1 + uniform(240, 3 * ray + k))),
                  step = static_cast<int>(20 * uniform(241, 3 * ray + k));
        position[k * n + i] =
            static_cast<float>(((start + step * static_cast<int>(i % 24)) & 2047) * 2 + 1) *
            0x1p-12f;
      }
      footprint[i] = i % 3 == 0 ? 0 : static_cast<float>(0.02 * (1 + uniform(242, i)));
      const float outside[] = {-0.25f, 0, 1, 1.5f, -INFINITY, INFINITY, NAN};
      if (with_outside && i % 5 == 3) position[i % 3 * n + i] = outside[i / 5 % 7];
    }
  }
  UnitPoints points() const { return {footprint.size(), position, footprint}; }
};
std::vector<std::size_t> point_counts() {
  if (kSanitized) return {1, 7, 33, 168};
  return {1, 7, 16, 33, 168, 8192 + 5};
}

std::vector<float> table_of(const HashGridConfig& config) {
  return random_floats(hash_grid_size(config), 245, -1, 1);
}

/// Returns [n][levels]: bound of the magnitudes in each level's rounding errors at a point. It
/// exceeds the level's weight, since the level's floor is subtracted.
std::vector<std::vector<double>> level_weights(const HashGridConfig& config, const Points& at) {
  const auto levels = hash_grid_levels(config);
  std::vector<std::vector<double>> out(at.footprint.size());
  for (std::size_t i = 0; i < out.size(); ++i)
    for (const HashGridLevel& level : levels)
      out[i].push_back(hash_grid_level_weight<double>(level, at.footprint[i]) +
                       level.min_weight / (1 - level.min_weight));
  return out;
}

TEST_P(GridStagesTest, Encode) {
  const auto backend = make(), ref = make_ref_backend();
  for (const HashGridConfig& config : grids())
    for (const std::size_t n : point_counts()) {
      SCOPED_TRACE(trace(config) + ", " + std::to_string(n));
      const Points at(n, true);
      const std::vector<float> table = table_of(config);
      std::vector<float> features(n * config.outputs(), NAN), expected(features.size());
      backend->grid().encode({config, table}, at.points(), features);
      ref->grid().encode({config, table}, at.points(), expected);
      // Numbers up to 1, with weights that add up to the level's: two roundings of the weight,
      // three of products, five of sums, and the oracle's own.
      const auto weights = level_weights(config, at);
      ASSERT_TRUE(all_near(
          features, [&](auto i) { return expected[i]; },
          [&](std::size_t i) {
            return 12 * u *
                   weights[i / config.features_per_level % n][i / config.features_per_level / n];
          }));
      // Points with a stride: the first points of a larger array.
      if (n < 7) continue;
      std::vector<float> of_first(n / 2 * config.outputs(), NAN);
      backend->grid().encode({config, table}, at.points().first(n / 2), of_first);
      for (std::size_t l = 0; l < std::size_t(config.n_levels); ++l)
        ASSERT_TRUE(bit_equal(std::span(of_first).subspan(l * (n / 2) * config.features_per_level,
                                                          n / 2 * config.features_per_level),
                              std::span(features).subspan(l * n * config.features_per_level,
                                                          n / 2 * config.features_per_level)));
    }
}

TEST_P(GridStagesTest, EncodeAtAnyPosition) {
  // The position in a cell rounds once, up to the number of cells. This moves an average of numbers
  // in [-1, 1] by twice as much along each axis.
  const auto backend = make(), ref = make_ref_backend();
  const std::size_t n = 200;
  for (const HashGridConfig& config : grids()) {
    SCOPED_TRACE(trace(config));
    const std::vector<float> table = table_of(config), position = random_floats(3 * n, 246, 0, 1),
                             footprint(n);
    std::vector<float> features(n * config.outputs(), NAN), expected(features.size());
    backend->grid().encode({config, table}, {n, position, footprint}, features);
    ref->grid().encode({config, table}, {n, position, footprint}, expected);
    const auto levels = hash_grid_levels(config);
    ASSERT_TRUE(all_near(
        features, [&](auto i) { return expected[i]; },
        [&](std::size_t i) {
          return (12 + 3 * 2 * (levels[i / config.features_per_level / n].resolution + 1)) * u;
        }));
  }
}

TEST_P(GridStagesTest, EncodeBackward) {
  const auto backend = make(), ref = make_ref_backend();
  const float before = 0x1p-6f;  // gradients are added to
  for (const HashGridConfig& config : grids())
    for (const std::size_t n : point_counts())
      for (const bool with_position : {false, true}) {
        SCOPED_TRACE(trace(config) + ", " + std::to_string(n));
        // The derivative along an axis is undefined for points outside of the cube.
        const Points at(n, !with_position);
        const std::vector<float> table = table_of(config),
                                 d = random_floats(n * config.outputs(), 247, -1, 1);
        std::vector<float> magnitude(d.size());
        std::transform(d.begin(), d.end(), magnitude.begin(), [](float x) { return std::abs(x); });
        std::vector<float> d_table(table.size(), before), expected(table.size()),
            sums(table.size()), d_position(with_position ? 3 * n : 0, NAN),
            expected_position(d_position.size()), twice(table.size());
        backend->grid().encode_backward({config, table}, at.points(), d, d_table, d_position);
        ref->grid().encode_backward({config, table}, at.points(), d, expected, expected_position);
        // Corner weights are not negative, so this is the sum of the absolute terms.
        ref->grid().encode_backward({config, table}, at.points(), magnitude, sums, {});
        // A term rounds six times, and the weight of its level by 3 of its bound; then sums of up
        // to n terms.
        const double terms = static_cast<double>(n) + 8;
        const auto allowed = [&](std::size_t i) {
          return terms * u * (sums[i] + (sums[i] > 0 ? before : 0)) +
                 3 * u * static_cast<double>(n);
        };
        ASSERT_TRUE(all_near(
            d_table, [&](auto i) { return double(before) + expected[i]; }, allowed));
        if (!with_position) continue;
        // For numbers up to 1, a level adds at most 2 features cells weight along an axis: products
        // and the sum over features, a few roundings of corner weights, the sum over corners and
        // levels.
        const auto levels = hash_grid_levels(config);
        const auto weights = level_weights(config, at);
        ASSERT_TRUE(all_near(
            d_position, [&](auto i) { return expected_position[i]; },
            [&](std::size_t i) {
              double sum = 0;
              for (std::size_t l = 0; l < levels.size(); ++l)
                sum += 2 * config.features_per_level * levels[l].resolution * weights[i % n][l];
              return u * (config.features_per_level + 6 + 8 * config.n_levels) * sum;
            }));
        std::fill(twice.begin(), twice.end(), before);
        backend->grid().encode_backward({config, table}, at.points(), d, twice, {});
        ASSERT_TRUE(bit_equal(twice, d_table)) << "d_table must not depend on d_position";
      }
}

/// Cases of the networks: every width, both depths, every shape of grid.
const std::vector<GridCase>& cases() {
  static const std::vector<GridCase> all = [] {
    std::vector<GridCase> made;
    const HashGridConfig shapes[] = {
        {8, 4, 16, 512, 10}, {4, 8, 16, 512, 10}, {16, 2, 16, 512, 10}};
    int shape = 0;
    for (const int width : {16, 32, 64, 128})
      for (const int colour_layers : {1, 2})
        made.push_back(grid_case({shapes[shape++ % 3], width, colour_layers}));
    return made;
  }();
  return all;
}
std::string trace(const GridCase& grid) {
  return trace(grid.config.grid) + ", width " + std::to_string(grid.config.width) + ", " +
         std::to_string(grid.config.colour_layers) + " colour layers";
}
/// A tile is 256 or 384 samples: rays longer than a tile, tiles of a few rays, more tiles than
/// chunks.
std::vector<BatchSize> network_batch_sizes() {
  if (kSanitized) return {{1, 1}, {7, 3}, {33, 24}};
  return {{1, 1}, {1, 24}, {7, 3}, {33, 24}, {3, 64}, {2, 600}, {400, 24}};
}
bool too_slow(const Candidate& candidate, const GridCase& grid, BatchSize size) {
  return grid_macs_per_sample(grid.config) * size.n_rays * size.per_ray >
         0.1 * candidate.most_macs();
}

TEST_P(GridStagesTest, NetworkForward) {
  const auto backend = make();
  const bool bf16 = GetParam().roundoff() == kBf16Roundoff;
  for (const GridCase& grid : cases())
    for (const BatchSize& size : network_batch_sizes()) {
      if (too_slow(GetParam(), grid, size)) continue;
      SCOPED_TRACE(trace(grid) + ", " + trace(size));
      const GridBatch batch(grid, size.n_rays, size.per_ray);
      const GridExpected expected = GridOracle(grid, GetParam().roundoff()).compute(batch);
      std::vector<float> raw(4 * batch.samples(), NAN);
      backend->grid().network_forward(grid.network(), size.n_rays, size.per_ray, batch.features,
                                      batch.harmonics, raw);
      ASSERT_TRUE(all_near(
          raw,
          [&](std::size_t i) {
            return expected.raw[batch.point[i % batch.samples()]][i / batch.samples()];
          },
          [&](std::size_t i) {
            return kDeviations *
                   expected.raw_deviation[batch.point[i % batch.samples()]][i / batch.samples()];
          }));
      // A sample at another one's position would be off by the spread of the points; the tolerance
      // is below that, for fp32 far below.
      for (int k = 0; k < 4; ++k) {
        double low = INFINITY, high = -INFINITY, deviation = 0;
        for (int p = 0; p < GridCase::kPoints; ++p) {
          low = std::min(low, expected.raw[p][k]);
          high = std::max(high, expected.raw[p][k]);
          deviation = std::max(deviation, expected.raw_deviation[p][k]);
        }
        ASSERT_LT(kDeviations * deviation, (bf16 ? 0.5 : 1e-3) * (high - low)) << "channel " << k;
      }
    }
}

TEST_P(GridStagesTest, NetworkBackward) {
  const auto backend = make();
  const bool bf16 = GetParam().roundoff() == kBf16Roundoff;
  for (const GridCase& grid : cases())
    for (const BatchSize& size : network_batch_sizes()) {
      if (too_slow(GetParam(), grid, size)) continue;
      SCOPED_TRACE(trace(grid) + ", " + trace(size));
      const GridBatch batch(grid, size.n_rays, size.per_ray);
      const GridExpected expected = GridOracle(grid, GetParam().roundoff()).compute(batch);
      const float before = 0x1p-12f;  // gradients are added to
      std::vector<float> d_weights(grid.weights.size(), before),
          d_features(batch.features.size(), NAN);
      backend->grid().network_backward(grid.network(), size.n_rays, size.per_ray, batch.features,
                                       batch.harmonics, batch.d_raw, d_weights, d_features);
      ASSERT_TRUE(all_near(
          d_weights, [&](std::size_t i) { return before + expected.gradient[i]; },
          [&](std::size_t i) {
            return kDeviations * expected.gradient_deviation[i] +
                   4 * u * (before + std::abs(expected.gradient[i]));
          }));
      for (std::size_t s = 0; s < batch.samples(); ++s)
        for (int k = 0; k < grid.config.grid.outputs(); ++k) {
          const Uncertain& d = expected.d_features[batch.point[s]];
          ASSERT_NEAR(d_features[batch.feature_at(grid, s, k)], batch.factor[s] * d.value[k],
                      std::abs(batch.factor[s]) *
                          (kDeviations * std::sqrt(d.variance[k]) + u * std::abs(d.value[k])))
              << "sample " << s << ", feature " << k;
        }
      if (size.n_rays < 7) continue;
      for (int layer = 0; layer < kGridLayers;
           ++layer) {  // the tolerance must be below each matrix's gradient
        const GridLayerShape shape = grid_layer(grid.config, layer);
        double square = 0, variance = 0;
        for (std::size_t i = shape.offset;
             i < shape.offset + std::size_t(shape.outputs) * shape.inputs; ++i) {
          square += expected.gradient[i] * expected.gradient[i];
          variance += expected.gradient_deviation[i] * expected.gradient_deviation[i];
        }
        ASSERT_LE(kDeviations * std::sqrt(variance), (bf16 ? 0.5 : 1e-2) * std::sqrt(square))
            << shape.name;
      }
    }
}

TEST_P(GridStagesTest, ProposalDensity) {
  const auto backend = make(), ref = make_ref_backend();
  const float scale = 0.25f;
  for (const HashGridConfig& config :
       {HashGridConfig{5, 1, 6, 160, 13}, {3, 1, 4, 512, 9, 0.4f}, {1, 1, 7, 7, 12}})
    for (const std::size_t n : point_counts()) {
      SCOPED_TRACE(trace(config) + ", " + std::to_string(n));
      const Points at(n, true);
      const std::vector<float> table = table_of(config);
      std::vector<float> density(n, NAN), expected(n);
      backend->grid().proposal_density({config, table}, scale, at.points(), density);
      ref->grid().proposal_density({config, table}, scale, at.points(), expected);
      // The logarithm is a sum of 8 levels numbers whose magnitudes add up to the levels' weights,
      // after five roundings. Then an exponential, the scale and the oracle's own roundings.
      const auto weights = level_weights(config, at);
      ASSERT_TRUE(all_near(
          density, [&](auto i) { return expected[i]; },
          [&](std::size_t i) {
            const double sum = std::accumulate(weights[i].begin(), weights[i].end(), 0.0);
            return ((8 * config.n_levels + 5) * u * sum + kExponentialError + 2 * u) * expected[i];
          }));

      const std::vector<float> d = random_floats(n, 251, -1, 1);
      std::vector<float> magnitude(n), d_table(table.size(), 0.5f), expected_table(table.size()),
          sums(table.size());
      std::transform(d.begin(), d.end(), magnitude.begin(), [](float x) { return std::abs(x); });
      backend->grid().proposal_density_backward({config, table}, at.points(), expected, d, d_table);
      ref->grid().proposal_density_backward({config, table}, at.points(), expected, d,
                                            expected_table);
      ref->grid().proposal_density_backward({config, table}, at.points(), expected, magnitude,
                                            sums);
      ASSERT_TRUE(all_near(
          d_table, [&](auto i) { return 0.5 + expected_table[i]; },
          [&](std::size_t i) {
            return (static_cast<double>(n) + 9) * u * (sums[i] + (sums[i] > 0 ? 0.5 : 0)) +
                   3 * u * static_cast<double>(n);
          }));
    }
}

TEST_P(GridStagesTest, ProposalDensityStaysFinite) {
  const auto backend = make();
  const HashGridConfig config{5, 1, 6, 160, 13};
  const std::vector<float> footprint(3), position(9, 0.3f);
  for (const float each : {4.0f, 1e6f, -1e6f}) {
    const std::vector<float> table(hash_grid_size(config), each);
    std::vector<float> density(3);
    backend->grid().proposal_density({config, table}, 0.25f, {3, position, footprint}, density);
    const double expected = each > 0 ? 0.25 * std::exp(15.0) : 0;
    for (const float got : density) EXPECT_NEAR(got, expected, 1e-6 * expected + 1e-37);
  }
}

/// Returns densities from thin to opaque, some 0.
std::vector<float> densities(const Rows& rows) {
  std::vector<float> density(rows.count());
  for (std::size_t i = 0; i < density.size(); ++i)
    density[i] = i % 7 == 2    ? 0
                 : i % 41 == 9 ? 1e5f
                               : static_cast<float>(0.05 * std::exp(6 * uniform(260, i) - 3));
  return density;
}

/// Transmittance behind interval i of a ray, and its relative error bound: the errors of two
/// exponentials per interval, and the rounded optical depths in their arguments.
struct Transmittance {
  std::vector<double> after, error;

  Transmittance(const float* edges, const float* density, int n) {
    double depth = 0;
    for (int i = 0; i < n; ++i) {
      depth += double(density[i]) * (edges[i + 1] - edges[i]);
      after.push_back(std::exp(-depth));
      error.push_back((i + 1) * (kExponentialError + 2 * u) + 2 * u * depth);
    }
  }
};
/// Exponentials underflow below e^-87.
constexpr double kTiny = 2e-38;

TEST_P(GridStagesTest, Weights) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes()) {
    SCOPED_TRACE(trace(size));
    const Rows rows(size);
    const std::vector<float> density = densities(rows);
    std::vector<float> weights(density.size(), NAN), expected(density.size());
    backend->grid().weights(size.n_rays, rows.intervals(), density, weights);
    ref->grid().weights(size.n_rays, rows.intervals(), density, expected);
    for (int ray = 0; ray < size.n_rays; ++ray) {
      const std::size_t first = std::size_t(ray) * size.per_ray;
      const Transmittance transmittance(rows.of(ray), &density[first], size.per_ray);
      for (int i = 0; i < size.per_ray; ++i) {
        // Without its own optical depth: the relative error of 1 - exp(-x) is at most the error of
        // x.
        const double error = (i > 0 ? transmittance.error[i - 1] : 0) + kExponentialError + 4 * u;
        ASSERT_NEAR(weights[first + i], expected[first + i], error * expected[first + i] + kTiny)
            << "ray " << ray << ", " << i;
      }
    }
  }
}

TEST_P(GridStagesTest, WeightsBackward) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes()) {
    SCOPED_TRACE(trace(size));
    const Rows rows(size);
    const std::vector<float> density = densities(rows),
                             d_weights = random_floats(density.size(), 261, -1, 1);
    std::vector<float> weights(density.size()), d_density(density.size(), NAN),
        expected(density.size());
    ref->grid().weights(size.n_rays, rows.intervals(), density, weights);
    backend->grid().weights_backward(size.n_rays, rows.intervals(), density, weights, d_weights,
                                     d_density);
    ref->grid().weights_backward(size.n_rays, rows.intervals(), density, weights, d_weights,
                                 expected);
    for (int ray = 0; ray < size.n_rays; ++ray) {
      const std::size_t first = std::size_t(ray) * size.per_ray;
      const float* const edges = rows.of(ray);
      const Transmittance transmittance(edges, &density[first], size.per_ray);
      double behind = 0;  // sum of absolute terms, which rounds n times
      for (int i = size.per_ray - 1; i >= 0; --i) {
        const double length = double(edges[i + 1]) - edges[i],
                     own = transmittance.after[i] * std::abs(d_weights[first + i]);
        const double error =
            (transmittance.error[i] + 3 * u) * own + (size.per_ray + 3) * u * behind + 2 * kTiny;
        ASSERT_NEAR(d_density[first + i], expected[first + i], length * error)
            << "ray " << ray << ", " << i;
        behind += std::abs(double(weights[first + i]) * d_weights[first + i]);
      }
    }
  }
}

TEST_P(GridStagesTest, RangeLoss) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes()) {
    SCOPED_TRACE(trace(size));
    const Rows rows(size);
    const std::vector<float> weights = random_floats(rows.count(), 275, 0, 1.9 / size.per_ray),
                             range_m = random_floats(size.n_rays, 276, 1, 30);
    for (const float spread_m : {0.05f, 2.0f}) {
      std::vector<float> d(rows.count(), NAN), expected(rows.count());
      double loss = NAN, expected_loss = NAN;
      backend->grid().range_loss(size.n_rays, rows.intervals(), weights, range_m, spread_m, 5, d,
                                 &loss);
      ref->grid().range_loss(size.n_rays, rows.intervals(), weights, range_m, spread_m, 5, expected,
                             &expected_loss);
      // w - g, where both sides round the two function values in g, in [0, 1], alike: one rounding
      // in the difference, two in the products. Squares of at most 1 are summed over a ray in fp32,
      // over rays in double.
      EXPECT_NEAR(loss, expected_loss, 2 * size.per_ray * u * expected_loss + 5 * 4 * u);
      for (std::size_t i = 0; i < d.size(); ++i)
        ASSERT_NEAR(d[i], expected[i], 2 * 5.0 / size.n_rays * 3 * u * (1 + std::abs(weights[i])))
            << i;
    }
  }
}

TEST_P(GridStagesTest, SparsityLoss) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes()) {
    SCOPED_TRACE(trace(size));
    const Rows rows(size);
    const std::vector<float> density = densities(rows),
                             before = random_floats(density.size(), 277, -1, 1);
    std::vector<float> d = before, expected = before;
    double loss = NAN, expected_loss = NAN;
    backend->grid().sparsity_loss(size.n_rays, rows.intervals(), density, 5, d, &loss);
    ref->grid().sparsity_loss(size.n_rays, rows.intervals(), density, 5, expected, &expected_loss);
    // 1 + x has 3 roundings, so its logarithm as many u and two of its own; sums over a ray are
    // fp32.
    EXPECT_NEAR(loss, expected_loss,
                5 * 4 * size.per_ray * u + (size.per_ray + 3) * u * expected_loss);
    for (std::size_t i = 0; i < d.size(); ++i)
      ASSERT_NEAR(d[i], expected[i], 8 * u * std::abs(expected[i] - before[i]) + 2 * u) << i;
  }
}

TEST_P(GridStagesTest, ProposalLoss) {
  constexpr double kOpacityWeight = 0.25;
  const auto backend = make(), ref = make_ref_backend();
  int lacking_in_all = 0;
  for (const BatchSize& size : batch_sizes())
    for (const int m : {1, 5, 24, 64}) {
      SCOPED_TRACE(trace(size) + " and " + std::to_string(m));
      const Rows rows(size), proposal({size.n_rays, m}, 6);
      const std::vector<float> bounds = random_floats(proposal.count(), 271, 0, 1.0 / m);
      std::vector<float> weights = random_floats(rows.count(), 270, 0, 1.9 / size.per_ray);
      for (std::size_t i = 0; i < weights.size(); ++i)  // intervals of length 0 have no weight
        if (const float* edge = &rows.edges[i + i / size.per_ray]; edge[0] == edge[1])
          weights[i] = 0;
      std::vector<float> d(proposal.count(), NAN), expected(proposal.count());
      double loss = NAN, expected_loss = NAN;
      backend->grid().proposal_loss(size.n_rays, rows.intervals(), weights, proposal.intervals(),
                                    bounds, kOpacityWeight, d, &loss);
      ref->grid().proposal_loss(size.n_rays, rows.intervals(), weights, proposal.intervals(),
                                bounds, kOpacityWeight, expected, &expected_loss);
      // Up to m sums of a bound round. The excess weight has that error, its fraction two more
      // roundings, and the sum over n intervals (weighted, in the loss) n more. The opacities are m
      // + n sums.
      double loss_error = 0;
      for (int ray = 0; ray < size.n_rays; ++ray) {
        std::vector<double> error(m), sum(m);
        const float *const edges = rows.of(ray), *const p = proposal.of(ray);
        double more = 0, all = 0;
        for (int j = 0; j < m; ++j) all += bounds[std::size_t(ray) * m + j];
        more = all;
        for (int i = 0; i < size.per_ray; ++i) {
          const double w = weights[std::size_t(ray) * size.per_ray + i];
          more -= w;
          all += w;
          double bound = 0;
          std::set<int> over;
          for (int j = 0; j < m; ++j)
            if (p[j] < edges[i + 1] && p[j + 1] > edges[i]) over.insert(j);
          for (const int j : over) bound += bounds[std::size_t(ray) * m + j];
          const double off = u * (w + m * bound), lacking = std::max(0.0, w - bound),
                       share = lacking / (w + 1e-7);
          lacking_in_all += lacking > 0;
          if (lacking + off < 0 || w - bound < -off) continue;  // zero with any rounding
          for (const int j : over) {
            error[j] += 2 * (off + 2 * u * lacking) / (w + 1e-7);
            sum[j] += 2 * share;
          }
          loss_error +=
              2 * share * off + off * off / (w + 1e-7) + (size.per_ray + 3) * u * lacking * share;
        }
        const double off_more = (m + size.per_ray + 4) * u * all,
                     of_opacity = 2 * kOpacityWeight * more;
        loss_error += kOpacityWeight * (2 * std::abs(more) * off_more + off_more * off_more);
        for (int j = 0; j < m; ++j) {
          const std::size_t at = std::size_t(ray) * m + j;
          const double off = error[j] + (size.per_ray + 4) * u * (sum[j] + std::abs(of_opacity)) +
                             2 * kOpacityWeight * off_more;
          ASSERT_NEAR(d[at], expected[at], off / size.n_rays) << "ray " << ray << ", " << j;
          ASSERT_NEAR(d[at], (of_opacity - sum[j]) / size.n_rays, off / size.n_rays);
        }
      }
      ASSERT_NEAR(loss, expected_loss, loss_error / size.n_rays + 1e-15 * expected_loss);
    }
  EXPECT_GT(lacking_in_all, 1000);
}

TEST_P(GridStagesTest, NetworkPropagatesNaN) {
  // A ReLU that turns NaN into 0 would make a broken network look like an empty scene.
  const auto backend = make();
  for (int layer = 0; layer < kGridLayers; ++layer) {
    GridCase grid = cases()[1];
    ASSERT_EQ(grid.config.colour_layers, 2);
    const GridLayerShape shape = grid_layer(grid.config, layer);
    std::fill_n(&grid.weights[shape.offset], std::size_t(shape.outputs) * shape.inputs, NAN);
    const GridBatch batch(grid, 7, 24);
    const std::size_t n = batch.samples();
    std::vector<float> raw(4 * n);
    backend->grid().network_forward(grid.network(), 7, 24, batch.features, batch.harmonics, raw);
    for (const std::size_t sample : {std::size_t{0}, n / 2, n - 1}) {
      EXPECT_TRUE(std::isnan(raw[sample])) << grid_layer(grid.config, layer).name;
      EXPECT_TRUE(std::isnan(raw[2 * n + sample])) << grid_layer(grid.config, layer).name;
      EXPECT_EQ(std::isnan(raw[3 * n + sample]), layer <= kGridDensity1)
          << grid_layer(grid.config, layer).name;
    }
  }
}

TEST_P(GridStagesTest, ProposalDensityPropagatesNaN) {
  const auto backend = make();
  const HashGridConfig config{5, 1, 6, 160, 13};
  const std::vector<float> table(hash_grid_size(config), NAN), position(9, 0.3f), footprint(3);
  std::vector<float> density(3);
  backend->grid().proposal_density({config, table}, 1, {3, position, footprint}, density);
  for (const float d : density) EXPECT_TRUE(std::isnan(d));
  const std::vector<float> edges = {1, 2, 3, 4}, broken = {0.1f, NAN, 0.1f};
  std::vector<float> weights(3);
  backend->grid().weights(1, {3, edges}, broken, weights);
  EXPECT_TRUE(std::isnan(weights[1]));
  EXPECT_TRUE(std::isnan(weights[2]));
}

TEST_P(GridStagesTest, ChecksSizes) {
  const auto backend = make();
  GridStages& stages = backend->grid();
  const GridCase& grid = cases()[0];
  const GridBatch batch(grid, 3, 5);
  const Rows rows({3, 5});
  const HashGridConfig config{5, 1, 6, 160, 13};
  const std::vector<float> table = table_of(config), origin(9), direction(9, 0.5f), angle(3, 0.01f);
  const Points at(15);
  std::vector<float> few(7), n(15), n4(60), n3(45), n9(9), d_table(table.size()),
      d_weights(grid.weights.size()), d_features(batch.features.size()), encoded(5 * 15);
  const Intervals short_edges{5, few};
  EXPECT_THROW(stages.sample_uniform({3, origin, direction}, {5, kSpacing}, few), std::logic_error);
  EXPECT_THROW(stages.sample_uniform({3, few, direction}, {5, kSpacing}, encoded),
               std::logic_error);
  EXPECT_THROW(stages.sample_pdf(3, rows.intervals(), few, {1}, few), std::logic_error);
  EXPECT_THROW(stages.sample_pdf(3, short_edges, n, {1}, few), std::logic_error);
  EXPECT_THROW(stages.contract({}, {3, origin, direction}, angle, rows.intervals(), 0, few, n),
               std::logic_error);
  EXPECT_THROW(stages.contract({}, {3, origin, direction}, few, rows.intervals(), 0, n3, n),
               std::logic_error);
  EXPECT_THROW(stages.contract_backward({}, {3, origin, direction}, rows.intervals(), few, n9, n9),
               std::logic_error);
  EXPECT_THROW(stages.contract_backward({}, {3, origin, direction}, rows.intervals(), n3, few, n9),
               std::logic_error);
  EXPECT_THROW(stages.contract_backward({}, {3, origin, direction}, rows.intervals(), n3, n9, few),
               std::logic_error);
  EXPECT_THROW(stages.encode({config, few}, at.points(), encoded), std::logic_error);
  EXPECT_THROW(stages.encode({config, table}, at.points(), few), std::logic_error);
  EXPECT_THROW(stages.encode({config, table}, {15, few, n}, encoded), std::logic_error);
  EXPECT_THROW(stages.encode_backward({config, table}, at.points(), encoded, few, {}),
               std::logic_error);
  EXPECT_THROW(stages.encode_backward({config, table}, at.points(), encoded, d_table, few),
               std::logic_error);
  EXPECT_THROW(stages.network_forward(grid.network(), 3, 5, few, batch.harmonics, n4),
               std::logic_error);
  EXPECT_THROW(stages.network_forward(grid.network(), 3, 5, batch.features, few, n4),
               std::logic_error);
  EXPECT_THROW(stages.network_forward(grid.network(), 3, 5, batch.features, batch.harmonics, few),
               std::logic_error);
  EXPECT_THROW(stages.network_backward(grid.network(), 3, 5, batch.features, batch.harmonics,
                                       batch.d_raw, few, d_features),
               std::logic_error);
  EXPECT_THROW(stages.network_backward(grid.network(), 3, 5, batch.features, batch.harmonics,
                                       batch.d_raw, d_weights, few),
               std::logic_error);
  EXPECT_THROW(stages.proposal_density({config, table}, 1, at.points(), few), std::logic_error);
  EXPECT_THROW(stages.proposal_density({grids()[0], table}, 1, at.points(), n), std::logic_error);
  EXPECT_THROW(stages.proposal_density_backward({config, table}, at.points(), n, few, d_table),
               std::logic_error);
  EXPECT_THROW(stages.weights(3, rows.intervals(), few, n), std::logic_error);
  EXPECT_THROW(stages.weights_backward(3, rows.intervals(), n, n, n, few), std::logic_error);
  double loss = 0;
  EXPECT_THROW(stages.proposal_loss(3, rows.intervals(), n, rows.intervals(), n, 0.1, few, &loss),
               std::logic_error);
  EXPECT_THROW(stages.range_loss(3, rows.intervals(), n, few, 0.1f, 1, n, &loss), std::logic_error);
  EXPECT_THROW(
      stages.range_loss(3, rows.intervals(), n, std::vector<float>(3), 0.1f, 1, few, &loss),
      std::logic_error);
  EXPECT_THROW(stages.range_loss(3, rows.intervals(), n, std::vector<float>(3), 0, 1, n, &loss),
               std::logic_error);
  EXPECT_THROW(stages.sparsity_loss(3, rows.intervals(), n, 1, few, &loss), std::logic_error);
}

/// Returns the results of all stages for one batch, end to end.
std::map<std::string, std::vector<float>> all_stages(GridStages& stages, const GridCase& network,
                                                     BatchSize size) {
  std::map<std::string, std::vector<float>> out;
  const HashGridConfig config{5, 1, 6, 160, 13};
  const HashGridConfig& field = network.config.grid;
  const std::vector<float> proposal_table = table_of(config), field_table = table_of(field);
  const int n_rays = size.n_rays, first = 40, per_ray = size.per_ray;
  const std::size_t n = std::size_t(n_rays) * per_ray;
  const std::vector<float> origin = random_floats(3 * n_rays, 280, -20, 20),
                           direction = random_floats(3 * n_rays, 281, -1, 1), angle(n_rays, 0.01f);
  const Contraction contraction{{1, 2, 3}, 20, true};
  const auto made = [&](const std::string& name, std::size_t count) -> std::vector<float>& {
    return out[name] = std::vector<float>(count);
  };
  const auto points_of = [&](const std::string& name, const Intervals& intervals) {
    const std::size_t count = std::size_t(n_rays) * intervals.per_ray;
    auto& position = made(name + " position", 3 * count);
    auto& footprint = made(name + " footprint", count);
    stages.contract(contraction, {n_rays, origin, direction}, angle, intervals, 0.3f, position,
                    footprint);
    return UnitPoints{count, position, footprint};
  };
  auto& edges = made("edges", n_rays * (first + 1));
  stages.sample_uniform({n_rays, origin, direction}, {first, kSpacing, contraction, true, 1},
                        edges);
  const Intervals proposal{first, edges};
  const UnitPoints proposal_points = points_of("proposal", proposal);
  auto& density = made("density", proposal_points.n);
  stages.proposal_density({config, proposal_table}, 0.05f, proposal_points, density);
  auto& weights = made("weights", density.size());
  stages.weights(n_rays, proposal, density, weights);
  auto& field_edges = made("field edges", n_rays * (per_ray + 1));
  stages.sample_pdf(n_rays, proposal, weights, {per_ray, 0.1f, true, 2}, field_edges);
  const Intervals intervals{per_ray, field_edges};
  const UnitPoints points = points_of("field", intervals);
  auto& features = made("features", n * field.outputs());
  stages.encode({field, field_table}, points, features);
  const std::vector<float> harmonics = random_floats(n_rays * kHarmonics, 282, -1, 1);
  auto& raw = made("raw", 4 * n);
  stages.network_forward(network.network(), n_rays, per_ray, features, harmonics, raw);
  const std::vector<float> d_raw = random_floats(4 * n, 283, -1e-3, 1e-3);
  auto& d_network = made("network gradient", network.weights.size());
  auto& d_features = made("d_features", features.size());
  stages.network_backward(network.network(), n_rays, per_ray, features, harmonics, d_raw, d_network,
                          d_features);
  auto& d_table = made("table gradient", field_table.size());
  auto& d_position = made("d_position", 3 * n);
  stages.encode_backward({field, field_table}, points, d_features, d_table, d_position);
  auto& field_weights = made("field weights", n);
  stages.weights(n_rays, intervals, std::span(raw).subspan(3 * n), field_weights);
  double loss = NAN;
  stages.range_loss(n_rays, intervals, field_weights, random_floats(n_rays, 284, 1, 30), 0.5f, 2,
                    made("range d_weights", n), &loss);
  out["range loss"] = {static_cast<float>(loss)};
  stages.sparsity_loss(n_rays, intervals, std::span(raw).subspan(3 * n), 2,
                       made("sparsity d_density", n), &loss);
  out["sparsity loss"] = {static_cast<float>(loss)};
  auto& d_weights = made("d_weights", weights.size());
  stages.proposal_loss(n_rays, intervals, field_weights, proposal, weights, 0.1, d_weights, &loss);
  out["loss"] = {static_cast<float>(loss),
                 static_cast<float>(loss * 0x1p30 - std::floor(loss * 0x1p30))};
  auto& d_density = made("d_density", density.size());
  stages.weights_backward(n_rays, proposal, density, weights, d_weights, d_density);
  auto& d_proposal = made("proposal gradient", proposal_table.size());
  stages.proposal_density_backward({config, proposal_table}, proposal_points, density, d_density,
                                   d_proposal);
  return out;
}

TEST_P(GridStagesTest, SameBitsAgainAndOnAnyNumberOfThreads) {
  const auto backend = make(2), single = make(1), five = make(5);
  const BatchSize size =
      GetParam().is_oracle() || kSanitized ? BatchSize{37, 9} : BatchSize{401, 24};
  const GridCase& grid = cases()[3];
  const auto first = all_stages(backend->grid(), grid, size),
             again = all_stages(backend->grid(), grid, size),
             alone = all_stages(single->grid(), grid, size),
             many = all_stages(five->grid(), grid, size);
  for (const auto& [stage, values] : first) {
    EXPECT_TRUE(bit_equal(values, again.at(stage))) << stage;
    EXPECT_TRUE(bit_equal(values, alone.at(stage))) << stage << " on one thread";
    EXPECT_TRUE(bit_equal(values, many.at(stage))) << stage << " on five threads";
    for (const float value : values) ASSERT_TRUE(std::isfinite(value)) << stage;
    EXPECT_TRUE(std::any_of(values.begin(), values.end(), [](float x) { return x != 0; })) << stage;
  }
}

}  // namespace
}  // namespace redrive::kernels::conformance
