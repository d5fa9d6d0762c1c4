// SPDX-License-Identifier: Apache-2.0
// Compares the stages of each vector width with their scalar functions.
#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/cpu_features.h"
#include "redrive/base/rng.h"
#include "redrive/kernels/cpu/cpu_kernels.h"
#include "redrive/optim/adam.h"
#include "redrive/volume/composite.h"

namespace redrive::kernels {
namespace {

constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr double kEpsilon = 0x1p-24;

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(41, kStreamTest, stream), i) - 1;
}

class CpuStagesTest : public testing::TestWithParam<Isa> {
 protected:
  void SetUp() override {
    if (const auto obstacle = isa_obstacle(GetParam())) GTEST_SKIP() << *obstacle;
  }
  const CpuKernels& kernels() const {
    return GetParam() == Isa::kAvx2 ? avx2::kCpuKernels : avx512::kCpuKernels;
  }
};

struct Volume {
  int n_rays, per_ray;
  std::vector<float> raw, t, dt;

  Volume(int rays, int samples, double density) : n_rays(rays), per_ray(samples) {
    const int n = rays * samples;
    for (int i = 0; i < 4 * n; ++i)
      raw.push_back(static_cast<float>((i < 3 * n ? 4 : density) * uniform(1, i)));
    for (int i = 0; i < n; ++i) {
      dt.push_back(i % samples == samples - 1 ? kInfinity
                                              : static_cast<float>(0.1 + 0.09 * uniform(2, i)));
      t.push_back(i % samples == 0 ? 1.0f : t.back() + dt[i - 1]);
    }
  }
  CompositeForward rays() const {
    return {n_rays,   per_ray,  raw.data(), static_cast<std::size_t>(n_rays) * per_ray,
            t.data(), dt.data()};
  }
};

TEST_P(CpuStagesTest, CompositingMatchesTheScalarFunctions) {
  for (const int per_ray : {1, 2, 7, 16, 33, 96, 200})
    for (const double density : {0.01, 1.0, 300.0}) {
      SCOPED_TRACE(testing::Message() << per_ray << " samples, density " << density);
      constexpr int kRays = 5;
      const Volume volume(kRays, per_ray, density);
      const std::size_t n = volume.t.size();
      std::vector<float> rgb(3 * kRays), depth(kRays), opacity(kRays), weights(n),
          d_raw(4 * n, NAN), d_rgb(3 * kRays);
      for (std::size_t i = 0; i < d_rgb.size(); ++i) d_rgb[i] = static_cast<float>(uniform(3, i));
      std::vector<float> scratch(composite_scratch(per_ray));
      kernels().composite_forward(volume.rays(),
                                  {rgb.data(), kRays, depth.data(), opacity.data(), weights.data()},
                                  scratch.data());
      kernels().composite_backward(volume.rays(), {d_rgb.data(), kRays, d_raw.data(), n},
                                   scratch.data());
      for (int ray = 0; ray < kRays; ++ray) {
        const std::size_t first = static_cast<std::size_t>(ray) * per_ray;
        std::vector<double> raw(4 * per_ray), w(per_ray), d(4 * per_ray);
        for (int k = 0; k < 4; ++k)
          for (int i = 0; i < per_ray; ++i) raw[k * per_ray + i] = volume.raw[k * n + first + i];
        const auto expected = composite_ray<double>(raw.data(), per_ray, &volume.t[first],
                                                    &volume.dt[first], per_ray, w.data());
        // A weight is a product of up to per_ray factors, each with some 8 roundings (exponential
        // and its argument, whose relative error enters times the argument, at most 87 + 8); the
        // sums add per_ray roundings.
        const double tolerance = (9.0 * per_ray + 100) * kEpsilon;
        for (int k = 0; k < 3; ++k) EXPECT_NEAR(rgb[k * kRays + ray], expected.rgb[k], tolerance);
        EXPECT_NEAR(depth[ray], expected.depth, tolerance * volume.t[first + per_ray - 1]);
        EXPECT_NEAR(opacity[ray], expected.opacity, tolerance);
        const double d_ray[3] = {d_rgb[ray], d_rgb[kRays + ray], d_rgb[2 * kRays + ray]};
        composite_ray_adjoint<double>(raw.data(), per_ray, &volume.dt[first], per_ray, d_ray,
                                      d.data());
        for (int i = 0; i < per_ray; ++i) {
          EXPECT_NEAR(weights[first + i], w[i], tolerance);
          // |d_rgb| sums to at most 3; the density's is a difference of two such sums, times dt.
          for (int k = 0; k < 3; ++k)
            EXPECT_NEAR(d_raw[k * n + first + i], d[k * per_ray + i], 3 * tolerance);
          EXPECT_NEAR(d_raw[3 * n + first + i], d[3 * per_ray + i], 6 * tolerance * 0.19) << i;
        }
      }
    }
}

TEST_P(CpuStagesTest, ThinIntervalsAreAccurate) {
  // One sample of optical depth x: opacity 1 - e^-x to relative precision, from 1e-12 to opaque.
  for (double x = 1e-12; x < 200; x *= 1.7) {
    const float raw[4] = {0, 0, 0, static_cast<float>(x)}, t = 1, dt = 1;
    float rgb[3], depth, opacity, weight, scratch[64];
    kernels().composite_forward({1, 1, raw, 1, &t, &dt}, {rgb, 1, &depth, &opacity, &weight},
                                scratch);
    const double expected = -std::expm1(-static_cast<double>(raw[3]));
    EXPECT_NEAR(opacity, expected, 4e-7 * expected) << x;
    EXPECT_NEAR(rgb[0], 0.5 * expected, 4e-7 * expected) << x;
  }
}

TEST_P(CpuStagesTest, PropagatesNaN) {
  for (int channel = 0; channel < 4; ++channel)
    for (const float length : {0.5f, kInfinity}) {
      float raw[4] = {0.1f, 0.2f, 0.3f, 1}, t = 1, rgb[3], depth, opacity, weight, scratch[64];
      raw[channel] = NAN;
      kernels().composite_forward({1, 1, raw, 1, &t, &length}, {rgb, 1, &depth, &opacity, &weight},
                                  scratch);
      EXPECT_TRUE(std::isnan(rgb[channel % 3])) << channel;
    }
}

TEST_P(CpuStagesTest, AdamIsBitEqualToTheScalarFunctionAndLeavesGradientsZero) {
  constexpr std::size_t kSize = 101;
  for (const bool lazy : {false, true}) {
    std::vector<float> p(kSize), m(kSize, 0.0f), v(kSize, 0.0f), g(kSize);
    for (std::size_t i = 0; i < kSize; ++i) p[i] = static_cast<float>(uniform(5, i));
    std::vector<float> expected_p = p, expected_m = m, expected_v = v;
    for (int step = 1; step <= 3; ++step) {
      AdamStep s = adam_step(5e-4, step);
      s.lazy = lazy;
      for (std::size_t i = 0; i < kSize; ++i) {
        // From the second step on, a whole vector and every third parameter have gradient 0.
        const bool nothing = i == 0 || (step > 1 && (i / 16 == 2 || i % 3 == 0));
        g[i] = nothing ? 0.0f
                       : static_cast<float>(std::pow(10.0, 6 * uniform(6, i)) *
                                            uniform(7, i + kSize * step));
        adam_update<float>(s, g[i], expected_p[i], expected_m[i], expected_v[i]);
      }
      kernels().adam({.learning_rate = s.learning_rate,
                      .beta1 = s.beta1,
                      .beta2 = s.beta2,
                      .epsilon = s.epsilon,
                      .bias1 = s.bias1,
                      .bias2 = s.bias2,
                      .lazy = lazy,
                      .gradients = g.data(),
                      .parameters = p.data(),
                      .first_moment = m.data(),
                      .second_moment = v.data(),
                      .n = kSize});
      EXPECT_EQ(p, expected_p);
      EXPECT_EQ(m, expected_m);
      EXPECT_EQ(v, expected_v);
      EXPECT_EQ(g, std::vector<float>(kSize, 0.0f));
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Isa, CpuStagesTest, testing::Values(Isa::kAvx2, Isa::kAvx512),
                         [](const auto& info) {
                           return info.param == Isa::kAvx2 ? "avx2" : "avx512";
                         });

}  // namespace
}  // namespace redrive::kernels
