// SPDX-License-Identifier: Apache-2.0
// The oracle: every stage as plain loops over the scalar functions, one thread. Spans hold float as
// everywhere, what happens between them is double, so that its own rounding stays far below that of
// the kernels it judges.
#include <vector>

#include "redrive/kernels/check_sizes.h"
#include "redrive/kernels/ref/nerf_network.h"
#include "redrive/kernels/ref/ref_grid_stages.h"
#include "redrive/optim/photometric_loss.h"
#include "redrive/volume/composite.h"
#include "redrive/volume/hierarchical_sampling.h"

namespace redrive::kernels {
namespace {

/// Position in the unit cube and direction of sample `s` of `ray`.
struct FieldPoint {
  double position[3], direction[3];

  FieldPoint(const UnitFromWorld& unit_from_world, const Rays& rays, int ray, float t) {
    for (int k = 0; k < 3; ++k) {
      direction[k] = rays.direction[k * rays.n + ray];
      position[k] = (rays.origin[k * rays.n + ray] + t * direction[k] - unit_from_world.center[k]) *
                    unit_from_world.scale;
    }
  }
};

/// The four channels of one ray as double, [4, per_ray].
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
  Colour(std::span<const float> rgb, int n_rays, int ray) : given_(!rgb.empty()) {
    for (int k = 0; given_ && k < 3; ++k) value_[k] = rgb[k * n_rays + ray];
  }
  const double* data() const { return given_ ? value_ : nullptr; }

 private:
  bool given_;
  double value_[3]{};
};

class RefBackend final : public Backend {
 public:
  std::string name() const override { return "ref"; }
  std::optional<Isa> isa() const override { return std::nullopt; }
  int threads() const override { return 1; }

  void sample_stratified(int n_rays, const StratifiedSampling& how, std::span<float> t,
                         std::span<float> dt) override {
    check_stratified(n_rays, how, t.size(), dt.size());
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = static_cast<std::size_t>(ray) * how.per_ray;
      stratified_ray(how.per_ray, how.near_m, how.far_m, how.jitter, how.key, first, &t[first],
                     &dt[first]);
    }
  }

  void sample_hierarchical(const Samples& coarse, std::span<const float> weights, int extra,
                           bool jitter, std::uint64_t key, std::span<float> t,
                           std::span<float> dt) override {
    const int n_rays = check_hierarchical(coarse, weights.size(), extra, t.size(), dt.size());
    for (std::size_t ray = 0; ray < static_cast<std::size_t>(n_rays); ++ray) {
      const std::size_t from = ray * coarse.per_ray, to = ray * (coarse.per_ray + extra);
      hierarchical_ray(&coarse.t[from], &weights[from], coarse.per_ray, extra, jitter, key,
                       ray * extra, &t[to], &dt[to]);
    }
  }

  void nerf_forward(const NerfField& field, const Rays& rays, const Samples& samples,
                    std::span<float> raw) override {
    check_field(field, rays, samples);
    check_raw(rays.n, samples, raw.size());
    const std::vector<double> parameters(field.parameters.begin(), field.parameters.end());
    const std::size_t n_samples = sample_count(rays.n, samples);
    ref::NerfActivations<double> activations;
    for (std::size_t i = 0; i < n_samples; ++i) {
      const FieldPoint point(field.unit_from_world, rays, static_cast<int>(i / samples.per_ray),
                             samples.t[i]);
      double out[4];
      ref::nerf_sample_forward(field.config, parameters.data(), point.position, point.direction,
                               &activations, out);
      for (int k = 0; k < 4; ++k) raw[k * n_samples + i] = static_cast<float>(out[k]);
    }
  }

  void nerf_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                     std::span<const float> d_raw, std::span<float> gradients,
                     const RayGradients& of_rays) override {
    check_field(field, rays, samples);
    check_raw(rays.n, samples, d_raw.size());
    check_ray_gradients(rays.n, of_rays);
    REDRIVE_CHECK_OP(gradients.size(), ==, field.parameters.size());
    const std::vector<double> parameters(field.parameters.begin(), field.parameters.end());
    const std::size_t n_samples = sample_count(rays.n, samples), per_ray = samples.per_ray;
    std::vector<double> sums(gradients.size()), d_position(3 * per_ray);  // the latter of one ray
    ref::NerfActivations<double> activations;
    for (std::size_t i = 0; i < n_samples; ++i) {
      const int ray = static_cast<int>(i / per_ray);
      const FieldPoint point(field.unit_from_world, rays, ray, samples.t[i]);
      double raw[4], d[4], d_point[3];
      for (int k = 0; k < 4; ++k) d[k] = d_raw[k * n_samples + i];
      ref::nerf_sample_forward(field.config, parameters.data(), point.position, point.direction,
                               &activations, raw);
      ref::nerf_sample_adjoint(field.config, parameters.data(), activations, d, sums.data(),
                               d_point);
      for (int k = 0; k < 3; ++k) d_position[k * per_ray + i % per_ray] = d_point[k];
      if (of_rays.wanted() && i % per_ray == per_ray - 1)
        add_ray_gradient(field.unit_from_world, rays.n, samples, ray, d_position.data(), per_ray,
                         of_rays);
    }
    for (std::size_t i = 0; i < sums.size(); ++i)
      gradients[i] = static_cast<float>(gradients[i] + sums[i]);
  }

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
                          std::span<const float> background, const CompositeAdjoint& adjoint,
                          std::span<float> d_raw) override {
    check_composite_backward(n_rays, samples, raw.size(), background, adjoint, d_raw.size());
    const int per_ray = samples.per_ray;
    const std::size_t n_samples = sample_count(n_rays, samples);
    std::vector<double> d_of_ray(4 * static_cast<std::size_t>(per_ray));
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = static_cast<std::size_t>(ray) * per_ray;
      const std::vector<double> of_ray = raw_of_ray(raw, n_samples, ray, per_ray);
      std::vector<double> d_weights;
      if (!adjoint.d_weights.empty())
        d_weights.assign(&adjoint.d_weights[first], &adjoint.d_weights[first] + per_ray);
      composite_ray_adjoint(of_ray.data(), per_ray, &samples.dt[first], per_ray,
                            Colour(adjoint.d_rgb, n_rays, ray).data(), d_of_ray.data(),
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

  GridStages& grid() override { return *grid_; }

 private:
  std::unique_ptr<GridStages> grid_ = make_ref_grid_stages();
};

}  // namespace

std::unique_ptr<Backend> make_ref_backend() { return std::make_unique<RefBackend>(); }

}  // namespace redrive::kernels
