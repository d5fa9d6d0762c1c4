// SPDX-License-Identifier: Apache-2.0
// Base of methods that march along rays (nerf_model.h, grid_model.h): a step draws a batch of rays
// through pixels and a batch of rays to LiDAR returns; an image is rendered tile by tile.
#pragma once

#include <vector>

#include "redrive/model/trainee.h"

namespace redrive {

/// Outputs of a batch of rays besides its StepSums and gradients.
struct RayGradientsOutput {
  int active_rays = 0;  ///< rays that the field was evaluated on; 0: not counted
  /// [n], squared error of each ray's colour, mean of its channels. Valid until the next call with
  /// the same workspace. Empty: not computed.
  std::span<const float> squared_errors;
  /// [3, n] where RayBatch::refines, else empty: derivatives of the loss without the proposal loss.
  /// Treats the distances of samples and the direction input of colours as constants.
  std::vector<float> d_origin, d_direction;
};

/// Batches of the steps of a run.
struct RayBuffers final : MethodBuffers {
  RayBatch batch, lidar;
};

struct RayModel : Trainee {
  int batch_rays = 1024;                         ///< per step and rank
  double error_rays = 0;                         ///< fraction that is drawn by the error map
  int lidar_rays = 0;                            ///< additional rays per step and rank
  double initial_rate = 5e-4, rate_gamma = 0.5;  ///< learning rate and its decay

  virtual int samples_per_ray() const = 0;  ///< samples that a batch keeps in memory
  /// Rays of the next step, which may depend on the fraction of active rays, and their upper bound.
  virtual int rays_per_step() const { return batch_rays; }
  virtual int max_rays_per_step() const { return batch_rays; }
  int n_error_rays() const { return static_cast<int>(error_rays * rays_per_step()); }

  /// Writes losses to workspace->sums() and adds their derivatives to gradients [size()]. Random
  /// numbers follow from (seed, step), from batch.first_ray on.
  virtual RayGradientsOutput gradients(kernels::Backend& backend, const RayBatch& batch,
                                       std::uint64_t seed, std::int64_t step,
                                       std::span<float> gradients, Workspace* workspace) const = 0;
  /// Does the same for LiDAR rays, which end at batch.range_m. Does nothing without LiDAR.
  virtual void range_gradients(kernels::Backend&, const RayBatch&, std::uint64_t /*seed*/,
                               std::int64_t /*step*/, std::span<float>, Workspace*) const {}
  /// Renders rgb, depth (metres along the ray) and opacity of the batch's rays, without random
  /// numbers. Does not write out.weights.
  virtual void render_rays(kernels::Backend& backend, const RayBatch& batch,
                           const kernels::CompositeOut& out, Workspace* workspace) const = 0;

  bool uses_lidar() const override { return lidar_rays > 0; }
  bool uses_error_map() const override { return n_error_rays() > 0; }
  std::string describe_batch() const override { return std::to_string(batch_rays) + " rays"; }
  std::int64_t steps_per_epoch(const TrainingSet& data, int world_size) const override;
  StepOutput step(kernels::Backend& backend, const TrainingSet& data, const StepRequest& request,
                  std::span<float> gradients, StepBuffers* buffers) const override;
  void render_to(kernels::Backend& backend, const RayTable& rays,
                 const ShutterPoses& world_from_camera, const Exposure& exposure,
                 RenderedImage* image) const override;
  /// Traces like the rays of LiDAR returns in training, with kLidarBeamAngle_rad.
  RenderedRays trace(kernels::Backend& backend, const kernels::Rays& rays,
                     const std::vector<MovingObject>& actors = {}) const override;
  std::uint64_t step_bytes() const override;

 protected:
  void visit_batch(HyperparameterVisitor& visit);  ///< batch_rays
  /// Checks the limit on batch_rays times the samples per ray of the field.
  void check_batch(int samples_per_ray, const HyperparameterFailure& fail) const;
};

/// Returns the maximum number of rays rendered at a time.
int max_tile_rays(const RayModel& model);

/// Draws the step's batch. uniform, error_rays: this rank's. The uniform rays of all ranks together
/// are the uniform rays of a single backend.
void draw_batch(const PixelSampler& sampler, int uniform, int error_rays,
                const StepRequest& request, RayBatch* batch);

/// Sums the derivatives of rays for each view.
std::vector<ViewGradient> view_gradients(const Scene& scene, const RayBatch& batch,
                                         std::span<const float> d_origin,
                                         std::span<const float> d_direction);

/// Returns the variance of the colours of a batch's uniformly drawn rays, averaged over the
/// channels.
double colour_variance(const RayBatch& batch);

/// Returns the batch's rays for kernels.
inline kernels::Rays rays_of(const RayBatch& batch) {
  const std::size_t n = batch.n;
  return {batch.n, std::span(batch.origin).first(3 * n), std::span(batch.direction).first(3 * n)};
}

}  // namespace redrive
