// SPDX-License-Identifier: Apache-2.0
// Stages of --method grid on whole rays, of every backend, against their definition and against the
// oracle. Backends share the formulas and differ only by the exponential function.
#include <array>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "all_near.h"
#include "candidates.h"
#include "redrive/base/rng.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/optim/photometric_loss.h"

namespace redrive::kernels::conformance {
namespace {

constexpr double u = kFp32Roundoff;

class RayStages : public BackendConformance {};

INSTANTIATE_TEST_SUITE_P(Backends, RayStages, testing::ValuesIn(candidates()), name_of);

std::vector<std::uint32_t> every_third(std::uint32_t n) {
  std::vector<std::uint32_t> rays;
  for (std::uint32_t ray = 1; ray < n; ray += 3) rays.push_back(ray);
  return rays;
}

TEST_P(RayStages, CompactRaysFindsTheActiveRays) {
  const auto backend = make();
  constexpr int kPerRay = 3;
  constexpr std::uint64_t kKey = 17;
  for (const int n : {1, 7, 64, 1000, 5000})
    for (const float others : {0.0f, 0.25f}) {
      SCOPED_TRACE(n);
      // Multiples of 1/8, whose sum is exact; three of them are min_opacity.
      std::vector<float> weights(kPerRay * n);
      std::vector<std::uint32_t> expected;
      for (int ray = 0; ray < n; ++ray) {
        const int eighths = ray * 5 % 7;  // 0..6
        for (int i = 0; i < kPerRay; ++i)
          weights[kPerRay * ray + i] = 0.125f * static_cast<float>((eighths + i) / 3);
        if (ray % 50 == 21) weights[kPerRay * ray + 1] = NAN;
        if (eighths >= 3 || ray % 50 == 21 || random_unit(kKey, ray) < others)
          expected.push_back(ray);
      }
      std::vector<std::uint32_t> active(n, 12345);
      active.resize(
          backend->grid().compact_rays(n, kPerRay, weights, {0.375f, others, kKey}, active));
      if (expected.empty()) expected = {0};
      EXPECT_EQ(active, expected);
      EXPECT_GE(active.size(), n < 5000 ? 1u : others > 0 ? 3000u : 2800u);
    }
  std::vector<std::uint32_t> active(100, 12345);
  EXPECT_EQ(backend->grid().compact_rays(100, 1, std::vector<float>(100), {0.01f}, active), 1);
  EXPECT_EQ(active[0], 0u) << "stages take at least one ray";
}

TEST_P(RayStages, GatherRaysAndScatterRays) {
  const auto backend = make();
  for (const std::uint32_t n : {2u, 33u, 5000u})
    for (const std::size_t each : {std::size_t{1}, std::size_t{3}, std::size_t{25}})
      for (const RayLayout layout : {RayLayout::kRows, RayLayout::kColumns}) {
        const auto at = [&](std::size_t ray, std::size_t k, std::size_t rays) {
          return layout == RayLayout::kRows ? ray * each + k : k * rays + ray;
        };
        const std::vector<float> all = random_floats(n * each, 410, -1, 1),
                                 other = random_floats(n * each, 411, -1, 1);
        const std::vector<std::uint32_t> rays = every_third(n);
        std::vector<float> few(rays.size() * each, NAN), spread(n * each, NAN),
            on_nothing(n * each, NAN);
        backend->grid().gather_rays(rays, layout, all, few);
        backend->grid().scatter_rays(rays, layout, few, other, spread);
        backend->grid().scatter_rays(rays, layout, few, {}, on_nothing);
        for (std::size_t k = 0; k < each; ++k) {
          for (std::size_t i = 0; i < rays.size(); ++i)
            ASSERT_EQ(few[at(i, k, rays.size())], all[at(rays[i], k, n)]) << i << ", " << k;
          for (std::size_t ray = 0; ray < n; ++ray) {
            const bool picked = ray % 3 == 1;
            ASSERT_EQ(spread[at(ray, k, n)], picked ? all[at(ray, k, n)] : other[at(ray, k, n)])
                << ray << ", " << k;
            ASSERT_EQ(on_nothing[at(ray, k, n)], picked ? all[at(ray, k, n)] : 0)
                << ray << ", " << k;
          }
        }
      }
  // Rays that share a row.
  const std::vector<std::uint32_t> group = {0, 0, 0, 1, 2, 2};
  std::vector<float> rows(12);
  backend->grid().gather_rays(group, RayLayout::kRows, std::vector<float>{1, 2, 3, 4, 5, 6}, rows);
  EXPECT_EQ(rows, (std::vector<float>{1, 2, 1, 2, 1, 2, 3, 4, 5, 6, 5, 6}));
}

/// Returns ascending edges of rays.
std::vector<float> edges_of(int n_rays, int per_ray) {
  std::vector<float> edges;
  for (int ray = 0; ray < n_rays; ++ray)
    for (int i = 0; i <= per_ray; ++i)
      edges.push_back(
          static_cast<float>(0.5 + 0.01 * ray + i + 0.25 * (1 + uniform(412, ray * 100 + i))));
  return edges;
}

TEST_P(RayStages, MidpointsOfIntervals) {
  const auto backend = make();
  for (const BatchSize& size : {BatchSize{1, 1}, {7, 3}, {100, 24}}) {
    const std::vector<float> edges = edges_of(size.n_rays, size.per_ray);
    std::vector<float> t(size.n_rays * size.per_ray, NAN), dt = t;
    backend->grid().midpoints(size.n_rays, {size.per_ray, edges}, t, dt);
    for (std::size_t i = 0; i < t.size(); ++i) {
      const float* const edge = &edges[i + i / size.per_ray];
      ASSERT_EQ(t[i], 0.5f * (edge[0] + edge[1]));
      ASSERT_EQ(dt[i], edge[1] - edge[0]);
    }
  }
}

TEST_P(RayStages, Harmonics) {
  const auto backend = make();
  for (const int n : {1, 7, 500}) {
    const std::vector<float> direction = random_floats(3 * n, 413, -1, 1);
    std::vector<float> harmonics(n * kHarmonics, NAN);
    backend->grid().harmonics({n, {}, direction}, harmonics);
    for (int ray = 0; ray < n; ++ray) {
      const double d[3] = {direction[ray], direction[n + ray], direction[2 * n + ray]};
      double expected[kHarmonics];
      spherical_harmonics(d, expected);
      // Up to two differences of terms with factors of at most 5 and 3: at most 12 roundings of at
      // most 9.
      for (int k = 0; k < kHarmonics; ++k)
        ASSERT_NEAR(harmonics[ray * kHarmonics + k], expected[k], 12 * 9 * u);
    }
  }
}

struct Sky {
  static constexpr HashGridConfig kConfig{3, 4, 4, 24, 9};
  int n;
  std::vector<float> table, direction, pixel_angle;

  explicit Sky(int n)
      : n(n),
        table(random_floats(hash_grid_size(kConfig), 420, -2, 2)),
        direction(random_floats(3 * n, 421, -1, 1)),
        pixel_angle(random_floats(n, 422, 0, 0.2)) {}
  HashGrid grid() const { return {kConfig, table}; }
  Rays rays() const { return {n, {}, direction}; }
  /// Positions of the directions in the unit cube (field/sky.h).
  std::vector<float> position() const {
    std::vector<float> out;
    for (const float d : direction) out.push_back(0.5f * (d + 1));
    return out;
  }
  std::vector<float> footprint() const {
    std::vector<float> out;
    for (const float angle : pixel_angle) out.push_back(0.25f * angle);
    return out;
  }
};

TEST_P(RayStages, SkyForward) {
  const auto backend = make();
  for (const int n : {1, 33, 700}) {
    const Sky sky(n);
    const std::vector<float> position = sky.position(), footprint = sky.footprint();
    std::vector<float> colour(3 * n, NAN), features(n * Sky::kConfig.outputs());
    backend->grid().sky(sky.grid(), sky.rays(), sky.pixel_angle, colour);
    backend->grid().encode(sky.grid(), {static_cast<std::size_t>(n), position, footprint},
                           features);
    for (int ray = 0; ray < n; ++ray)
      for (int k = 0; k < 3; ++k) {
        double sum = 0;
        for (int l = 0; l < Sky::kConfig.n_levels; ++l) sum += features[(l * n + ray) * 4 + k];
        // Two sums of up to 4 and 6 round, of which the sigmoid's derivative leaves a quarter; then
        // the exponential, a sum and a quotient.
        ASSERT_NEAR(colour[k * n + ray], 1 / (1 + std::exp(-sum)), (10 / 4.0 + 4) * u)
            << ray << ", " << k;
      }
  }
}

TEST_P(RayStages, SkyBackward) {
  const auto backend = make();
  const float before = 0x1p-6f;
  for (const int n : {1, 33, 700})
    for (const bool with_direction : {false, true}) {
      const Sky sky(n);
      const std::vector<float> position = sky.position(), footprint = sky.footprint();
      const std::vector<float> colour = random_floats(3 * n, 423, 0, 1),
                               opacity = random_floats(n, 424, 0, 1),
                               d_rgb = random_floats(3 * n, 425, -1, 1);
      std::vector<float> d_table(sky.table.size(), before),
          d_direction(with_direction ? 3 * n : 0, before);
      backend->grid().sky_backward(sky.grid(), sky.rays(), sky.pixel_angle, colour, opacity, d_rgb,
                                   d_table, d_direction);
      // Expected gradients by the stage of the grid, which has its own test.
      std::vector<float> d_features(n * Sky::kConfig.outputs()), expected(d_table.size(), before),
          d_position(with_direction ? 3 * n : 0);
      for (int l = 0; l < Sky::kConfig.n_levels; ++l)
        for (int ray = 0; ray < n; ++ray)
          for (int k = 0; k < 3; ++k) {
            const double c = colour[k * n + ray];
            d_features[(l * n + ray) * 4 + k] =
                static_cast<float>((1.0 - opacity[ray]) * d_rgb[k * n + ray] * c * (1 - c));
          }
      backend->grid().encode_backward(sky.grid(),
                                      {static_cast<std::size_t>(n), position, footprint},
                                      d_features, expected, d_position);
      // Up to n terms of at most a quarter, each with five roundings, and their sums.
      const double of_table = n * (5 + n) * 0.25 * u;
      EXPECT_TRUE(all_near(
          d_table, [&](auto i) { return expected[i]; }, [&](auto) { return of_table; }));
      // For each level up to 2 x 3 cells times that, times numbers up to 2, summed over three
      // features and three levels.
      const double of_direction = 3 * 3 * 6 * 24 * 2 * 0.25 * 20 * u;
      EXPECT_TRUE(all_near(
          d_direction, [&](auto i) { return before + 0.5 * d_position[i]; },
          [&](auto) { return of_direction; }));
    }
}

/// Two cameras with three knots each; rays of both and of none, at, between and outside of knots.
struct ExposedRays {
  static constexpr AppearanceConfig kConfig{2, 3, 0x1p-6f};
  std::size_t n;
  std::vector<float> parameters, rgb, target, weight;
  std::vector<Exposure> exposure;

  explicit ExposedRays(std::size_t n)
      : n(n),
        parameters(random_floats(kConfig.size(), 430, -4, 4)),
        rgb(random_floats(3 * n, 431, 0, 1)),
        target(random_floats(3 * n, 432, 0, 1)),
        weight(random_floats(n, 433, 0.25, 4)) {
    for (std::size_t ray = 0; ray < n; ++ray)
      exposure.push_back(
          {static_cast<int>(ray % 3) - 1, 0.125f * static_cast<float>(ray % 16) - 0.25f});
  }
  Appearance appearance() const { return {kConfig, parameters}; }
  std::array<double, 3> gains(std::size_t ray) const {
    const std::vector<double> p(parameters.begin(), parameters.end());
    return colour_gains(kConfig, p.data(), exposure[ray]);
  }
};

TEST_P(RayStages, ApplyExposure) {
  const auto backend = make();
  for (const std::size_t n : {1u, 50u, 700u}) {
    const ExposedRays example(n);
    std::vector<float> gains(3 * n, NAN), rgb = example.rgb;
    backend->grid().apply_exposure(example.appearance(), example.exposure, gains, rgb);
    for (std::size_t ray = 0; ray < n; ++ray) {
      const auto expected = example.gains(ray);
      for (std::size_t k = 0; k < 3; ++k) {
        const std::size_t at = k * n + ray;
        // The log gain, up to 0.2, rounds four times; the exponential, up to 1.3, twice and once
        // more in the product.
        ASSERT_NEAR(gains[at], expected[k], 6 * u);
        ASSERT_NEAR(rgb[at], expected[k] * example.rgb[at], 8 * u);
      }
    }
  }
}

TEST_P(RayStages, HuberLossAndItsGradients) {
  const auto backend = make();
  for (const std::size_t n : {1u, 50u, 700u})
    for (const bool weighted : {false, true})
      for (const bool exposed : {false, true}) {
        SCOPED_TRACE(n);
        const ExposedRays example(n);
        const float edge = 0.5f, before = 0x1p-6f;
        std::vector<float> gains(exposed ? 3 * n : 0), d_rgb(3 * n), squares(n, NAN),
            d_parameters(6 * 3, before);
        for (std::size_t at = 0; at < gains.size(); ++at)
          gains[at] = static_cast<float>(example.gains(at % n)[at / n]);
        ColourLossInput colours{example.appearance(), {}, example.rgb, gains,
                                example.target,       {}, edge};
        if (exposed) colours.exposure = example.exposure;
        if (weighted) colours.weight = example.weight;
        double loss = NAN;
        backend->photometric_loss(example.rgb, example.target, d_rgb, &loss);
        backend->grid().huber_loss(colours, d_rgb, squares, d_parameters, &loss);

        double expected_loss = 0;
        std::vector<double> expected(3 * n), d_expected(6 * 3), magnitude(6 * 3);
        int beyond = 0;
        for (std::size_t ray = 0; ray < n; ++ray) {
          double square = 0;
          for (std::size_t k = 0; k < 3; ++k)
            square += std::pow(double(example.rgb[k * n + ray]) - example.target[k * n + ray], 2);
          const auto huber = huber_term(square, double(edge));
          beyond += huber.factor != 1;
          const double weight = weighted ? example.weight[ray] : 1;
          expected_loss += weight * huber.value / (3.0 * double(n));
          ASSERT_NEAR(squares[ray], square / 3, 8 * u * square);
          std::array<double, 3> of_ray{1, 1, 1}, d_gains;
          for (std::size_t k = 0; k < 3; ++k) {
            const std::size_t at = k * n + ray;
            const double d = 2 * (double(example.rgb[at]) - example.target[at]) /
                             (3.0 * double(n)) * weight * huber.factor;
            if (exposed) of_ray[k] = gains[at];
            d_gains[k] = d * example.rgb[at] / of_ray[k];
            expected[at] = d * of_ray[k];
          }
          if (exposed)
            colour_gains_adjoint(ExposedRays::kConfig, example.exposure[ray], of_ray, d_gains,
                                 [&](std::size_t i, double d) {
                                   d_expected[i] += d;
                                   magnitude[i] += std::abs(d);
                                 });
        }
        if (n >= 50) {
          EXPECT_GT(beyond, 5);
          EXPECT_LT(beyond, static_cast<int>(n) - 5);
        }
        for (std::size_t i = 0; exposed && i < d_expected.size(); ++i) {
          const auto term = gain_regulariser(ExposedRays::kConfig, double(example.parameters[i]));
          expected_loss += term.value;
          d_expected[i] += term.derivative;
          magnitude[i] += std::abs(term.derivative);
        }
        // An error rounds once, its square twice and once more in the sum. The root halves that;
        // the Huber threshold and the weight round.
        EXPECT_NEAR(loss, expected_loss, 8 * u * expected_loss);
        EXPECT_TRUE(all_near(
            d_rgb, [&](auto i) { return expected[i]; },
            [&](auto i) { return 12 * u * std::abs(expected[i]); }));
        // Terms round about twenty times, sums of up to n of them n times.
        EXPECT_TRUE(all_near(
            d_parameters, [&](auto i) { return before + d_expected[i]; },
            [&](auto i) { return (20 + double(n)) * u * (magnitude[i] + before); }));
      }
}

TEST_P(RayStages, HuberLossPropagatesNaN) {
  const auto backend = make();
  ExposedRays example(8);
  example.target[9] = NAN;
  std::vector<float> d_rgb(24, 1.0f), squares(8), d_parameters(18);
  const std::vector<float> gains(24, 1.0f);
  double loss = 0;
  backend->grid().huber_loss(
      {example.appearance(), example.exposure, example.rgb, gains, example.target, {}, 0.5f}, d_rgb,
      squares, d_parameters, &loss);
  EXPECT_TRUE(std::isnan(loss));
  EXPECT_TRUE(std::isnan(squares[1]));
}

TEST_P(RayStages, MedianDepth) {
  const auto backend = make();
  for (const BatchSize& size : {BatchSize{1, 1}, {7, 3}, {100, 24}}) {
    SCOPED_TRACE(trace(size));
    const std::vector<float> edges = edges_of(size.n_rays, size.per_ray);
    std::vector<float> weights =
                           random_floats(size.n_rays * size.per_ray, 440, 0.01, 1.0 / size.per_ray),
                       opacity, depth;
    std::fill_n(weights.begin(), size.per_ray, 0.0f);  // the first ray has no weight
    for (int ray = 0; ray < size.n_rays; ++ray) {
      float sum = 0;
      for (int i = 0; i < size.per_ray; ++i) sum += weights[ray * size.per_ray + i];
      opacity.push_back(sum);
    }
    depth.assign(size.n_rays, NAN);
    backend->grid().median_depth(size.n_rays, {size.per_ray, edges}, weights, opacity, depth);
    EXPECT_EQ(depth[0], edges[size.per_ray]);
    for (int ray = 1; ray < size.n_rays; ++ray) {
      // The weight before it is half, up to the rounding of two sums and of the position within one
      // interval, whose length and weight may be 1.5 and 0.01.
      double before = 0;
      for (int i = 0; i < size.per_ray; ++i) {
        const float* const edge = &edges[ray * (size.per_ray + 1) + i];
        const double share = (depth[ray] - double(edge[0])) / (double(edge[1]) - edge[0]);
        before += weights[ray * size.per_ray + i] * std::min(1.0, std::max(0.0, share));
      }
      ASSERT_NEAR(before, 0.5 * opacity[ray], (2 * size.per_ray + 40) * u) << ray;
    }
  }
}

TEST_P(RayStages, ChecksSizes) {
  const auto backend = make();
  GridStages& stages = backend->grid();
  const Sky sky(4);
  const ExposedRays example(4);
  std::vector<std::uint32_t> active(4), fewer(3);
  std::vector<float> n3(3), n4(4), n5(5), n12(12), n18(18), n64(64), d_table(sky.table.size());
  const std::vector<std::uint32_t> none, rays = {0, 2};
  EXPECT_THROW(stages.compact_rays(4, 3, n4, {}, active), std::logic_error);
  EXPECT_THROW(stages.compact_rays(4, 3, n12, {}, fewer), std::logic_error);
  EXPECT_THROW(stages.gather_rays(rays, RayLayout::kRows, n12, n5), std::logic_error);
  EXPECT_THROW(stages.gather_rays(rays, RayLayout::kRows, n5, n4), std::logic_error);
  EXPECT_THROW(stages.gather_rays(none, RayLayout::kRows, n12, n4), std::logic_error);
  EXPECT_THROW(stages.scatter_rays(rays, RayLayout::kColumns, n5, {}, n12), std::logic_error);
  EXPECT_THROW(stages.scatter_rays(rays, RayLayout::kColumns, n4, n5, n12), std::logic_error);
  EXPECT_THROW(stages.midpoints(3, {3, n12}, n4, n12), std::logic_error);
  EXPECT_THROW(stages.midpoints(4, {2, n12}, n5, n5), std::logic_error);
  EXPECT_THROW(stages.harmonics(sky.rays(), n12), std::logic_error);
  EXPECT_THROW(stages.harmonics({4, {}, n5}, n64), std::logic_error);
  EXPECT_THROW(stages.sky(sky.grid(), sky.rays(), n5, n12), std::logic_error);
  EXPECT_THROW(stages.sky(sky.grid(), sky.rays(), sky.pixel_angle, n5), std::logic_error);
  EXPECT_THROW(stages.sky({Sky::kConfig, n5}, sky.rays(), sky.pixel_angle, n12), std::logic_error);
  EXPECT_THROW(stages.sky_backward(sky.grid(), sky.rays(), sky.pixel_angle, n12, n4, n12, n5, {}),
               std::logic_error);
  EXPECT_THROW(
      stages.sky_backward(sky.grid(), sky.rays(), sky.pixel_angle, n12, n4, n12, d_table, n5),
      std::logic_error);
  EXPECT_THROW(
      stages.sky_backward(sky.grid(), sky.rays(), sky.pixel_angle, n12, n5, n12, d_table, {}),
      std::logic_error);
  EXPECT_THROW(stages.apply_exposure(example.appearance(), example.exposure, n12, n5),
               std::logic_error);
  EXPECT_THROW(stages.apply_exposure({ExposedRays::kConfig, n5}, example.exposure, n12, n12),
               std::logic_error);
  EXPECT_THROW(stages.median_depth(4, {2, n12}, n5, n4, n4), std::logic_error);
  const std::vector<float> gains(12, 1.0f);
  const ColourLossInput colours{
      example.appearance(), example.exposure, example.rgb, gains, example.target, {}, 1};
  double loss = 0;
  EXPECT_THROW(stages.huber_loss(colours, n5, n4, n18, &loss), std::logic_error);
  EXPECT_THROW(stages.huber_loss(colours, n12, n5, n18, &loss), std::logic_error);
  EXPECT_THROW(stages.huber_loss(colours, n12, n4, n5, &loss), std::logic_error);
  ColourLossInput without = colours;
  without.gains = {};
  EXPECT_THROW(stages.huber_loss(without, n12, n4, n18, &loss), std::logic_error);
}

}  // namespace
}  // namespace redrive::kernels::conformance
