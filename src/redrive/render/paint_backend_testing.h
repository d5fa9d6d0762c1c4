// SPDX-License-Identifier: Apache-2.0
// For tests: a backend without a network, whose image is a formula of the ray.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <stdexcept>

#include <gtest/gtest.h>

#include "redrive/kernels/backend.h"
#include "redrive/kernels/image_score.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/methods/nerf/nerf_model.h"

namespace redrive {

/// render_rays gives rgb = paint(origin, direction) [world], depth = `range` of the same, else 2 m,
/// opacity 1. Training stages fail the test.
class PaintBackend : public kernels::Backend, public kernels::NerfStages {
 public:
  using Paint = std::function<std::array<float, 3>(const std::array<float, 3>& origin,
                                                   const std::array<float, 3>& direction)>;
  using Range = std::function<float(const std::array<float, 3>& origin,
                                    const std::array<float, 3>& direction)>;
  explicit PaintBackend(Paint paint, Range range = {})
      : Backend(1),
        NerfStages(static_cast<kernels::Backend&>(*this)),
        paint_(std::move(paint)),
        range_(std::move(range)) {}

  std::string name() const override { return "paint"; }
  std::optional<Isa> isa() const override { return std::nullopt; }
  kernels::ImageScore score(const kernels::ImagePair& images) override {
    return kernels::score_images(images);
  }
  void sample_stratified(int, const kernels::StratifiedSampling&, std::span<float>,
                         std::span<float>) override {}
  void sample_hierarchical(const kernels::Samples&, std::span<const float>, int, bool,
                           std::uint64_t, std::span<float>, std::span<float>) override {}
  void render_rays(const kernels::NerfField&, const kernels::Rays& rays, const kernels::Samples&,
                   const kernels::CompositeOut& out) override {
    const int n = rays.n;
    for (int i = 0; i < n; ++i) {
      const auto of = [&](std::span<const float> v) {
        return std::array<float, 3>{v[i], v[n + i], v[2 * n + i]};
      };
      const auto origin = of(rays.origin), direction = of(rays.direction);
      const std::array<float, 3> rgb = paint_(origin, direction);
      for (int c = 0; c < 3; ++c) out.rgb[c * n + i] = rgb[c];
      out.depth[i] = range_ ? range_(origin, direction) : 2.0f;
      out.opacity[i] = 1;
    }
  }

  void network_forward(const kernels::NerfField&, const kernels::Rays&, const kernels::Samples&,
                       std::span<float>) override {
    unexpected();
  }
  void network_backward(const kernels::NerfField&, const kernels::Rays&, const kernels::Samples&,
                        std::span<const float>, std::span<float>,
                        const kernels::RayGradients&) override {
    unexpected();
  }
  void composite_forward(int, const kernels::Samples&, std::span<const float>,
                         std::span<const float>, const kernels::CompositeOut&) override {
    unexpected();
  }
  void composite_backward(int, const kernels::Samples&, std::span<const float>,
                          std::span<const float>, const kernels::CompositeOutGradient&,
                          std::span<float>) override {
    unexpected();
  }
  kernels::NerfStages& nerf() override { return *this; }
  kernels::GridStages& grid() override { throw std::logic_error("no test paints a grid field"); }
  kernels::GaussianStages& gaussians() override {
    throw std::logic_error("no test paints Gaussians");
  }
  void photometric_loss(std::span<const float>, std::span<const float>, std::span<float>,
                        double*) override {
    unexpected();
  }
  void adam(const AdamStep&, std::span<float>, std::span<float>, std::span<float>,
            std::span<float>) override {
    unexpected();
  }

 private:
  static void unexpected() { ADD_FAILURE() << "rendering called a training stage"; }
  Paint paint_;
  Range range_;
};

/// A model that PaintBackend renders: four samples a ray from 1 m to 10 m, parameters of 0.
inline std::unique_ptr<NerfModel> make_painted_model() {
  auto model = std::make_unique<NerfModel>();
  model->config.width = 32;
  model->samples = 4;
  model->near_m = 1;
  model->far_m = 10;
  model->parameters = Buffer<float>(nerf_parameter_count(model->config));
  return model;
}

}  // namespace redrive
