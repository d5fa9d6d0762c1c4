// SPDX-License-Identifier: Apache-2.0
// Tests the composed step of the oracle against Jets (Ceres' dual numbers) and differences of the
// same loss, written as one function.
#include <cmath>
#include <vector>

#include <ceres/jet.h>
#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/kernels/nerf/ref/nerf_network.h"
#include "redrive/optim/photometric_loss.h"
#include "redrive/volume/composite.h"

namespace redrive::kernels {
namespace {

double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(21, kStreamTest, stream), i) - 1;
}

/// A small batch with the input of all stages.
struct Batch {
  static constexpr int kRays = 3, kPerRay = 5;
  NerfConfig config{32, 3, 2};
  UnitFromWorld unit_from_world{{0.5f, -0.25f, 2.0f}, 0.125f};
  std::vector<float> origin, direction, t, dt, target, parameters;

  Batch() : t(kRays * kPerRay), dt(t.size()), parameters(nerf_parameter_count(config)) {
    for (int i = 0; i < 3 * kRays; ++i) {
      origin.push_back(static_cast<float>(uniform(1, i)));
      target.push_back(static_cast<float>(0.5 + 0.5 * uniform(2, i)));
    }
    const float directions[kRays][3] = {{0.6f, 0, 0.8f}, {0.48f, 0.6f, 0.64f}, {0, -0.8f, 0.6f}};
    for (int k = 0; k < 3; ++k)
      for (int ray = 0; ray < kRays; ++ray) direction.push_back(directions[ray][k]);
    nerf_initialize(config, 5, parameters);
    for (std::size_t i = 0; i < parameters.size(); ++i)
      if (parameters[i] == 0) parameters[i] = static_cast<float>(0.3 * uniform(3, i));
    parameters[nerf_layer(config, kNerfDensity).bias] = 0.4f;  // so that densities are positive
    make_ref_backend()->nerf().sample_stratified(kRays, {kPerRay, 1, 6, true, 77}, t, dt);
  }

  Rays rays() const { return {kRays, origin, direction}; }
  Samples samples() const { return {kPerRay, t, dt}; }
  NerfField field() const { return {config, unit_from_world, parameters}; }

  /// Returns the backend's loss and writes its gradients.
  double train(std::vector<float>* gradients, std::vector<float>* rgb_out = nullptr,
               const RayGradients& of_rays = {}) const {
    std::vector<float> rgb(3 * kRays), depth(kRays), opacity(kRays);
    double loss = 0;
    make_ref_backend()->nerf().train_rays(field(), rays(), samples(), target,
                                          {rgb, depth, opacity, {}}, *gradients, of_rays, &loss);
    if (rgb_out) *rgb_out = rgb;
    return loss;
  }

  /// Returns the same loss as one function for any scalar type. `open` receives which ReLUs are
  /// open.
  template <class T>
  T loss(const std::vector<T>& p, std::vector<bool>* open = nullptr) const {
    return loss(p, std::vector<T>(origin.begin(), origin.end()),
                std::vector<T>(direction.begin(), direction.end()), open);
  }
  /// Returns the loss for other origins and directions of the rays. Colours still depend on the
  /// batch's own directions.
  template <class T>
  T loss(const std::vector<T>& p, const std::vector<T>& from, const std::vector<T>& towards,
         std::vector<bool>* open = nullptr) const {
    T sum(0);
    ref::NerfActivations<T> activations;
    for (int ray = 0; ray < kRays; ++ray) {
      std::vector<T> raw(4 * kPerRay);
      for (int s = 0; s < kPerRay; ++s) {
        T x[3], d[3], out[4];
        for (int k = 0; k < 3; ++k) {
          const std::size_t at = k * kRays + ray;
          d[k] = T(direction[at]);
          x[k] = (from[at] + T(t[ray * kPerRay + s]) * towards[at] - T(unit_from_world.center[k])) *
                 T(unit_from_world.scale);
        }
        ref::nerf_sample_forward(config, p.data(), x, d, &activations, out);
        for (int k = 0; k < 4; ++k) raw[k * kPerRay + s] = out[k];
        if (!open) continue;
        for (int layer = 0; layer < kNerfLayers; ++layer)
          if (ref::nerf_layer_has_relu(layer))
            for (const T& y : activations.output[layer]) open->push_back(y > T(0));
        open->push_back(out[3] > T(0));
      }
      const RayComposite<T> colour = composite_ray<T>(raw.data(), kPerRay, &t[ray * kPerRay],
                                                      &dt[ray * kPerRay], kPerRay, nullptr);
      for (int k = 0; k < 3; ++k)
        sum += photometric_term<T>(colour.rgb[k], T(target[k * kRays + ray]), kRays).value;
    }
    return sum;
  }
};

// The backend's stages pass raw, rgb, d_rgb and d_raw as float: four roundings of 2^-24, each
// amplified by less than the number of samples and layers behind it.
constexpr double kStageRounding = 4 * (Batch::kPerRay + 12) * 0x1p-24;

TEST(RefBackend, GradientOfTheComposedStepAgreesWithJetsInEveryTensor) {
  using Jet = ceres::Jet<double, 1>;
  const Batch batch;
  std::vector<float> gradients(batch.parameters.size());
  const double loss = batch.train(&gradients);
  std::vector<double> plain(batch.parameters.begin(), batch.parameters.end());
  EXPECT_NEAR(loss, batch.loss(plain), loss * kStageRounding);
  for (const NerfTensor& tensor : nerf_tensors(batch.config)) {
    std::vector<Jet> jets(batch.parameters.begin(), batch.parameters.end());
    double expected = 0, scale = 0;
    for (std::size_t i = tensor.offset;
         i < tensor.offset + std::size_t(tensor.rows) * tensor.columns; ++i) {
      jets[i].v[0] = uniform(10, i);
      expected += gradients[i] * jets[i].v[0];
      scale += std::abs(gradients[i] * jets[i].v[0]);
    }
    EXPECT_GT(scale, 0) << tensor.name << ": nothing tested";
    EXPECT_NEAR(batch.loss(jets).v[0], expected, scale * kStageRounding) << tensor.name;
  }
}

TEST(RefBackend, RayGradientsAgreeWithJets) {
  constexpr int kNumbers = 3 * Batch::kRays;
  using Jet = ceres::Jet<double, 2 * kNumbers>;
  const Batch batch;
  std::vector<float> gradients(batch.parameters.size()), plain(gradients), d_origin(kNumbers),
      d_direction(kNumbers);
  const double loss = batch.train(&gradients, nullptr, {d_origin, d_direction});
  EXPECT_EQ(loss, batch.train(&plain));
  EXPECT_EQ(gradients, plain) << "the parameters' gradients must not change";
  std::vector<Jet> origin, direction;
  for (int i = 0; i < kNumbers; ++i) {
    origin.push_back(Jet(batch.origin[i], i));
    direction.push_back(Jet(batch.direction[i], kNumbers + i));
  }
  const Jet expected = batch.loss(
      std::vector<Jet>(batch.parameters.begin(), batch.parameters.end()), origin, direction);
  double largest[2] = {0, 0};
  for (int i = 0; i < 2 * kNumbers; ++i)
    largest[i / kNumbers] = std::max(largest[i / kNumbers], std::abs(expected.v[i]));
  EXPECT_GT(largest[0], 1e-4) << "nothing tested";
  EXPECT_GT(largest[1], 1e-4) << "nothing tested";
  for (int i = 0; i < kNumbers; ++i) {
    EXPECT_NEAR(d_origin[i], expected.v[i], 4 * largest[0] * kStageRounding) << i;
    EXPECT_NEAR(d_direction[i], expected.v[kNumbers + i], 4 * largest[1] * kStageRounding) << i;
  }
  batch.train(&gradients, nullptr, {d_origin, d_direction});
  for (int i = 0; i < kNumbers; ++i)
    EXPECT_NEAR(d_origin[i], 2 * expected.v[i], 8 * largest[0] * kStageRounding)
        << "adds to the values";
}

TEST(RefBackend, GradientOfTheComposedStepAgreesWithDifferences) {
  const Batch batch;
  std::vector<float> gradients(batch.parameters.size());
  batch.train(&gradients);
  const std::vector<double> parameters(batch.parameters.begin(), batch.parameters.end());
  std::vector<bool> pattern;
  batch.loss(parameters, &pattern);
  const double h = 1e-6;
  int tested = 0, left_out = 0;
  double largest = 0;
  for (const float g : gradients) largest = std::max(largest, double(std::abs(g)));
  for (std::size_t i = 0; i < parameters.size(); i += 23) {
    std::vector<double> shifted = parameters;
    std::vector<bool> above_pattern, below_pattern;
    shifted[i] = parameters[i] + h;
    const double above = batch.loss(shifted, &above_pattern);
    shifted[i] = parameters[i] - h;
    const double below = batch.loss(shifted, &below_pattern);
    if (above_pattern != pattern || below_pattern != pattern) {
      ++left_out;
      continue;
    }
    ++tested;
    // Rounding of the loss over the step, its third derivative times h^2 (both below 1e-8 here),
    // and the roundings of the stages.
    EXPECT_NEAR(gradients[i], (above - below) / (2 * h), 1e-8 + largest * kStageRounding) << i;
  }
  EXPECT_GT(largest, 1e-3);  // otherwise zeros would pass
  EXPECT_GT(tested, 300);
  EXPECT_LT(left_out, tested / 100 + 1);
}

TEST(RefBackend, AddsToTheGradients) {
  const Batch batch;
  std::vector<float> once(batch.parameters.size()), on_top(batch.parameters.size(), 1.0f);
  batch.train(&once);
  batch.train(&on_top);
  for (std::size_t i = 0; i < once.size(); ++i)
    EXPECT_NEAR(on_top[i], 1.0 + once[i], 2 * 0x1p-24 * (1 + std::abs(once[i])));
}

TEST(RefBackend, RenderingMatchesTheForwardPassOfTraining) {
  const Batch batch;
  std::vector<float> gradients(batch.parameters.size()), trained;
  batch.train(&gradients, &trained);
  std::vector<float> rgb(3 * Batch::kRays), depth(Batch::kRays), opacity(Batch::kRays),
      weights(batch.t.size());
  make_ref_backend()->nerf().render_rays(batch.field(), batch.rays(), batch.samples(),
                                         {rgb, depth, opacity, weights});
  EXPECT_EQ(rgb, trained);
  for (int ray = 0; ray < Batch::kRays; ++ray) {
    double sum = 0;
    for (int s = 0; s < Batch::kPerRay; ++s) sum += weights[ray * Batch::kPerRay + s];
    EXPECT_NEAR(sum, opacity[ray], (Batch::kPerRay + 1) * 0x1p-24);
  }
}

TEST(RefBackend, ChecksSizes) {
  const Batch batch;
  const auto backend = make_ref_backend();
  std::vector<float> raw(4 * batch.t.size()), few(7), gradients(batch.parameters.size());
  EXPECT_THROW(backend->nerf().network_forward(batch.field(), batch.rays(), batch.samples(), few),
               std::logic_error);
  EXPECT_THROW(
      backend->nerf().network_backward(batch.field(), batch.rays(), batch.samples(), raw, few, {}),
      std::logic_error);
  EXPECT_THROW(backend->nerf().network_backward(batch.field(), batch.rays(), batch.samples(), raw,
                                                gradients, {few, few}),
               std::logic_error);
  EXPECT_THROW(backend->nerf().network_backward(batch.field(), batch.rays(), batch.samples(), raw,
                                                gradients, {{}, few}),
               std::logic_error);
  NerfField field = batch.field();
  field.parameters = few;
  EXPECT_THROW(backend->nerf().network_forward(field, batch.rays(), batch.samples(), raw),
               std::logic_error);
  EXPECT_THROW(
      backend->composite_forward(Batch::kRays, batch.samples(), raw, {}, {few, few, few, {}}),
      std::logic_error);
  double loss = 0;
  EXPECT_THROW(backend->photometric_loss(few, few, few, &loss), std::logic_error);
  EXPECT_THROW(backend->adam({}, gradients, gradients, gradients, few), std::logic_error);
  EXPECT_THROW(backend->nerf().sample_stratified(2, {5, 3, 3, false, 0}, raw, raw),
               std::logic_error);
}

TEST(RefBackend, PhotometricLossMatchesTheScalarFunction) {
  const std::vector<float> rgb = {1, 0.25f, 0.5f, 1, 0, 0.75f},
                           target = {0, 0.25f, 0.5f, 0.5f, 0.5f, 0.75f};
  std::vector<float> d_rgb(6);
  double loss = 0;
  make_ref_backend()->photometric_loss(rgb, target, d_rgb, &loss);
  EXPECT_DOUBLE_EQ(loss, 0.25);
  for (int i = 0; i < 6; ++i) EXPECT_FLOAT_EQ(d_rgb[i], (rgb[i] - target[i]) / 3);
}

}  // namespace
}  // namespace redrive::kernels
