// SPDX-License-Identifier: Apache-2.0
// Every backend and instruction set x every stage x sizes, against the oracle. Backends that this
// machine cannot run are skipped with the obstacle.
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "all_near.h"
#include "candidates.h"
#include "nerf_case.h"
#include "redrive/volume/composite.h"

namespace redrive::kernels::conformance {
namespace {

constexpr double kUlp = 0x1p-23;

#ifdef REDRIVE_THREAD_SANITIZER
constexpr int kWidest = 64;
#else
constexpr int kWidest = 256;
#endif

std::vector<BatchSize> batch_sizes() {
  std::vector<BatchSize> sizes;
  for (const int n_rays : {1, 7, 33, 100})
    for (const int per_ray : {3, 48, 96, 193}) sizes.push_back({n_rays, per_ray});
  return sizes;
}
/// Sizes for the network: all pairs for narrow networks, each ray count and length at least once
/// for wide ones.
std::vector<BatchSize> network_batch_sizes(const NerfConfig& config) {
  if (kSanitized) return {{1, 3}, {7, 48}, {33, 3}, {1, 193}};
  if (config.width <= 64) return batch_sizes();
  return {{1, 3}, {100, 3}, {1, 193}, {7, 48}, {33, 96}, {7, 193}};
}

/// Makes all cases once, since choosing their biases takes nine passes over the points.
const std::vector<NerfCase>& cases() {
  static const std::vector<NerfCase> all = [] {
    std::vector<NerfCase> made;
    for (const NerfConfig& config : {NerfConfig{32, 4, 2}, NerfConfig{64, 10, 4},
                                     NerfConfig{128, 6, 1}, NerfConfig{256, 10, 4}})
      if (config.width <= kWidest) made.emplace_back(config);
    return made;
  }();
  return all;
}

/// d_raw = factor of the sample x vector of its point, as large as in training.
struct Upstream {
  std::vector<double> factor;
  std::vector<std::array<double, 4>> vector;
  std::vector<float> d_raw;

  explicit Upstream(const NerfBatch& batch)
      : vector(NerfCase::kPoints), d_raw(4 * batch.samples()) {
    for (int p = 0; p < NerfCase::kPoints; ++p)
      for (int k = 0; k < 4; ++k)
        vector[p][k] = static_cast<float>(0x1p-10 * uniform(40, 4 * p + k));
    const double factors[] = {0.5,  1,  2,
                              -0.5, -1, -2};  // powers of two: the products are exact in float
    for (int s = 0; s < batch.samples(); ++s)
      factor.push_back(factors[static_cast<int>(3 * (1 + uniform(41, s)))]);
    for (int k = 0; k < 4; ++k)
      for (int s = 0; s < batch.samples(); ++s)
        d_raw[k * batch.samples() + s] = static_cast<float>(factor[s] * vector[batch.point[s]][k]);
  }
};

/// Returns d_origin or (turns) d_direction [3, n_rays] with variances, of d_position = factor of
/// the sample x derivative of its point.
Uncertain of_rays(const NerfCase& nerf, const NerfBatch& batch, const Upstream& upstream,
                  const Expected& expected, bool turns) {
  const double scale = nerf.unit_from_world.scale;
  Uncertain out{std::vector<double>(3 * batch.n_rays), std::vector<double>(3 * batch.n_rays)};
  for (int ray = 0; ray < batch.n_rays; ++ray) {
    std::map<int, double> of_point;  // errors of equal points are equal and add up like the factors
    for (int s = ray * batch.per_ray; s < (ray + 1) * batch.per_ray; ++s)
      of_point[batch.point[s]] += scale * upstream.factor[s] * (turns ? batch.t[s] : 1);
    for (const auto& [point, factor] : of_point)
      for (int k = 0; k < 3; ++k) {
        out.value[k * batch.n_rays + ray] += factor * expected.d_position[point].value[k];
        out.variance[k * batch.n_rays + ray] +=
            factor * factor * expected.d_position[point].variance[k];
      }
  }
  return out;
}

/// A batch for compositing: stratified samples, some empty intervals, colours and densities of both
/// signs, and some opaque samples.
struct Volume {
  BatchSize size;
  std::vector<float> t, dt, raw;

  explicit Volume(BatchSize size) : size(size), t(size.n_rays * size.per_ray), dt(t.size()) {
    make_ref_backend()->nerf().sample_stratified(size.n_rays, {size.per_ray, 1, 10, true, 5}, t,
                                                 dt);
    raw = random_floats(4 * t.size(), 50, -4, 4);
    for (std::size_t i = 0; i < t.size(); ++i) {
      if (i % 11 == 3) dt[i] = 0;
      if (i % 97 == 41) raw[3 * t.size() + i] = 1e4f;
    }
  }
  Samples samples() const { return {size.per_ray, t, dt}; }
};

/// Bound of a composited sum of weights that are at most 1. Per sample: an exponential (3e-7 = 5 u
/// relative), alpha, the product and the sum, 8 u in all. At the end: a sigmoid. Worst case, linear
/// in the number of samples.
double composite_tolerance(int per_ray) { return (8.0 * per_ray + 16) * kFp32Roundoff; }

struct Composited {
  std::vector<float> rgb, depth, opacity, weights;
  Composited(int n_rays, int per_ray)
      : rgb(3 * n_rays), depth(n_rays), opacity(n_rays), weights(n_rays * per_ray) {}
  CompositeOut out() { return {rgb, depth, opacity, weights}; }
  CompositeOut without_weights() { return {rgb, depth, opacity, {}}; }
};

/// Returns a background, or none for an even number of rays.
std::vector<float> background_of(const BatchSize& size) {
  return size.n_rays % 2 == 0 ? std::vector<float>() : random_floats(3 * size.n_rays, 52, 0, 1);
}

class BackendStages : public BackendConformance {
 protected:
  bool too_slow(const NerfCase& nerf, BatchSize size) const {
    return nerf_macs_per_sample(nerf.config) * size.n_rays * size.per_ray > GetParam().most_macs();
  }
};

INSTANTIATE_TEST_SUITE_P(Backends, BackendStages, testing::ValuesIn(candidates()), name_of);

TEST_P(BackendStages, SamplesStratified) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes())
    for (const bool jitter : {false, true}) {
      SCOPED_TRACE(trace(size));
      const StratifiedSampling how{size.per_ray, 0.7f, 12.3f, jitter, 99};
      std::vector<float> t(size.n_rays * size.per_ray), dt(t.size()), expected(t.size()),
          expected_dt(t.size());
      backend->nerf().sample_stratified(size.n_rays, how, t, dt);
      ref->nerf().sample_stratified(size.n_rays, how, expected, expected_dt);
      // A fused multiply-add may round once, where the oracle rounds twice.
      EXPECT_TRUE(all_near(
          t, [&](auto i) { return expected[i]; }, [&](auto i) { return kUlp * expected[i]; }));
      for (std::size_t i = 0; i < t.size(); ++i) {
        const bool last = i % size.per_ray == static_cast<std::size_t>(size.per_ray) - 1;
        ASSERT_EQ(dt[i], last ? std::numeric_limits<float>::infinity() : t[i + 1] - t[i]) << i;
      }
    }
}

TEST_P(BackendStages, SamplesHierarchical) {
  // The inverse of the coarse density is steep where it vanishes, so no tolerance is useful: the
  // result must equal the scalar function's bit by bit.
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes())
    for (const int extra : {1, 64, 128})
      for (const bool jitter : {false, true}) {
        SCOPED_TRACE(trace(size));
        const Volume volume(size);
        const std::vector<float> weights =
            random_floats(volume.t.size(), 60, 0, 2.0 / size.per_ray);
        std::vector<float> t(size.n_rays * (size.per_ray + extra)), dt(t.size()),
            expected(t.size()), expected_dt(t.size());
        backend->nerf().sample_hierarchical(volume.samples(), weights, extra, jitter, 7, t, dt);
        ref->nerf().sample_hierarchical(volume.samples(), weights, extra, jitter, 7, expected,
                                        expected_dt);
        ASSERT_TRUE(bit_equal(t, expected));
        ASSERT_TRUE(bit_equal(dt, expected_dt));
      }
}

TEST_P(BackendStages, NerfForward) {
  const auto backend = make();
  for (const NerfCase& nerf : cases()) {
    SCOPED_TRACE("width " + std::to_string(nerf.config.width));
    const Expected expected = NerfOracle(nerf, {GetParam().roundoff()}).compute(nullptr, {}, {});
    // A sample at another one's position would be off by the spread of the points; the tolerance
    // must be below that.
    for (int k = 0; k < 4; ++k) {
      double mean = 0, square = 0, deviation = 0;
      for (const auto& raw : expected.raw) mean += raw[k] / NerfCase::kPoints;
      for (const auto& raw : expected.raw)
        square += (raw[k] - mean) * (raw[k] - mean) / NerfCase::kPoints;
      for (const auto& d : expected.raw_deviation) deviation = std::max(deviation, d[k]);
      ASSERT_LT(kDeviations * deviation, std::sqrt(square)) << "channel " << k;
    }
    for (const BatchSize& size : network_batch_sizes(nerf.config)) {
      if (too_slow(nerf, size)) continue;
      SCOPED_TRACE(trace(size));
      const NerfBatch batch(nerf, size.n_rays, size.per_ray);
      std::vector<float> raw(4 * batch.samples(), NAN);
      backend->nerf().network_forward(nerf.field(), batch.rays(), batch.sampling(), raw);
      ASSERT_TRUE(all_near(
          raw,
          [&](std::size_t i) {
            return expected.raw[batch.point[i % batch.samples()]][i / batch.samples()];
          },
          [&](std::size_t i) {
            return kDeviations *
                   expected.raw_deviation[batch.point[i % batch.samples()]][i / batch.samples()];
          }));
    }
  }
}

TEST_P(BackendStages, NerfBackward) {
  const auto backend = make();
  for (const NerfCase& nerf : cases()) {
    SCOPED_TRACE("width " + std::to_string(nerf.config.width));
    for (const BatchSize& size : network_batch_sizes(nerf.config)) {
      if (too_slow(nerf, size)) continue;
      SCOPED_TRACE(trace(size));
      const NerfBatch batch(nerf, size.n_rays, size.per_ray);
      const Upstream upstream(batch);
      const Expected expected = NerfOracle(nerf, {GetParam().roundoff()})
                                    .compute(&batch, upstream.factor, upstream.vector);
      ASSERT_GT(expected.smallest_margin, kDeviations / 2)
          << "a ReLU is at its kink: choose other points";
      const float before = 0x1p-12f;  // gradients are added to
      std::vector<float> gradients(nerf.parameters.size(), before);
      std::vector<float> d_origin(3 * size.n_rays, before), d_direction(d_origin);
      backend->nerf().network_backward(nerf.field(), batch.rays(), batch.sampling(), upstream.d_raw,
                                       gradients, {d_origin, d_direction});
      for (const bool turns : {false, true}) {
        const Uncertain rays = of_rays(nerf, batch, upstream, expected, turns);
        const std::vector<float>& got = turns ? d_direction : d_origin;
        ASSERT_TRUE(all_near(
            got, [&](std::size_t i) { return before + rays.value[i]; },
            [&](std::size_t i) {
              return kDeviations * std::sqrt(rays.variance[i]) +
                     2 * kUlp * (before + std::abs(rays.value[i]));
            }))
            << (turns ? "turned" : "moved");
        double square = 0, variance = 0;
        for (std::size_t i = 0; i < got.size(); ++i) {
          square += rays.value[i] * rays.value[i];
          variance += rays.variance[i];
        }
        ASSERT_LT(kDeviations * std::sqrt(variance), 0.5 * std::sqrt(square))
            << "the tolerance is too large";
      }
      ASSERT_TRUE(all_near(
          gradients, [&](std::size_t i) { return before + expected.gradient[i]; },
          [&](std::size_t i) {
            return kDeviations * expected.gradient_deviation[i] +
                   2 * kUlp * (before + std::abs(expected.gradient[i]));
          }));
      if (size.n_rays < 7) continue;
      for (const NerfTensor& tensor :
           nerf_tensors(nerf.config)) {  // the tolerance must not hide a tensor
        double square = 0, variance = 0;
        for (std::size_t i = tensor.offset;
             i < tensor.offset + std::size_t(tensor.rows) * tensor.columns; ++i) {
          square += expected.gradient[i] * expected.gradient[i];
          variance += expected.gradient_deviation[i] * expected.gradient_deviation[i];
        }
        ASSERT_LT(kDeviations * std::sqrt(variance), 0.5 * std::sqrt(square)) << tensor.name;
      }
    }
  }
}

TEST_P(BackendStages, PropagatesNaN) {
  // A ReLU that turns NaN into 0 would make a broken network look like an empty scene.
  const auto backend = make();
  NerfCase nerf = cases()[0];
  nerf.parameters[nerf_layer(nerf.config, 3).weight + 5] = NAN;
  const NerfBatch batch(nerf, 7, 48);
  std::vector<float> raw(4 * batch.samples());
  backend->nerf().network_forward(nerf.field(), batch.rays(), batch.sampling(), raw);
  EXPECT_TRUE(std::isnan(raw[0]));
  EXPECT_TRUE(std::isnan(raw[4 * batch.samples() - 1]));

  Volume volume({7, 48});
  for (int ray = 0; ray < 7; ++ray) volume.raw[3 * volume.t.size() + 48 * ray + 7 * ray] = NAN;
  Composited got(7, 48);
  backend->composite_forward(7, volume.samples(), volume.raw, {}, got.out());
  for (int ray = 0; ray < 7; ++ray) EXPECT_FALSE(std::isfinite(got.rgb[ray])) << ray;
}

TEST_P(BackendStages, CompositeForward) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes()) {
    SCOPED_TRACE(trace(size));
    const Volume volume(size);
    const std::vector<float> background = background_of(size);
    Composited got(size.n_rays, size.per_ray), expected(size.n_rays, size.per_ray);
    backend->composite_forward(size.n_rays, volume.samples(), volume.raw, background, got.out());
    ref->composite_forward(size.n_rays, volume.samples(), volume.raw, background, expected.out());
    const double tolerance = composite_tolerance(size.per_ray);
    const auto unit = [&](std::size_t) { return tolerance; };
    ASSERT_TRUE(all_near(
        got.rgb, [&](auto i) { return expected.rgb[i]; }, unit));
    ASSERT_TRUE(all_near(
        got.opacity, [&](auto i) { return expected.opacity[i]; }, unit));
    ASSERT_TRUE(all_near(
        got.weights, [&](auto i) { return expected.weights[i]; }, unit));
    ASSERT_TRUE(all_near(
        got.depth, [&](auto i) { return expected.depth[i]; },
        [&](auto) { return 10 * tolerance; }));
    Composited again(size.n_rays, size.per_ray);
    backend->composite_forward(size.n_rays, volume.samples(), volume.raw, background,
                               again.without_weights());
    ASSERT_TRUE(bit_equal(again.rgb, got.rgb));
  }
}

TEST_P(BackendStages, CompositeBackward) {
  const auto backend = make(), ref = make_ref_backend();
  for (const BatchSize& size : batch_sizes()) {
    SCOPED_TRACE(trace(size));
    const Volume volume(size);
    const std::vector<float> d_rgb = random_floats(3 * size.n_rays, 70, -1e-3, 1e-3);
    const std::vector<float> background = background_of(size);
    const std::vector<float> d_weights =
        background.empty() ? background : random_floats(volume.t.size(), 71, -1e-3, 1e-3);
    std::vector<float> d_raw(volume.raw.size(), NAN), expected(d_raw.size());
    backend->composite_backward(size.n_rays, volume.samples(), volume.raw, background,
                                {d_rgb, d_weights}, d_raw);
    ref->composite_backward(size.n_rays, volume.samples(), volume.raw, background,
                            {d_rgb, d_weights}, expected);
    // Colours: w c (1 - c) d. Density: dt times four terms, each the difference of two sums of
    // weights.
    ASSERT_TRUE(all_near(
        d_raw, [&](auto i) { return expected[i]; },
        [&](std::size_t i) {
          const std::size_t n = volume.t.size();
          const float dt = volume.dt[i % n];
          return 1e-3 * composite_tolerance(size.per_ray) *
                 (i < 3 * n        ? 1
                  : std::isinf(dt) ? 0
                                   : 8 * dt);
        }));
  }
}

TEST_P(BackendStages, PhotometricLoss) {
  const auto backend = make(), ref = make_ref_backend();
  for (const int n_rays : {1, 7, 33, 100, 1024}) {
    const std::vector<float> rgb = random_floats(3 * n_rays, 80, 0, 1),
                             target = random_floats(3 * n_rays, 81, 0, 1);
    std::vector<float> d_rgb(rgb.size(), NAN), expected(rgb.size());
    double loss = NAN, expected_loss = NAN;
    backend->photometric_loss(rgb, target, d_rgb, &loss);
    ref->photometric_loss(rgb, target, expected, &expected_loss);
    // The error is rounded, squared and scaled in float; the sum is double.
    EXPECT_NEAR(loss, expected_loss, 3 * kUlp * loss);
    EXPECT_TRUE(all_near(
        d_rgb, [&](auto i) { return expected[i]; },
        [&](auto i) { return 3 * kUlp * std::abs(expected[i]); }));
  }
}

TEST_P(BackendStages, Adam) {
  const auto backend = make();
  for (const std::size_t n : {1u, 15u, 16u, 1000u, 100003u})
    for (const int step : {1, 10, 10000}) {
      SCOPED_TRACE(n);
      std::vector<float> gradients = random_floats(n, 90, -1e-3, 1e-3);
      const std::vector<float> p0 = random_floats(n, 91, -0.2, 0.2),
                               m0 = random_floats(n, 92, -1e-3, 1e-3),
                               v0 = random_floats(n, 93, 0, 1e-6);
      AdamStep how = adam_step(5e-4, step);
      how.lazy = n % 2 == 1;
      for (std::size_t i = 3; i < n; i += 5) gradients[i] = 0;
      std::vector<float> p = p0, m = m0, v = v0, spent = gradients;
      backend->adam(how, spent, p, m, v);
      ASSERT_TRUE(bit_equal(spent, std::vector<float>(n)));
      std::vector<double> expected(n), first(n), second(n), moved(n);
      for (std::size_t i = 0; i < n; ++i) {
        expected[i] = p0[i], first[i] = m0[i], second[i] = v0[i];
        adam_update<double>(how, gradients[i], expected[i], first[i], second[i]);
        moved[i] = how.learning_rate * how.bias1 /
                   (std::sqrt(second[i] * how.bias2) + how.epsilon);  // per unit of m
      }
      // m: two products and a sum of terms that may cancel. v: all terms positive. p: eight
      // roundings of the quotient.
      const auto m_tolerance = [&](std::size_t i) {
        return 2 * kUlp * (std::abs(m0[i]) + std::abs(gradients[i]));
      };
      ASSERT_TRUE(all_near(
          m, [&](auto i) { return first[i]; }, m_tolerance));
      ASSERT_TRUE(all_near(
          v, [&](auto i) { return second[i]; }, [&](auto i) { return 3 * kUlp * second[i]; }));
      ASSERT_TRUE(all_near(
          p, [&](auto i) { return expected[i]; },
          [&](std::size_t i) {
            return kUlp * std::abs(expected[i]) +
                   moved[i] * (m_tolerance(i) + 8 * kUlp * std::abs(first[i]));
          }));
    }
}

/// Returns the tolerance [3, n_rays] of composited colours whose raw values have the deviations of
/// `expected`: first order, and linear over the samples of a ray, since errors of equal points are
/// equal. Writes the colours to `rgb`.
std::vector<double> colour_tolerance(const NerfBatch& batch, const Expected& expected,
                                     std::vector<double>* rgb) {
  std::vector<double> tolerance(3 * batch.n_rays);
  rgb->assign(tolerance.size(), 0);
  const int n = batch.per_ray;
  for (int ray = 0; ray < batch.n_rays; ++ray) {
    std::vector<double> raw(4 * n), slope(4 * n);
    for (int s = 0; s < n; ++s)
      for (int k = 0; k < 4; ++k) raw[k * n + s] = expected.raw[batch.point[ray * n + s]][k];
    const auto colour =
        composite_ray<double>(raw.data(), n, &batch.t[ray * n], &batch.dt[ray * n], n, nullptr);
    for (int channel = 0; channel < 3; ++channel) {
      double d_rgb[3] = {}, sum = composite_tolerance(n);
      d_rgb[channel] = 1;
      composite_ray_adjoint(raw.data(), n, &batch.dt[ray * n], n, d_rgb, slope.data());
      for (int s = 0; s < n; ++s)
        for (int k = 0; k < 4; ++k)
          sum += kDeviations * std::abs(slope[k * n + s]) *
                 expected.raw_deviation[batch.point[ray * n + s]][k];
      tolerance[channel * batch.n_rays + ray] = sum;
      (*rgb)[channel * batch.n_rays + ray] = colour.rgb[channel];
    }
  }
  return tolerance;
}

TEST_P(BackendStages, RendersAndTrainsRays) {
  const auto backend = make();
  for (const NerfCase& nerf : cases()) {
    SCOPED_TRACE("width " + std::to_string(nerf.config.width));
    const Expected expected = NerfOracle(nerf, {GetParam().roundoff()}).compute(nullptr, {}, {});
    for (const BatchSize& size : network_batch_sizes(nerf.config)) {
      if (too_slow(nerf, size)) continue;
      SCOPED_TRACE(trace(size));
      const NerfBatch batch(nerf, size.n_rays, size.per_ray);
      const std::vector<float> target = random_floats(3 * size.n_rays, 100, 0, 1);
      std::vector<double> rgb;
      const std::vector<double> tolerance = colour_tolerance(batch, expected, &rgb);
      const auto value = [&](std::size_t i) { return rgb[i]; };
      const auto allowed = [&](std::size_t i) { return tolerance[i]; };

      Composited rendered(size.n_rays, size.per_ray), trained = rendered, composed = rendered;
      backend->nerf().render_rays(nerf.field(), batch.rays(), batch.sampling(), rendered.out());
      ASSERT_TRUE(all_near(rendered.rgb, value, allowed));
      std::vector<float> gradients(nerf.parameters.size()), composed_gradients(gradients.size());
      std::vector<float> d_rays[2], composed_d_rays[2];  // derivatives of origins, directions
      for (std::vector<float>* one :
           {&d_rays[0], &d_rays[1], &composed_d_rays[0], &composed_d_rays[1]})
        one->assign(3 * size.n_rays, 0.0f);
      double loss = NAN, composed_loss = NAN;
      backend->nerf().train_rays(nerf.field(), batch.rays(), batch.sampling(), target,
                                 trained.without_weights(), gradients, {d_rays[0], d_rays[1]},
                                 &loss);
      ASSERT_TRUE(all_near(trained.rgb, value, allowed));

      // Compares the fused stages with the composition of this backend's own plain stages, which
      // the tests above check.
      backend->nerf().NerfStages::train_rays(
          nerf.field(), batch.rays(), batch.sampling(), target, composed.out(), composed_gradients,
          {composed_d_rays[0], composed_d_rays[1]}, &composed_loss);
      const double order = composite_tolerance(size.per_ray);
      const auto same = [&](std::size_t) { return order; };
      ASSERT_NEAR(loss, composed_loss, 4 * order * std::sqrt(composed_loss) + order * order);
      ASSERT_TRUE(all_near(
          rendered.weights, [&](auto i) { return composed.weights[i]; }, same));
      for (const Composited* one : {&rendered, &trained}) {
        ASSERT_TRUE(all_near(
            one->rgb, [&](auto i) { return composed.rgb[i]; }, same));
        ASSERT_TRUE(all_near(
            one->opacity, [&](auto i) { return composed.opacity[i]; }, same));
        ASSERT_TRUE(all_near(
            one->depth, [&](auto i) { return composed.depth[i]; },
            [&](auto) { return 10 * order; }));
      }
      // Two things may differ: the order of sums, and operands that an fp32 ulp moves across a
      // rounding boundary of bf16, which is rare. So the tolerance is a quarter of one bf16
      // rounding over a tensor, or of a hundred fp32 roundings per sum.
      const double relative =
          std::max(0.25 * GetParam().roundoff(), 25 * kUlp * std::sqrt(batch.samples()));
      const auto expect_same = [&](std::span<const float> fused, std::span<const float> of_stages,
                                   const std::string& what) {
        double square = 0, difference = 0;
        for (std::size_t i = 0; i < fused.size(); ++i) {
          square += double(of_stages[i]) * of_stages[i];
          difference += std::pow(double(fused[i]) - of_stages[i], 2);
        }
        ASSERT_TRUE(square > 0 || size.n_rays == 1) << what;  // a single ray may be empty
        ASSERT_LE(std::sqrt(difference), relative * std::sqrt(square)) << what;
      };
      for (const NerfTensor& tensor : nerf_tensors(nerf.config)) {
        const std::size_t count = std::size_t(tensor.rows) * tensor.columns;
        expect_same(std::span(gradients).subspan(tensor.offset, count),
                    std::span(composed_gradients).subspan(tensor.offset, count), tensor.name);
      }
      expect_same(d_rays[0], composed_d_rays[0], "origins of rays");
      expect_same(d_rays[1], composed_d_rays[1], "directions of rays");
    }
  }
}

TEST_P(BackendStages, RendersOpaqueRays) {
  // Densities times sixteen: most rays end early, and render_rays may skip samples behind
  // (nerf_stages.h).
  constexpr double kLeftOut = 1e-4;
  const auto backend = make();
  const NerfCase& nerf = cases()[1];
  for (const BatchSize& size : {BatchSize{1, 3}, {100, 48}, {33, 193}}) {
    SCOPED_TRACE(trace(size));
    NerfBatch batch(nerf, GetParam().is_oracle() ? 1 : size.n_rays, size.per_ray);
    for (float& dt : batch.dt) dt *= 16;
    Composited rendered(batch.n_rays, batch.per_ray), all = rendered;
    backend->nerf().render_rays(nerf.field(), batch.rays(), batch.sampling(), rendered.out());
    backend->nerf().NerfStages::render_rays(nerf.field(), batch.rays(), batch.sampling(),
                                            all.out());
    const double unit = kLeftOut + composite_tolerance(batch.per_ray);
    const auto allowed = [&](std::size_t) { return unit; };
    ASSERT_TRUE(all_near(
        rendered.rgb, [&](auto i) { return all.rgb[i]; }, allowed));
    ASSERT_TRUE(all_near(
        rendered.opacity, [&](auto i) { return all.opacity[i]; }, allowed));
    ASSERT_TRUE(all_near(
        rendered.weights, [&](auto i) { return all.weights[i]; }, allowed));
    ASSERT_TRUE(all_near(
        rendered.depth, [&](auto i) { return all.depth[i]; }, [&](auto) { return 10 * unit; }));
  }
}

/// Returns the results of all stages for one batch, end to end.
std::map<std::string, std::vector<float>> all_stages(Backend& backend, const NerfCase& nerf,
                                                     const NerfBatch& batch) {
  std::map<std::string, std::vector<float>> out;
  const int n = batch.samples();
  auto& t = out["t"] = std::vector<float>(n);
  auto& dt = out["dt"] = std::vector<float>(n);
  backend.nerf().sample_stratified(batch.n_rays, {batch.per_ray, 1, 10, true, 3}, t, dt);
  auto& raw = out["raw"] = std::vector<float>(4 * n);
  backend.nerf().network_forward(nerf.field(), batch.rays(), batch.sampling(), raw);
  Composited image(batch.n_rays, batch.per_ray);
  backend.composite_forward(batch.n_rays, batch.sampling(), raw, {}, image.out());
  auto& fine = out["fine"] = std::vector<float>(batch.n_rays * (batch.per_ray + 64));
  auto& fine_dt = out["fine dt"] = std::vector<float>(fine.size());
  backend.nerf().sample_hierarchical(batch.sampling(), image.weights, 64, true, 4, fine, fine_dt);
  out["rgb"] = image.rgb;
  const std::vector<float> target = random_floats(image.rgb.size(), 110, 0, 1);
  auto& d_rgb = out["d_rgb"] = std::vector<float>(target.size());
  double loss = NAN;
  backend.photometric_loss(image.rgb, target, d_rgb, &loss);
  out["loss"] = {static_cast<float>(loss)};
  auto& d_raw = out["d_raw"] = std::vector<float>(raw.size());
  backend.composite_backward(batch.n_rays, batch.sampling(), raw, {}, {d_rgb, {}}, d_raw);
  auto& gradients = out["gradients"] = std::vector<float>(nerf.parameters.size());
  auto& d_origin = out["d_origin"] = std::vector<float>(image.rgb.size());
  auto& d_direction = out["d_direction"] = std::vector<float>(image.rgb.size());
  backend.nerf().network_backward(nerf.field(), batch.rays(), batch.sampling(), d_raw, gradients,
                                  {d_origin, d_direction});
  auto& fused = out["fused gradients"] = std::vector<float>(nerf.parameters.size());
  backend.nerf().train_rays(nerf.field(), batch.rays(), batch.sampling(), target, image.out(),
                            fused, {d_origin, d_direction}, &loss);
  out["fused loss"] = {static_cast<float>(loss),
                       static_cast<float>(loss * 0x1p30 - std::floor(loss * 0x1p30))};
  out["trained rgb"] = image.rgb;
  backend.nerf().render_rays(nerf.field(), batch.rays(), batch.sampling(), image.without_weights());
  out["rendered rgb"] = image.rgb;
  auto& p = out["parameters"] = nerf.parameters;
  std::vector<float> m(p.size()), v(p.size());
  std::vector<float> spent = fused;
  backend.adam(adam_step(5e-4, 1), spent, p, m, v);
  return out;
}

TEST_P(BackendStages, SameBitsAgainAndOnOneThread) {
  const auto backend = make(2), single = make(1);
  for (const std::size_t which : {1u, 2u}) {
    if (which >= cases().size()) continue;
    const NerfCase& nerf = cases()[which];
    const NerfBatch batch(nerf, GetParam().is_oracle() ? 7 : 100, GetParam().is_oracle() ? 9 : 48);
    const auto first = all_stages(*backend, nerf, batch), again = all_stages(*backend, nerf, batch),
               alone = all_stages(*single, nerf, batch);
    for (const auto& [stage, values] : first) {
      EXPECT_TRUE(bit_equal(values, again.at(stage))) << stage;
      EXPECT_TRUE(bit_equal(values, alone.at(stage))) << stage << " on one thread";
    }
  }
}

}  // namespace
}  // namespace redrive::kernels::conformance
