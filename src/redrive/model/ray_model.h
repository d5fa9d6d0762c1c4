// SPDX-License-Identifier: Apache-2.0
// Methods that march along rays: a step draws a batch of rays through pixels and one of rays to
// LiDAR returns, an image is rendered tile by tile. (nerf_model.h, grid_model.h)
#pragma once

#include <vector>

#include "redrive/model/model.h"

namespace redrive {

/// What a batch of rays leaves beside its StepSums and gradients.
struct RayGradientsOutput {
  int active_rays = 0;  ///< rays that the field was evaluated on; 0: not counted
  /// [n], squared error of each ray's colour, mean of its channels; where the backend computes,
  /// until the next call with the same workspace. Empty: not computed.
  std::span<const float> squared_errors;
  /// [3, n] where RayBatch::refines, else empty: derivatives of the loss, but for the proposals'
  /// part. Distances of samples, and colours' dependence on the direction, count as constants.
  std::vector<float> d_origin, d_direction;
};

/// A batch's vectors, kept where a backend computes.
class DeviceBatch {
 public:
  /// Call after the vectors have been resized, with the same batch each time. Keeps all of their
  /// capacity, so that a larger batch seldom needs more.
  void keep(kernels::Backend& backend, RayBatch* batch);

 private:
  struct Allocation {
    const void* numbers = nullptr;
    std::size_t size = 0;
    std::shared_ptr<void> handle;
  };
  Allocation allocations_[10];
};

/// Batches of one backend's steps.
struct RayBuffers final : MethodBuffers {
  RayBatch batch, lidar;
  DeviceBatch device_batch, device_lidar;
  PixelSource images;  ///< the samplers' sources, as this backend keeps them
  LidarSource returns;
};

struct RayModel : Model {
  int batch_rays = 1024;                         ///< of a step and rank
  double error_rays = 0;                         ///< share of them that is drawn by the error map
  int lidar_rays = 0;                            ///< of a step and rank, besides
  double initial_rate = 5e-4, rate_gamma = 0.5;  ///< of Adam, and its decay

  virtual int samples_per_ray() const = 0;  ///< that a batch keeps in memory
  /// Rays of the next step, which may depend on how many of them are active; and at most.
  virtual int rays_per_step() const { return batch_rays; }
  virtual int max_rays_per_step() const { return batch_rays; }
  int n_error_rays() const { return static_cast<int>(error_rays * rays_per_step()); }

  /// Leaves losses in workspace->sums() and adds their derivatives to gradients [size()]. Random
  /// numbers are those of (seed, step), from those of batch.first_ray on.
  virtual RayGradientsOutput gradients(kernels::Backend& backend, const RayBatch& batch,
                                       std::uint64_t seed, std::int64_t step,
                                       std::span<float> gradients, Workspace* workspace) const = 0;
  /// The same for rays that end at batch.range_m. Nothing in a method without LiDAR.
  virtual void range_gradients(kernels::Backend&, const RayBatch&, std::uint64_t /*seed*/,
                               std::int64_t /*step*/, std::span<float>, Workspace*) const {}
  /// rgb, depth (metres along the ray) and opacity of the batch's rays, without random numbers.
  /// out.weights stay as they are.
  virtual void render_rays(kernels::Backend& backend, const RayBatch& batch,
                           const kernels::CompositeOut& out, Workspace* workspace) const = 0;

  bool uses_lidar() const override { return lidar_rays > 0; }
  bool uses_error_map() const override { return n_error_rays() > 0; }
  std::string describe_batch() const override { return std::to_string(batch_rays) + " rays"; }
  std::int64_t steps_per_epoch(const TrainingSet& data, int world_size) const override;
  StepOutput step(kernels::Backend& backend, const TrainingSet& data, const StepRequest& request,
                  std::span<float> gradients, StepBuffers* buffers) const override;
  RenderedImage render(kernels::Backend& backend, const RayTable& rays,
                       const ShutterPoses& world_from_camera,
                       const Exposure& exposure) const override;
  std::uint64_t step_bytes() const override;
  DeviceWork training_work() const override;
  DeviceWork rendering_work() const override;
  void rehearse(kernels::Backend& counting, const DeviceWork& work, std::span<float> gradients,
                Workspace* workspace) const override;

 protected:
  void visit_batch(HyperparameterVisitor& visit);  ///< batch_rays
  /// The rule for batch_rays times the samples of a ray at which the field is evaluated.
  void check_batch(int samples_per_ray, const HyperparameterFailure& fail) const;
};

/// Rays that are rendered at a time, at most.
int max_tile_rays(const RayModel& model);

/// Draws the step's batch where the backend computes; the host has its sizes, and its numbers once
/// it fetches them. uniform, error_rays: of this rank; the uniform rays of all ranks are those that
/// one backend would draw of them. `buffers` see one sampler.
void draw_batch(kernels::Backend& backend, const PixelSampler& sampler, int uniform, int error_rays,
                const StepRequest& request, RayBuffers* buffers);
/// Likewise batch `number` of n LiDAR rays.
void draw_lidar_batch(kernels::Backend& backend, const LidarSampler& sampler, std::int64_t number,
                      int n, RayBuffers* buffers);

/// Sums the derivatives of rays by view, from a batch whose directions and views the host has.
std::vector<ViewGradient> view_gradients(const Scene& scene, const RayBatch& batch,
                                         std::span<const float> d_origin,
                                         std::span<const float> d_direction);

/// Variance of the colours of a batch's uniformly drawn rays about their mean, averaged over the
/// channels.
double colour_variance(const RayBatch& batch);

/// The batch's rays as kernels see them.
inline kernels::Rays rays_of(const RayBatch& batch) {
  const std::size_t n = batch.n;
  return {batch.n, std::span(batch.origin).first(3 * n), std::span(batch.direction).first(3 * n)};
}
/// The same where the backend reads them.
inline kernels::Rays upload_rays(const RayBatch& batch, Workspace* workspace) {
  const kernels::Rays rays = rays_of(batch);
  return {rays.n, workspace->put(rays.origin), workspace->put(rays.direction)};
}

}  // namespace redrive
