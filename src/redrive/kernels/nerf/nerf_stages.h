// SPDX-License-Identifier: Apache-2.0
// The stages that only --method nerf needs (Backend::nerf): its sampling and its network, and two
// fused stages. Conventions as in backend.h.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

#include "redrive/base/buffer.h"
#include "redrive/field/nerf_field.h"
#include "redrive/field/unit_from_world.h"
#include "redrive/kernels/backend.h"

namespace redrive::kernels {

/// One network (field/nerf_field.h) with its parameters, and the scene's unit cube.
struct NerfField {
  NerfConfig config;
  UnitFromWorld unit_from_world;
  std::span<const float> parameters;
};

/// Derivatives of the loss with respect to the rays, d_origin and d_direction [3, n_rays]; stages
/// add to them. Both empty: not wanted. Only the samples' positions are differentiated: distances
/// along the ray and the colour's dependence on the viewing direction count as constants.
struct RayGradients {
  std::span<float> d_origin, d_direction;
  bool wanted() const { return !d_origin.empty(); }
};

/// Stratified sampling (Mildenhall et al. 2020, eq. 2): per_ray bins of equal length in [near_m,
/// far_m], one sample in each. With jitter it is uniform in its bin by random_unit(key, ray *
/// per_ray + i), without (rendering) in the middle. dt_i = t_{i+1} - t_i, the last +infinity.
struct StratifiedSampling {
  int per_ray = 0;
  float near_m = 0, far_m = 0;
  bool jitter = true;
  std::uint64_t key = 0;
};

class NerfStages {
 public:
  /// The fused stages' defaults call `backend`, which owns this object.
  explicit NerfStages(Backend& backend) : backend_(backend) {}
  virtual ~NerfStages() = default;
  NerfStages(const NerfStages&) = delete;
  NerfStages& operator=(const NerfStages&) = delete;

  // ---- volume/
  /// t, dt [n_rays, how.per_ray].
  virtual void sample_stratified(int n_rays, const StratifiedSampling& how, std::span<float> t,
                                 std::span<float> dt) = 0;
  /// Hierarchical sampling (Mildenhall et al. 2020, section 5.2): draws `extra` samples per ray
  /// from the piecewise-constant density that `weights` of `coarse` describe
  /// (volume/hierarchical_sampling.h) and merges them with the coarse ones, ascending. jitter and
  /// key as in StratifiedSampling, with the key's index ray * extra + i. t, dt [n_rays,
  /// coarse.per_ray + extra].
  virtual void sample_hierarchical(const Samples& coarse, std::span<const float> weights, int extra,
                                   bool jitter, std::uint64_t key, std::span<float> t,
                                   std::span<float> dt) = 0;

  // ---- field/
  /// raw [4, n_rays * per_ray]: r, g, b before the sigmoid, density before the ReLU.
  virtual void network_forward(const NerfField& field, const Rays& rays, const Samples& samples,
                               std::span<float> raw) = 0;
  /// Adds the gradients with respect to the parameters to `gradients` [n_parameters] and, where
  /// wanted, the gradients of the rays to `of_rays`; d_raw as raw. Recomputes the forward pass.
  virtual void network_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                                std::span<const float> d_raw, std::span<float> gradients,
                                const RayGradients& of_rays) = 0;

  // ---- fused stages; the defaults are compositions of the plain ones
  /// Forward pass, compositing, mean squared error and backward pass of a batch: adds to
  /// `gradients` and `of_rays` as network_backward does and writes `out` (weights only if not
  /// empty). target [3, n_rays].
  virtual void train_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                          std::span<const float> target, const CompositeOut& out,
                          std::span<float> gradients, const RayGradients& of_rays, double* loss);
  /// Forward pass and compositing. May skip samples behind a transmittance below 1e-4, which
  /// changes colour, opacity and the sum of the weights by less than that.
  virtual void render_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                           const CompositeOut& out);

 private:
  /// The first n numbers of a buffer that grows as needed.
  static std::span<float> scratch(Buffer<float>* buffer, std::size_t n);

  Backend& backend_;
  Buffer<float> raw_, d_raw_, d_rgb_;
};

}  // namespace redrive::kernels
