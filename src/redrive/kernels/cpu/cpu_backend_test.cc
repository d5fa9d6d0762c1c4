// SPDX-License-Identifier: Apache-2.0
// The backend around the kernels: tiles, chunks, threads and the fused stages. (Every stage against
// ref: tests/conformance.)
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/nerf/nerf_stages.h"

namespace redrive::kernels {
namespace {

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(51, kStreamTest, stream), i) - 1;
}

struct Batch {
  int n_rays, per_ray;
  NerfConfig config{32, 5, 2};
  std::vector<float> origin, direction, target, t, dt, parameters;

  Batch(int rays, int samples, Backend& backend)
      : n_rays(rays),
        per_ray(samples),
        t(static_cast<std::size_t>(rays) * samples),
        dt(t.size()),
        parameters(nerf_parameter_count(config)) {
    for (int i = 0; i < 3 * rays; ++i) {
      origin.push_back(static_cast<float>(uniform(1, i)));
      direction.push_back(static_cast<float>(0.5 * uniform(2, i)));
      target.push_back(static_cast<float>(0.5 + 0.5 * uniform(3, i)));
    }
    nerf_initialize(config, 3, parameters);
    parameters[nerf_layer(config, kNerfDensity).bias] = 0.3f;
    backend.nerf().sample_stratified(rays, {samples, 1, 6, true, 5}, t, dt);
  }
  Rays rays() const { return {n_rays, origin, direction}; }
  Samples samples() const { return {per_ray, t, dt}; }
  NerfField field() const { return {config, {{0.1f, 0.2f, -0.3f}, 0.12f}, parameters}; }
};

struct Result {
  double loss = 0;
  std::vector<float> rgb, depth, opacity, weights, gradients, d_origin, d_direction;
  explicit Result(const Batch& b)
      : rgb(3 * b.n_rays),
        depth(b.n_rays),
        opacity(b.n_rays),
        weights(b.t.size()),
        gradients(b.parameters.size()),
        d_origin(rgb.size()),
        d_direction(rgb.size()) {}
  CompositeOut out() { return {rgb, depth, opacity, weights}; }
  RayGradients of_rays() { return {d_origin, d_direction}; }
};

class CpuBackendTest : public testing::TestWithParam<Isa> {
 protected:
  void SetUp() override {
    if (const auto obstacle = isa_obstacle(GetParam())) GTEST_SKIP() << *obstacle;
  }
};

TEST_P(CpuBackendTest, BitEqualForAnyNumberOfThreads) {
  const auto one = make_cpu_backend(GetParam(), 1);
  const Batch batch(101, 24, *one);
  Result expected(batch);
  one->nerf().train_rays(batch.field(), batch.rays(), batch.samples(), batch.target, expected.out(),
                         expected.gradients, expected.of_rays(), &expected.loss);
  for (const int threads : {1, 2, 5}) {
    const auto backend = make_cpu_backend(GetParam(), threads);
    for (int repeat = 0; repeat < 2; ++repeat) {
      Result result(batch);
      backend->nerf().train_rays(batch.field(), batch.rays(), batch.samples(), batch.target,
                                 result.out(), result.gradients, result.of_rays(), &result.loss);
      EXPECT_EQ(result.loss, expected.loss);
      EXPECT_EQ(result.rgb, expected.rgb);
      EXPECT_EQ(result.depth, expected.depth);
      EXPECT_EQ(result.weights, expected.weights);
      EXPECT_EQ(result.gradients, expected.gradients);
      EXPECT_EQ(result.d_origin, expected.d_origin);
      EXPECT_EQ(result.d_direction, expected.d_direction);
    }
  }
}

TEST_P(CpuBackendTest, FusedStagesAreTheCompositionOfThePlainOnes) {
  const auto backend = make_cpu_backend(GetParam(), 2);
  // Fewer tiles than chunks; a last tile with fewer rays; a ray longer than a tile.
  for (const auto& [n_rays, per_ray] : {std::pair{1, 3}, {37, 48}, {2, 1100}}) {
    SCOPED_TRACE(testing::Message() << n_rays << " x " << per_ray);
    const Batch batch(n_rays, per_ray, *backend);
    Result fused(batch), plain(batch), rendered(batch), of_field(batch);
    backend->nerf().train_rays(batch.field(), batch.rays(), batch.samples(), batch.target,
                               fused.out(), fused.gradients, fused.of_rays(), &fused.loss);
    backend->nerf().NerfStages::train_rays(batch.field(), batch.rays(), batch.samples(),
                                           batch.target, plain.out(), plain.gradients,
                                           plain.of_rays(), &plain.loss);
    backend->nerf().train_rays(batch.field(), batch.rays(), batch.samples(), batch.target,
                               of_field.out(), of_field.gradients, {}, &of_field.loss);
    // The same kernels on the same tiles: only the loss is summed in another order.
    EXPECT_NEAR(fused.loss, plain.loss, 3 * n_rays * 0x1p-52 * plain.loss);
    EXPECT_EQ(fused.rgb, plain.rgb);
    EXPECT_EQ(fused.weights, plain.weights);
    EXPECT_EQ(fused.gradients, plain.gradients);
    EXPECT_EQ(fused.d_origin, plain.d_origin);
    EXPECT_EQ(fused.d_direction, plain.d_direction);
    EXPECT_EQ(fused.gradients, of_field.gradients) << "independent of the rays' derivatives";
    backend->nerf().render_rays(batch.field(), batch.rays(), batch.samples(), rendered.out());
    EXPECT_EQ(rendered.rgb, plain.rgb);
    EXPECT_EQ(rendered.depth, plain.depth);
    EXPECT_EQ(rendered.opacity, plain.opacity);
  }
}

// Samples behind an opaque surface are skipped: colours of such rays change by at most 1e-4, others
// not at all.
TEST_P(CpuBackendTest, RenderingSkipsOccludedSamples) {
  const auto backend = make_cpu_backend(GetParam(), 2);
  for (const int per_ray : {40, 300}) {
    Batch batch(61, per_ray, *backend);
    // sigma dt of the mean interval (5 m / per_ray): 1/2 on average, so that light ends after some
    // 18 samples.
    batch.parameters[nerf_layer(batch.config, kNerfDensity).bias] =
        0.5f * static_cast<float>(per_ray) / 5;
    Result exact(batch), rendered(batch);
    std::vector<float> raw(4 * batch.t.size());
    backend->nerf().network_forward(batch.field(), batch.rays(), batch.samples(), raw);
    backend->composite_forward(batch.n_rays, batch.samples(), raw, {}, exact.out());
    backend->nerf().render_rays(batch.field(), batch.rays(), batch.samples(), rendered.out());
    int left_out = 0;
    for (std::size_t i = 0; i < batch.t.size(); ++i) {
      left_out += rendered.weights[i] == 0 && exact.weights[i] > 0;
      EXPECT_LE(std::abs(rendered.weights[i] - exact.weights[i]), 1e-4f);
    }
    EXPECT_GT(left_out, batch.n_rays);
    for (int ray = 0; ray < batch.n_rays; ++ray) {
      // The bound, and the roundings of the sums.
      EXPECT_NEAR(rendered.opacity[ray], exact.opacity[ray], 1e-4 + per_ray * 0x1p-24);
      EXPECT_NEAR(rendered.depth[ray], exact.depth[ray], 6 * (1e-4 + per_ray * 0x1p-24));
      for (int k = 0; k < 3; ++k)
        EXPECT_NEAR(rendered.rgb[k * batch.n_rays + ray], exact.rgb[k * batch.n_rays + ray],
                    1e-4 + per_ray * 0x1p-24);
    }
  }
}

TEST_P(CpuBackendTest, GradientsAccumulate) {
  const auto backend = make_cpu_backend(GetParam(), 1);
  const Batch batch(5, 7, *backend);
  Result once(batch), twice(batch);
  backend->nerf().train_rays(batch.field(), batch.rays(), batch.samples(), batch.target, once.out(),
                             once.gradients, {}, &once.loss);
  double norm = 0, error = 0;
  for (int i = 0; i < 2; ++i)
    backend->nerf().train_rays(batch.field(), batch.rays(), batch.samples(), batch.target,
                               twice.out(), twice.gradients, {}, &twice.loss);
  for (std::size_t i = 0; i < once.gradients.size(); ++i) {
    norm += once.gradients[i] * once.gradients[i];
    error += std::pow(twice.gradients[i] - 2.0 * once.gradients[i], 2);
  }
  EXPECT_GT(norm, 0);
  EXPECT_LT(std::sqrt(error / norm), 1e-5);  // some hundred roundings of 2^-24 in another order
}

TEST_P(CpuBackendTest, RejectsMismatchedShapes) {
  const auto backend = make_cpu_backend(GetParam(), 1);
  const Batch batch(4, 6, *backend);
  Result result(batch);
  result.rgb.pop_back();
  EXPECT_THROW(
      backend->nerf().render_rays(batch.field(), batch.rays(), batch.samples(), result.out()),
      std::logic_error);
}

INSTANTIATE_TEST_SUITE_P(Isa, CpuBackendTest,
                         testing::Values(Isa::kAvx2, Isa::kAvx512, Isa::kAvx512Bf16),
                         [](const auto& info) {
                           std::string name(isa_name(info.param));
                           for (char& c : name)
                             if (c == '-') c = '_';
                           return name;
                         });

}  // namespace
}  // namespace redrive::kernels
