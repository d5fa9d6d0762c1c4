// SPDX-License-Identifier: Apache-2.0
// Fixtures for tests of training: a run on a tiny drive, and a backend that interrupts, kills or
// corrupts a chosen step.
#pragma once

#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <sstream>
#include <stdexcept>

#include <gtest/gtest.h>

#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/methods/grid/grid_model.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/scene/scene_testing.h"
#include "redrive/train/run.h"
#include "redrive/train/step.h"
#include "redrive/train/trainer.h"

namespace redrive {

/// Faults to inject into the n-th step (from 0) of a backend.
struct Interference {
  std::int64_t stop_after = -1;             ///< sets `stop`, as Ctrl-C would
  std::int64_t kill_at = -1;                ///< throws Killed in the middle of it, like kill -9
  std::int64_t nan_from = -1, nan_to = -1;  ///< [from, to): the loss is not a number
  std::int64_t spoil_at = -1;               ///< saturates the parameters, so that gradients vanish
  std::atomic<bool> stop{false};
};

struct Killed : std::runtime_error {
  Killed() : std::runtime_error("killed") {}
};

/// Forwards all calls to `inner`. A step begins with sample_stratified, for --method grid with the
/// losses of its rays.
class InterferingBackend : public kernels::Backend, public kernels::NerfStages {
 public:
  InterferingBackend(kernels::Backend& inner, Interference* what)
      : Backend(inner.threads()),
        NerfStages(static_cast<kernels::Backend&>(*this)),
        inner_(inner),
        what_(*what) {}

  std::string name() const override { return inner_.name(); }
  std::optional<Isa> isa() const override { return inner_.isa(); }
  kernels::ImageScore score(const kernels::ImagePair& images) override {
    return inner_.score(images);
  }
  void sample_stratified(int n_rays, const kernels::StratifiedSampling& how, std::span<float> t,
                         std::span<float> dt) override {
    ++step_;
    if (step_ == what_.stop_after) what_.stop = true;
    inner_.nerf().sample_stratified(n_rays, how, t, dt);
  }
  void sample_hierarchical(const kernels::Samples& coarse, std::span<const float> weights,
                           int extra, bool jitter, std::uint64_t key, std::span<float> t,
                           std::span<float> dt) override {
    inner_.nerf().sample_hierarchical(coarse, weights, extra, jitter, key, t, dt);
  }
  void network_forward(const kernels::NerfField& f, const kernels::Rays& r,
                       const kernels::Samples& s, std::span<float> raw) override {
    inner_.nerf().network_forward(f, r, s, raw);
  }
  void network_backward(const kernels::NerfField& f, const kernels::Rays& r,
                        const kernels::Samples& s, std::span<const float> d_raw,
                        std::span<float> gradients, const kernels::RayGradients& of_rays) override {
    inner_.nerf().network_backward(f, r, s, d_raw, gradients, of_rays);
  }
  void composite_forward(int n, const kernels::Samples& s, std::span<const float> raw,
                         std::span<const float> background,
                         const kernels::CompositeOut& out) override {
    inner_.composite_forward(n, s, raw, background, out);
  }
  void composite_backward(int n, const kernels::Samples& s, std::span<const float> raw,
                          std::span<const float> background,
                          const kernels::CompositeOutGradient& d_out,
                          std::span<float> d_raw) override {
    inner_.composite_backward(n, s, raw, background, d_out, d_raw);
  }
  kernels::NerfStages& nerf() override { return *this; }
  kernels::GridStages& grid() override { return inner_.grid(); }
  kernels::GaussianStages& gaussians() override { return inner_.gaussians(); }
  void photometric_loss(std::span<const float> rgb, std::span<const float> target,
                        std::span<float> d_rgb, double* loss) override {
    ++step_;
    if (step_ == what_.stop_after) what_.stop = true;
    if (step_ == what_.kill_at) throw Killed();
    inner_.photometric_loss(rgb, target, d_rgb, loss);
    if (step_ >= what_.nan_from && step_ < what_.nan_to)
      d_rgb[0] = std::numeric_limits<float>::quiet_NaN();
  }
  void train_rays(const kernels::NerfField& f, const kernels::Rays& r, const kernels::Samples& s,
                  std::span<const float> target, const kernels::CompositeOut& out,
                  std::span<float> gradients, const kernels::RayGradients& of_rays,
                  double* loss) override {
    if (step_ == what_.kill_at) throw Killed();
    inner_.nerf().train_rays(f, r, s, target, out, gradients, of_rays, loss);
    if (step_ >= what_.nan_from && step_ < what_.nan_to)
      *loss = std::numeric_limits<double>::quiet_NaN();
  }
  void adam(const AdamStep& step, std::span<float> gradients, std::span<float> parameters,
            std::span<float> first, std::span<float> second) override {
    inner_.adam(step, gradients, parameters, first, second);
    if (step_ == what_.spoil_at)
      std::ranges::fill(parameters, 1.0f);  // white and opaque: colours and opacity are saturated
  }

 private:
  kernels::Backend& inner_;
  Interference& what_;
  std::int64_t step_ = -1;
};

/// Options of a run that takes milliseconds: width 32, 64 rays of 12 samples.
inline TrainOptions tiny_options(std::int64_t max_steps) {
  TrainOptions options;
  options.recording = "in memory";
  options.method = "nerf";
  apply_preset(&options, {});
  options.cameras = {"FRONT"};
  options.set("width", 32);
  options.set("samples", 12);
  options.set("batch_rays", 64);
  options.epochs = 10000;
  options.max_steps = max_steps;
  options.checkpoint_every = 40;
  options.far_m = 6;
  options.set("learning_rate", 2e-3);
  return options;
}

/// Returns a fresh run in `root` on the first two frames of a drive with its images in `images`.
inline Run tiny_run(const std::filesystem::path& root, const std::filesystem::path& images,
                    const TrainOptions& options) {
  Run run;
  run.options = options;
  run.recording = make_test_recording(images, 2);
  run.scene = make_scene(run.recording, scene_options(options));
  run.state = make_initial_state(options, run.scene);
  run.paths = create_run(root, options);
  return run;
}

/// Computes a step on a batch of rays.
struct BatchResult : StepResult {
  std::vector<float> d_origin, d_direction;
  double loss_of(std::string_view term) const {
    for (const LossTerm& one : loss_terms)
      if (one.name == term) return one.value;
    return 0;
  }
};
inline BatchResult train_step(kernels::Backend& backend, const RayBatch& batch,
                              double learning_rate, TrainState* state, StepBuffers* buffers,
                              const RayBatch* lidar = nullptr) {
  const auto& model = dynamic_cast<const RayModel&>(*state->model);
  BatchResult result;
  static_cast<StepResult&>(result) =
      step_gradients(*state, model.size(), buffers, [&](std::span<float> gradients) {
        const RayGradientsOutput rays = model.gradients(backend, batch, state->seed, state->step,
                                                        gradients, &buffers->workspace);
        if (lidar && lidar->n > 0)
          model.range_gradients(backend, *lidar, state->seed, state->step, gradients,
                                &buffers->workspace);
        result.d_origin = rays.d_origin;
        result.d_direction = rays.d_direction;
        StepOutput output;
        output.pixels = batch.n;
        output.epoch_pixels = batch.n - batch.error_map_rays;
        output.active_rays = rays.active_rays;
        output.cells = batch.cell;
        output.squared_errors = rays.squared_errors;
        return output;
      });
  apply_step(backend, {}, result, learning_rate, state, buffers);
  return result;
}

/// Resumes a run as the command does, but with the recording in memory: same options and scene, the
/// state from the checkpoint.
inline Run reopened(const Run& run) {
  Run again;
  again.paths = run.paths;
  again.options = run.options;
  again.recording = run.recording;
  again.scene = run.scene;
  again.state = load_checkpoint(run.paths.checkpoint());
  return again;
}

/// Returns a fresh run of --method grid with importance sampling by the error map on the same
/// drive, with small tables.
inline Run tiny_grid_run(const std::filesystem::path& root, const std::filesystem::path& images,
                         TrainOptions options) {
  options.method = "grid";
  options.set("error_rays", 0.5);
  options.set("lr_gamma", 0.5);
  Run run = tiny_run(root, images, options);
  auto& model = dynamic_cast<GridModel&>(*run.state.model);
  model.field = {{4, 4, 4, 64, 8}, 16, 1};
  model.proposal.log2_hashmap_size = 8;
  model.sky.log2_hashmap_size = 6;
  model.proposal_samples = {12, 8};
  model.samples = 6;
  run.state = initial_state(std::move(run.state.model), options.seed);
  run.state.poses = PoseState(run.scene);
  return run;
}

/// Returns the state's model, which must be of --method nerf.
inline NerfModel& nerf(TrainState& state) { return dynamic_cast<NerfModel&>(*state.model); }
inline const NerfModel& nerf(const TrainState& state) {
  return dynamic_cast<const NerfModel&>(*state.model);
}

inline const RayModel& ray_model(const TrainState& state) {
  return dynamic_cast<const RayModel&>(*state.model);
}

inline bool bit_equal(std::span<const float> a, std::span<const float> b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0;
}

inline bool same_weights(const TrainState& a, const TrainState& b) {
  return bit_equal(a.model->parameters, b.model->parameters) &&
         bit_equal(a.adam.first_moment, b.adam.first_moment) &&
         bit_equal(a.adam.second_moment, b.adam.second_moment) &&
         std::ranges::equal(a.adam.packed.span(), b.adam.packed.span()) &&
         bit_equal(a.adam.errors, b.adam.errors) && bit_equal(a.cell_errors, b.cell_errors);
}

/// Returns the fastest backend of this machine, which is deterministic bit by bit.
inline std::unique_ptr<kernels::Backend> processor_backend(int threads) {
  return best_isa() ? kernels::make_cpu_backend(*best_isa(), threads) : kernels::make_ref_backend();
}

/// Fixture with a temporary folder for runs.
class TrainingTest : public ::testing::Test {
 protected:
  redrive::Run run_named(const std::string& name, const TrainOptions& options) {
    return tiny_run(folder_.path / name, folder_.path, options);
  }
  void train_until_killed(redrive::Run* run, std::int64_t at) {
    Interference interference{.kill_at = at};
    InterferingBackend backend(*backend_, &interference);
    EXPECT_THROW(train(run, backend, never_), Killed);
  }
  /// Returns loss, PSNR and learning rate of every row, which must be equal, unlike times.
  static std::string curve(const redrive::Run& run) {
    std::ostringstream text;
    text.precision(17);
    for (const MetricsRow& row : read_metrics(run.paths))
      text << row.step << " " << row.epoch << " " << row.loss << " " << row.psnr_db << " "
           << row.learning_rate << "\n";
    return text.str();
  }

  TemporaryFolder folder_;
  std::unique_ptr<kernels::Backend> backend_ = processor_backend(2);
  const std::atomic<bool> never_{false};
};

}  // namespace redrive
