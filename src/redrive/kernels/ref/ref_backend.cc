// SPDX-License-Identifier: Apache-2.0
// The oracle: every stage as plain loops over the scalar functions, on one thread. Spans hold
// float, everything between them is double, so that its rounding is far below the other backends'.
#include <vector>

#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/gaussian/ref/ref_gaussian_stages.h"
#include "redrive/kernels/grid/ref/ref_grid_stages.h"
#include "redrive/kernels/image_score.h"
#include "redrive/kernels/nerf/ref/ref_nerf_stages.h"
#include "redrive/optim/photometric_loss.h"
#include "redrive/volume/composite.h"

namespace redrive::kernels {
namespace {

/// Returns the four channels of one ray as double, [4, per_ray].
std::vector<double> raw_of_ray(std::span<const float> raw, std::size_t n_samples, int ray,
                               int per_ray) {
  std::vector<double> out;
  out.reserve(4 * static_cast<std::size_t>(per_ray));
  for (int k = 0; k < 4; ++k)
    for (int s = 0; s < per_ray; ++s)
      out.push_back(raw[k * n_samples + static_cast<std::size_t>(ray) * per_ray + s]);
  return out;
}

/// A ray's three channels of [3, n_rays]; null for an empty span.
class Colour {
 public:
  Colour(std::span<const float> rgb, int n_rays, int ray) : present_(!rgb.empty()) {
    for (int k = 0; present_ && k < 3; ++k) value_[k] = rgb[k * n_rays + ray];
  }
  const double* data() const { return present_ ? value_ : nullptr; }

 private:
  bool present_;
  double value_[3]{};
};

class RefBackend final : public Backend {
 public:
  RefBackend() : Backend(1) {}

  std::string name() const override { return "ref"; }
  std::optional<Isa> isa() const override { return std::nullopt; }
  ImageScore score(const ImagePair& images) override { return score_images(images); }

  void composite_forward(int n_rays, const Samples& samples, std::span<const float> raw,
                         std::span<const float> background, const CompositeOut& out) override {
    check_composite_forward(n_rays, samples, raw.size(), background, out);
    const int per_ray = samples.per_ray;
    std::vector<double> weights(per_ray);
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = static_cast<std::size_t>(ray) * per_ray;
      const std::vector<double> of_ray =
          raw_of_ray(raw, sample_count(n_rays, samples), ray, per_ray);
      const RayComposite<double> sum =
          composite_ray(of_ray.data(), per_ray, &samples.t[first], &samples.dt[first], per_ray,
                        weights.data(), Colour(background, n_rays, ray).data());
      for (int k = 0; k < 3; ++k) out.rgb[k * n_rays + ray] = static_cast<float>(sum.rgb[k]);
      out.depth[ray] = static_cast<float>(sum.depth);
      out.opacity[ray] = static_cast<float>(sum.opacity);
      if (!out.weights.empty())
        for (int s = 0; s < per_ray; ++s) out.weights[first + s] = static_cast<float>(weights[s]);
    }
  }

  void composite_backward(int n_rays, const Samples& samples, std::span<const float> raw,
                          std::span<const float> background, const CompositeOutGradient& d_out,
                          std::span<float> d_raw) override {
    check_composite_backward(n_rays, samples, raw.size(), background, d_out, d_raw.size());
    const int per_ray = samples.per_ray;
    const std::size_t n_samples = sample_count(n_rays, samples);
    std::vector<double> d_of_ray(4 * static_cast<std::size_t>(per_ray));
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = static_cast<std::size_t>(ray) * per_ray;
      const std::vector<double> of_ray = raw_of_ray(raw, n_samples, ray, per_ray);
      std::vector<double> d_weights;
      if (!d_out.d_weights.empty())
        d_weights.assign(&d_out.d_weights[first], &d_out.d_weights[first] + per_ray);
      composite_ray_adjoint(of_ray.data(), per_ray, &samples.dt[first], per_ray,
                            Colour(d_out.d_rgb, n_rays, ray).data(), d_of_ray.data(),
                            d_weights.empty() ? nullptr : d_weights.data(),
                            Colour(background, n_rays, ray).data());
      for (int k = 0; k < 4; ++k)
        for (int s = 0; s < per_ray; ++s)
          d_raw[k * n_samples + first + s] = static_cast<float>(d_of_ray[k * per_ray + s]);
    }
  }

  void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                        std::span<float> d_rgb, double* loss) override {
    *loss = photometric_batch(rgb, target,
                              check_photometric(rgb.size(), target.size(), d_rgb.size()), d_rgb);
  }

  void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
            std::span<float> first_moment, std::span<float> second_moment) override {
    check_adam(gradients.size(), parameters.size(), first_moment.size(), second_moment.size());
    for (std::size_t i = 0; i < parameters.size(); ++i) {
      double p = parameters[i], m = first_moment[i], v = second_moment[i];
      adam_update<double>(step, gradients[i], p, m, v);
      gradients[i] = 0;
      parameters[i] = static_cast<float>(p);
      first_moment[i] = static_cast<float>(m);
      second_moment[i] = static_cast<float>(v);
    }
  }

  NerfStages& nerf() override { return *nerf_; }
  GridStages& grid() override { return *grid_; }
  GaussianStages& gaussians() override { return *gaussians_; }

 private:
  std::unique_ptr<NerfStages> nerf_ = make_ref_nerf_stages(*this);
  std::unique_ptr<GridStages> grid_ = make_ref_grid_stages();
  std::unique_ptr<GaussianStages> gaussians_ = make_ref_gaussian_stages();
};

}  // namespace

std::unique_ptr<Backend> make_ref_backend() { return std::make_unique<RefBackend>(); }

}  // namespace redrive::kernels
