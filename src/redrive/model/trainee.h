// SPDX-License-Identifier: Apache-2.0
// Interface of a model in training: its hyperparameters, parameters, training step, schedule and
// memory. Trainer, checkpoint, plan and bench use models only through this header; what renders a
// trained one uses its base, Field. Models that march along rays share methods/march/ray_model.h; a
// rasteriser derives from Trainee itself.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/base/parallel.h"
#include "redrive/kernels/backend.h"
#include "redrive/model/field.h"
#include "redrive/model/hyperparameters.h"
#include "redrive/model/workspace.h"
#include "redrive/optim/adam.h"
#include "redrive/rays/lidar_sampler.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/image_cache.h"
#include "redrive/scene/pose_gradients.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Training data that a step samples rays, images or tiles from.
struct TrainingSet {
  const Scene& scene;  ///< cameras and their current poses
  ViewImages images;  ///< one per view: colours, alpha, mask; images of held-out views are not used
  const LidarReturns& lidar;
  const PixelSampler& pixels;                ///< batches of rays through pixels
  const LidarSampler* lidar_rays = nullptr;  ///< batches of rays to returns; null: no LiDAR
};

/// Adam's moments. The first Trainee::updated_in_step() parameters have both in one word
/// (optim/packed_moments.h), the others in floats.
struct AdamState {
  Buffer<float> first_moment, second_moment;
  Buffer<std::uint32_t> packed;
  /// Errors of the images summed by where each part of the model is drawn, since its number of
  /// parts changed last (Trainee::numbers_per_error()).
  Buffer<float> errors;

  std::size_t size() const { return first_moment.size() + packed.size(); }
};

/// The update that step() applies itself: see Trainee::updated_in_step().
struct StepUpdate {
  double learning_rate = 0;
  std::int64_t step = 0;        ///< from 1
  std::span<float> parameters;  ///< the model's
  AdamState* adam = nullptr;
};

/// One rank's part of a training step.
struct StepRequest {
  std::uint64_t seed = 0;          ///< seed of the start in use
  std::int64_t step = 0;           ///< from 0
  double progress = 0;             ///< progress of the run, 0..1
  std::uint64_t pixels_drawn = 0;  ///< in the order of the epochs, by earlier steps
  const Buffer<float>* error_map =
      nullptr;  ///< errors of the cells of TrainingSet::pixels; where the model uses it
  /// Number of pixels to draw uniformly, without other samples; 0: the method's training batch.
  int pixels = 0;
  bool pose_gradients = false;         ///< requests StepOutput::views
  bool colour_variance = false;        ///< requests StepOutput::colour_variance
  int rank = 0, world_size = 1;        ///< all ranks draw equally many pixels
  const StepUpdate* update = nullptr;  ///< null: the step computes all gradients
};

/// Outputs of a step besides its StepSums and gradients.
struct StepOutput {
  int pixels = 0;        ///< pixels drawn
  int epoch_pixels = 0;  ///< pixels that count towards the epoch; rgb_mse is their error
  int active_rays = 0;   ///< rays that the field was evaluated on; 0: does not apply
  /// Stage of the schedule, the same on all ranks. Errors of two steps are comparable only within
  /// one stage; a method that draws images at several sizes has a stage for each.
  int stage = 0;
  /// Update of the error map: cells and their squared errors, mean of the channels. Valid until the
  /// next step with the same buffers. Empty: no update.
  std::span<const std::uint32_t> cells;
  std::span<const float> squared_errors;
  std::vector<ViewGradient>
      views;  ///< derivative of the loss with respect to the pose of each view
  /// variance of the targets about their mean, averaged over the channels
  double colour_variance = 0;
  int left_out_tracks = 0;  ///< actors' tracks without a gradient, because it is not finite
};

/// A part of the loss.
struct LossTerm {
  const char* name = "";
  double value = 0;
  bool in_loss = true;  ///< is part of the reported loss
};

/// Progress of a run.
struct Schedule {
  std::int64_t step = 0;         ///< from 0
  std::int64_t total_steps = 0;  ///< at most
  double progress = 0;           ///< 0..1, by the limit that will end the run
};

/// Parameters with the same Adam settings.
struct AdamGroup {
  std::size_t offset = 0, size = 0;  ///< in the flat buffer
  AdamStep step;
};

/// A tensor of a checkpoint in the flat buffer of parameters.
struct ModelTensor {
  std::string name;
  std::vector<std::int64_t> shape;
  std::size_t offset = 0;
};

/// Working memory of a method's steps.
struct MethodBuffers {
  virtual ~MethodBuffers() = default;
};

/// Working memory of a backend's steps on one TrainingSet; grows to the largest step.
struct StepBuffers {
  Workspace workspace;
  Buffer<float> gradients;
  std::unique_ptr<MethodBuffers> method;  ///< made by prepare() or the first step
};

class Trainee : public Configurable, public Field {
 public:
  // ---- Hyperparameters
  /// Visits the numbers that training changes besides `parameters`. They are in checkpoints, not in
  /// config.json. Sizes of tensors may depend on them.
  virtual void visit_state(HyperparameterVisitor&) {}
  /// Checks rules between hyperparameters, each of which is within its range.
  virtual void check(const HyperparameterFailure&) const {}
  /// Sets the hyperparameters that follow from the scene.
  virtual void configure(const Scene& scene) = 0;

  // ---- Parameters
  virtual std::size_t size() const = 0;                    ///< size of `parameters`
  virtual std::size_t max_size() const { return size(); }  ///< upper bound during training
  virtual std::vector<ModelTensor> tensors() const = 0;    ///< tile `parameters`, in order
  virtual void initialize(
      std::uint64_t seed) = 0;  ///< allocates and fills `parameters`; deterministic in seed
  /// Initialises parameters from the data, such as LiDAR points. Called after initialize(), before
  /// step 0 of every start. Must be deterministic; may change the shapes of tensors.
  virtual void initialize_from(const TrainingSet&, std::uint64_t /*seed*/, ThreadPool&) {}

  /// Number of leading parameters that step() updates itself if StepRequest::update asks for it, so
  /// that their gradients are not kept. update() then handles the others.
  virtual std::size_t updated_in_step() const { return 0; }
  /// Returns the first of `packed` whose moments are not finite.
  virtual std::optional<std::size_t> bad_moment(std::span<const std::uint32_t> /*packed*/) const {
    return std::nullopt;
  }
  /// Number of the parameters that step() updates itself for each of AdamState::errors; 0: a method
  /// without errors.
  virtual std::size_t numbers_per_error() const { return 0; }
  std::size_t errors() const {
    return numbers_per_error() == 0 ? 0 : updated_in_step() / numbers_per_error();
  }
  /// Size of step()'s gradients; without an update the errors follow all parameters' gradients.
  std::size_t gradients_size(bool with_update) const {
    return with_update ? size() - updated_in_step() : size() + errors();
  }
  AdamState zero_moments() const;

  // ---- Training
  virtual bool uses_lidar() const { return false; }
  virtual bool uses_error_map() const { return false; }
  /// Whether a step needs one image at a time, so that TrainingSet::images may be a cache;
  /// TrainingSet::pixels then has no pixels to gather.
  virtual bool streams_images() const { return false; }
  /// Whether steps keep a halved copy of each image, if all are in memory.
  virtual bool keeps_half_images(const Scene&) const { return false; }
  /// Throws InputError naming `recording`, or for found objects (ids below 0) `found`, unless these
  /// are the objects that training drew, with as many boxes. Does nothing before the first step.
  virtual void check_actors(const std::filesystem::path& /*recording*/,
                            const std::filesystem::path& /*found*/,
                            const std::vector<MovingObject>&) const {}
  /// Sets MovingObject::corrections to what training corrected so far.
  virtual void correct_actors(std::vector<MovingObject>*) const {}
  virtual std::string describe_batch() const = 0;  ///< the largest batch: "2048 rays"
  virtual std::int64_t steps_per_epoch(const TrainingSet& data, int world_size) const = 0;
  /// Derives from the data alone what steps on them need, into `buffers`. Called before the first
  /// step of each call of train(), with the poses that training began with; steps elsewhere do
  /// without. No checkpoint holds it.
  virtual void prepare(const TrainingSet&, ThreadPool&, StepBuffers* /*buffers*/) const {}
  /// Trains on what comes before images. Called before step 0 of every start, by each rank with the
  /// same parameters and fresh moments, which it changes alike. Calls `go_on` every so often and
  /// returns false, with parameters of no use, where that does. Must be deterministic.
  virtual bool train_first(kernels::Backend&, const TrainingSet&, std::uint64_t /*seed*/,
                           AdamState*, const std::function<bool()>& /*go_on*/) {
    return true;
  }
  /// Writes losses to buffers->workspace.sums() and adds their derivatives to gradients
  /// [gradients_size()]; with an update, a loss that is not finite changes nothing. The gradient
  /// of an actor's track is known only when the update is done: where it is not finite, it is
  /// left out and counted, and the rest of the step stands. Must be deterministic in the request.
  virtual StepOutput step(kernels::Backend& backend, const TrainingSet& data,
                          const StepRequest& request, std::span<float> gradients,
                          StepBuffers* buffers) const = 0;
  /// Number of independent samples of the mean squared error in `pixels` pixels of a step.
  virtual std::int64_t independent_pixels(std::int64_t pixels) const { return pixels; }
  /// Returns the loss terms, always the same names in the same order.
  virtual std::vector<LossTerm> loss_terms(const StepSums& sums) const = 0;
  /// Returns a part of step()'s gradients to check for overflow: it is not finite whenever the loss
  /// is finite and any gradient is not.
  virtual std::span<const float> sentinels(std::span<const float> gradients) const {
    return gradients;
  }
  virtual double learning_rate(const Schedule& at) const = 0;
  virtual std::string describe_schedule(std::int64_t total_steps) const = 0;
  /// Returns groups that tile `parameters`, for update(). step: from 1.
  virtual std::vector<AdamGroup> adam_groups(double /*learning_rate*/,
                                             std::int64_t /*step*/) const {
    return {};
  }
  /// Applies step()'s gradients and sets them to 0. The default is Adam on every group.
  virtual void update(kernels::Backend& backend, double learning_rate, std::int64_t step,
                      std::span<float> gradients, AdamState* adam);
  /// Called after each applied step with the outputs of all ranks. May change the shapes of
  /// tensors, with `parameters` and the moments (densify, prune). Must be deterministic. step: from
  /// 1. `buffers` belong to this rank's step.
  virtual void finish_step(kernels::Backend&, const StepRequest&, const StepOutput&,
                           std::int64_t /*step*/, const StepBuffers& /*buffers*/, AdamState*) {}
  /// Brings what steps have changed on a device to `parameters` and AdamState: to be called before
  /// anything but steps reads, writes or frees them.
  virtual void fetch(kernels::Backend&) const {}
  /// Returns the number of steps between two states that count in the mean with which training
  /// ends; 0: at this progress none does. While it is above 0, steps keep every tensor's shape.
  virtual int average_every(double /*progress*/) const { return 0; }
  /// Replaces the parameters, other than by a step. `by` has their size.
  virtual void replace_parameters(Buffer<float> by) { parameters = std::move(by); }
  /// Called when a run has reached its limits, before its last checkpoint; once, until further
  /// steps follow. May change the shapes of tensors, as finish_step. Must be deterministic.
  virtual void finish_training(kernels::Backend&, const TrainingSet&, AdamState*) {}

  // ---- Memory
  virtual std::uint64_t step_bytes() const = 0;  ///< estimate for a step, without gradients
  /// Estimate of the memory of the backend's device, at the largest size(); 0: it has none.
  virtual std::uint64_t device_bytes(kernels::Backend&) const { return 0; }
  /// Estimate for steps, besides LidarReturns, with this many returns.
  virtual std::uint64_t lidar_bytes(const Scene&, std::uint64_t /*returns*/) const { return 0; }

  Buffer<float> parameters;
};

}  // namespace redrive
