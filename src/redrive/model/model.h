// SPDX-License-Identifier: Apache-2.0
// Interface of a method: its hyperparameters, parameters, training step, schedule and rendering.
// Trainer, run folder, checkpoint, eval and rendering know methods through this header only.
// Methods that march along rays share ray_model.h; one that rasterises derives from Model itself.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/backend.h"
#include "redrive/model/hyperparameters.h"
#include "redrive/model/rendered_image.h"
#include "redrive/model/workspace.h"
#include "redrive/optim/adam.h"
#include "redrive/rays/lidar_sampler.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/pose_corrections.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Training targets, of which a step draws rays, or images and their tiles.
struct TrainingSet {
  const Scene& scene;                 ///< cameras at their times, poses as refined so far
  const std::vector<Image8>& images;  ///< by view: colours, alpha, mask; held-out ones empty
  const LidarReturns& lidar;
  const PixelSampler& pixels;                ///< batches of rays through pixels
  const LidarSampler* lidar_rays = nullptr;  ///< batches of rays to returns; null: no LiDAR
};

/// One rank's part of a training step.
struct StepRequest {
  std::uint64_t seed = 0;          ///< of the start in use
  std::int64_t step = 0;           ///< from 0
  std::uint64_t pixels_drawn = 0;  ///< in the order of the epochs, by earlier steps
  const Buffer<float>* error_map =
      nullptr;  ///< of the cells of TrainingSet::pixels; where the model uses it
  /// Pixels to draw uniformly, and nothing else; 0: what the method draws in training.
  int pixels = 0;
  bool pose_gradients = false;   ///< StepOutput::views is wanted
  bool colour_variance = false;  ///< StepOutput::colour_variance is wanted
  int rank = 0, world_size = 1;  ///< which part of the step; all ranks draw equally many pixels
};

/// What a step says beside its StepSums and gradients.
struct StepOutput {
  int pixels = 0;        ///< drawn: rays, or pixels of images
  int epoch_pixels = 0;  ///< of them those that count towards the epoch; rgb_mse is their error
  int active_rays = 0;   ///< rays that the field was evaluated on; 0: does not apply
  /// Update of the error map: a cell and the squared error there, mean of the channels. Where the
  /// backend computes, until the next step with the same buffers. Empty: no update.
  std::span<const std::uint32_t> cells;
  std::span<const float> squared_errors;
  std::vector<ViewGradient>
      views;                   ///< derivative of the loss with respect to the pose of each view
  double colour_variance = 0;  ///< of the targets about their mean, averaged over the channels
};

/// A part of the loss.
struct LossTerm {
  const char* name = "";
  double value = 0;
  bool in_loss = true;  ///< counts in the loss that is reported
};

/// Where a run stands.
struct Schedule {
  std::int64_t step = 0;         ///< from 0
  std::int64_t total_steps = 0;  ///< at most
  double progress = 0;           ///< 0..1, by the limit that is nearest
};

/// Parameters that are updated alike.
struct AdamGroup {
  std::size_t offset = 0, size = 0;  ///< in the flat buffer
  AdamStep step;
};

/// Adam's moments, of the layout of the parameters.
struct AdamState {
  Buffer<float> first_moment, second_moment;
};

/// A tensor in the flat buffer of parameters, as a checkpoint shows it.
struct ModelTensor {
  std::string name;
  std::vector<std::int64_t> shape;
  std::size_t offset = 0;
};

/// Working memory that belongs to one method's steps.
struct MethodBuffers {
  virtual ~MethodBuffers() = default;
};

/// Working memory of one backend's steps on one TrainingSet; grows to the largest step.
struct StepBuffers {
  Workspace workspace;
  Buffer<float> gradients;
  std::unique_ptr<MethodBuffers> method;  ///< made by the method's first step
};

/// Work whose device memory is counted before it begins (device_memory.h); 0 and false: none of it.
struct DeviceWork {
  int step_pixels = 0, lidar_rays = 0;  ///< of the largest step
  int tile_pixels = 0;                  ///< rendered at a time
  bool pose_gradients = false;
  bool trains = false;                      ///< gradients and Adam's moments are there
  int scored_width = 0, scored_height = 0;  ///< of the largest image that is scored
};

class Model : public Configurable {
 public:
  // ---- What it is
  virtual const char* method() const = 0;    ///< Method::name
  virtual std::string describe() const = 0;  ///< sizes and samples, for people
  /// Numbers that training changes, beside `parameters`: in checkpoints, not in config.json. Sizes
  /// of tensors may depend on them.
  virtual void visit_state(HyperparameterVisitor&) {}
  /// Rules that tie several numbers together; each number is in its own range already.
  virtual void check(const HyperparameterFailure&) const {}
  /// Sets the hyperparameters that follow from the scene.
  virtual void configure(const Scene& scene) = 0;

  // ---- Parameters
  virtual std::size_t size() const = 0;                    ///< of `parameters`
  virtual std::size_t max_size() const { return size(); }  ///< at most while it trains
  virtual std::vector<ModelTensor> tensors() const = 0;    ///< all of `parameters`, in order
  virtual void initialize(
      std::uint64_t seed) = 0;  ///< makes and fills `parameters`; deterministic in seed
  /// First parameters that follow from the data, such as points of the LiDAR. Called before step 0
  /// of every start, after initialize(); deterministic. May change the shapes of tensors.
  virtual void initialize_from(const TrainingSet&, std::uint64_t /*seed*/) {}

  // ---- Training
  virtual bool uses_lidar() const { return false; }
  virtual bool uses_error_map() const { return false; }
  virtual std::string describe_batch() const = 0;  ///< what a step draws, at most: "2048 rays"
  virtual std::int64_t steps_per_epoch(const TrainingSet& data, int world_size) const = 0;
  /// Leaves losses in buffers->workspace.sums() and adds their derivatives to gradients [size()].
  /// Deterministic in the request.
  virtual StepOutput step(kernels::Backend& backend, const TrainingSet& data,
                          const StepRequest& request, std::span<float> gradients,
                          StepBuffers* buffers) const = 0;
  /// By name, always the same names in the same order.
  virtual std::vector<LossTerm> loss_terms(const StepSums& sums) const = 0;
  /// A part of gradients [size()] that is not finite whenever a finite loss left any of them not
  /// finite.
  virtual std::span<const float> sentinels(std::span<const float> gradients) const {
    return gradients;
  }
  virtual double learning_rate(const Schedule& at) const = 0;
  virtual std::string describe_schedule(std::int64_t total_steps) const = 0;
  /// Groups that tile `parameters`. step: from 1.
  virtual std::vector<AdamGroup> adam_groups(double learning_rate, std::int64_t step) const = 0;
  /// Called after each applied step with what all ranks drew. May change the shapes of tensors,
  /// with `parameters` and the moments (densify, prune); then it fetches them first. Deterministic.
  virtual void finish_step(kernels::Backend&, const StepOutput&, std::int64_t /*step*/,
                           AdamState*) {}

  // ---- Rendering
  /// The image that `rays.camera` sees: colour, depth in metres along the ray and opacity.
  virtual RenderedImage render(kernels::Backend& backend, const RayTable& rays,
                               const ShutterPoses& world_from_camera,
                               const Exposure& exposure) const = 0;

  // ---- Memory
  virtual std::uint64_t step_bytes()
      const = 0;  ///< of the host for a step, beside the gradients; an estimate
  virtual DeviceWork training_work()
      const = 0;  ///< without pose gradients and with LiDAR where it is used
  virtual DeviceWork rendering_work() const = 0;
  /// Goes through a step and a rendering of these sizes on a backend that computes nothing.
  virtual void rehearse(kernels::Backend& counting, const DeviceWork& work,
                        std::span<float> gradients, Workspace* workspace) const = 0;

  Buffer<float> parameters;
};

}  // namespace redrive
