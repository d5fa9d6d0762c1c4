// SPDX-License-Identifier: Apache-2.0
// Plain loops over the scalar functions, in double between the spans (ref_backend.cc).
#include "redrive/kernels/nerf/ref/ref_nerf_stages.h"

#include <vector>

#include "redrive/kernels/nerf/add_ray_gradient.h"
#include "redrive/kernels/nerf/check_nerf_sizes.h"
#include "redrive/kernels/nerf/plain_nerf_stages.h"
#include "redrive/kernels/nerf/ref/nerf_network.h"

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

class RefNerfStages final : public PlainNerfStages {
 public:
  explicit RefNerfStages(Backend& backend) : PlainNerfStages(backend, nullptr) {}

  void network_forward(const NerfField& field, const Rays& rays, const Samples& samples,
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

  void network_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                        std::span<const float> d_raw, std::span<float> gradients,
                        const RayGradients& of_rays) override {
    check_field_backward(field, rays, samples, d_raw.size(), gradients.size(), of_rays);
    const std::vector<double> parameters(field.parameters.begin(), field.parameters.end());
    const std::size_t n_samples = sample_count(rays.n, samples), per_ray = samples.per_ray;
    std::vector<double> sums(gradients.size()), d_position(3 * per_ray);  // d_position: one ray's
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
};

}  // namespace

std::unique_ptr<NerfStages> make_ref_nerf_stages(Backend& backend) {
  return std::make_unique<RefNerfStages>(backend);
}

}  // namespace redrive::kernels
