// SPDX-License-Identifier: Apache-2.0
// Trainer, run folder, checkpoint, eval and rendering support a method that does not march along
// rays: a step takes a whole image, and the number of parameters grows during training. The method,
// registered in this test only, paints vertical strips of one colour each on every image.
#include <algorithm>
#include <cmath>
#include <limits>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/rng.h"
#include "redrive/train/loss_watch.h"
#include "redrive/train/memory.h"
#include "redrive/train/train_testing.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

struct StripModel final : Trainee {
  int first_strips = 2, steps_per_split = 20;
  double initial_rate = 0.05;
  int strips = 0;  ///< state: doubles every steps_per_split steps, to 16
  // Faults to inject: Ctrl-C, or a kill in the middle of a step.
  static inline std::int64_t stop_at = -1, kill_at = -1;
  // Steps from `harder_from` on are a stage with this much more error.
  static inline std::int64_t harder_from = std::numeric_limits<std::int64_t>::max();
  static inline double harder_by = 0;
  // Steps from `spoiled_from` on have an error of 1, until the run is rolled back.
  static inline std::int64_t spoiled_from = std::numeric_limits<std::int64_t>::max();
  static inline std::atomic<bool> stop{false};

  const char* method() const override { return "strips"; }
  std::string describe() const override { return std::to_string(strips) + " strips"; }
  void visit_hyperparameters(HyperparameterVisitor& visit) override {
    visit(Hyperparameter{"first_strips", "strips at the start", 1, 16}.as_option("strips"),
          first_strips);
    visit({"steps_per_split", "steps after which each strip is split", 1, 1000}, steps_per_split);
    visit(Hyperparameter{"learning_rate", "of Adam", 0, 1}.exclusive().as_option("learning-rate"),
          initial_rate);
  }
  void visit_state(HyperparameterVisitor& visit) override {
    visit({"strips", "strips now", 0, 16}, strips);
  }
  void configure(const Scene&) override {}

  std::size_t size() const override { return 3 * static_cast<std::size_t>(strips); }
  std::size_t max_size() const override { return 3 * 16; }
  std::vector<ModelTensor> tensors() const override { return {{"colours", {3, strips}, 0}}; }
  void initialize(std::uint64_t) override {
    strips = 0;
    parameters = Buffer<float>(0);
  }
  /// Initialises each channel with its mean over the first image.
  void initialize_from(const TrainingSet& data, std::uint64_t, ThreadPool&) override {
    strips = first_strips;
    parameters = Buffer<float>(size());
    const ImagePointer first = data.images[training_views(data).front()];
    const Image8& image = *first;
    for (int k = 0; k < 3; ++k) {
      double sum = 0;
      for (std::size_t i = k; i < image.rgb.size(); i += 3) sum += image.rgb[i];
      std::fill_n(&parameters[k * strips], strips,
                  static_cast<float>(3 * sum / (255.0 * static_cast<double>(image.rgb.size()))));
    }
  }

  std::string describe_batch() const override { return "1 image"; }
  std::int64_t steps_per_epoch(const TrainingSet& data, int world_size) const override {
    const auto images = static_cast<std::int64_t>(training_views(data).size());
    return (images + world_size - 1) / world_size;
  }
  StepOutput step(kernels::Backend&, const TrainingSet& data, const StepRequest& request,
                  std::span<float> gradients, StepBuffers* buffers) const override {
    if (request.step == stop_at) stop = true;
    if (request.step == kill_at) throw Killed();
    const std::vector<std::size_t> views = training_views(data);
    const std::uint64_t drawn = request.world_size * request.step + request.rank;
    const std::uint64_t key = random_key(request.seed, kStreamTest, drawn / views.size());
    const std::size_t view = views[permute_index(key, drawn % views.size(), views.size())];
    const ImagePointer drawn_image = data.images[view];
    const Image8& image = *drawn_image;
    const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
    double loss = 0;
    for (std::size_t pixel = 0; pixel < pixels; ++pixel)
      for (int k = 0; k < 3; ++k) {
        const std::size_t slot = slot_of(k, static_cast<int>(pixel % image.width), image.width);
        const float off = parameters[slot] - image.rgb[3 * pixel + k] / 255.0f;
        loss += off * off / (3.0 * static_cast<double>(pixels));
        gradients[slot] += 2 * off / (3.0f * static_cast<float>(pixels));
      }
    if (request.step >= harder_from) loss += harder_by;
    if (request.step >= spoiled_from) loss = 1;
    buffers->workspace.begin();
    StepSums& sums = buffers->workspace.sums();
    sums.opacity = 1;
    sums.rgb_mse = loss;
    sums.terms[0] = 0.5 * loss;
    sums.terms[1] = 0.5 * loss;
    StepOutput output;
    output.pixels = output.epoch_pixels = static_cast<int>(pixels);
    output.stage = request.step >= harder_from ? 1 : 0;
    if (request.pose_gradients) output.views.resize(data.scene.views.size());
    return output;
  }
  std::vector<LossTerm> loss_terms(const StepSums& sums) const override {
    return {{"one_half", sums.terms[0]}, {"other_half", sums.terms[1]}};
  }
  double learning_rate(const Schedule& at) const override {
    return initial_rate * (1 - 0.9 * std::min(at.progress, 1.0));
  }
  std::string describe_schedule(std::int64_t) const override { return "a falling learning rate"; }
  /// Red has half the learning rate of the other channels.
  std::vector<AdamGroup> adam_groups(double rate, std::int64_t step) const override {
    const auto n = static_cast<std::size_t>(strips);
    return {{0, n, adam_step(rate / 2, step)}, {n, 2 * n, adam_step(rate, step)}};
  }
  void finish_step(kernels::Backend&, const StepRequest&, const StepOutput&, std::int64_t step,
                   const StepBuffers&, AdamState* adam) override {
    if (step % steps_per_split != 0 || strips >= 16) return;
    for (Buffer<float>* numbers : {&parameters, &adam->first_moment, &adam->second_moment}) {
      Buffer<float> split(2 * numbers->size());
      for (std::size_t i = 0; i < split.size(); ++i) split[i] = (*numbers)[i / 2];
      *numbers = std::move(split);
    }
    strips *= 2;
  }

  void render_to(kernels::Backend&, const RayTable& rays, const ShutterPoses&, const Exposure&,
                 RenderedImage* image) const override {
    image->resize(rays.width, rays.height);
    std::ranges::fill(image->depth, 1.0f);
    std::ranges::fill(image->opacity, 1.0f);
    std::ranges::fill(image->valid, std::uint8_t{1});
    for (std::size_t i = 0; i < image->rgb.size(); ++i)
      image->rgb[i] = parameters[slot_of(static_cast<int>(i % 3),
                                         static_cast<int>(i / 3 % rays.width), rays.width)];
  }
  RenderedRays trace(kernels::Backend&, const kernels::Rays& rays,
                     const std::vector<MovingObject>& = {}) const override {
    const std::size_t n = rays.n;
    return {std::vector<float>(n, 1), std::vector<float>(n, 1)};
  }
  std::uint64_t step_bytes() const override { return 1000; }

 private:
  std::size_t slot_of(int channel, int x, int width) const {
    return static_cast<std::size_t>(channel) * strips + std::size_t(x) * strips / width;
  }
  static std::vector<std::size_t> training_views(const TrainingSet& data) {
    std::vector<std::size_t> views;
    for (std::size_t v = 0; v < data.scene.views.size(); ++v)
      if (!data.scene.views[v].held_out) views.push_back(v);
    return views;
  }
};

TrainField field_named(const std::string& name) {
  for (const TrainField& field : train_fields())
    if (field.name == name) return field;
  throw std::logic_error("no option " + name);
}

class ImageMethodTest : public TrainingTest {
 protected:
  static void SetUpTestSuite() {
    register_method({.name = "strips", .help = "for tests", .make = [] {
                       return std::unique_ptr<Trainee>(std::make_unique<StripModel>());
                     }});
  }
  redrive::Run strip_run(const std::string& name, std::int64_t max_steps) {
    TrainOptions options;
    options.recording = "in memory";
    options.method = "strips";
    options.cameras = {"FRONT"};
    options.max_steps = max_steps;
    options.max_seconds = 0;
    options.checkpoint_every = 15;
    options.set("steps_per_split", 12);
    return tiny_run(folder_.path / name, folder_.path, options);
  }
  static const StripModel& strips(const redrive::Run& run) {
    return dynamic_cast<const StripModel&>(*run.state.model);
  }
};

TEST_F(ImageMethodTest, TrainsWhileItsParametersGrow) {
  redrive::Run run = strip_run("run", 60);
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  EXPECT_EQ(strips(run).strips, 16);
  EXPECT_EQ(run.state.adam.first_moment.size(), 48u);
  EXPECT_EQ(run.state.pixels_drawn, 60u * 24 * 16);
  const std::vector<MetricsRow> rows = read_metrics(run.paths);
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_LT(rows.back().loss, rows.front().loss);
  EXPECT_THAT(rows.back().losses, testing::SizeIs(2));
  EXPECT_EQ(rows.back().losses.front().first, "one_half");
  EXPECT_NEAR(rows.back().losses.front().second, rows.back().loss / 2, 1e-9);
  EXPECT_TRUE(same_weights(load_checkpoint(run.paths.checkpoint()), run.state));
}

TEST_F(ImageMethodTest, KilledInterruptedAndResumedEndsBitEqual) {
  redrive::Run whole = strip_run("whole", 60), parts = strip_run("parts", 60);
  EXPECT_TRUE(parts.state.model->parameters.span().empty()) << "initial parameters need the data";
  train(&whole, *backend_, never_);
  for (const std::int64_t at : {7, 11, 30}) {  // before the first split, at one, between two
    StripModel::stop = false;
    StripModel::stop_at = at;
    EXPECT_EQ(train(&parts, *backend_, StripModel::stop), TrainEnd::kInterrupted);
    StripModel::stop_at = -1;
    parts = reopened(parts);
    EXPECT_EQ(parts.state.step, at + 1);
  }
  StripModel::kill_at = 50;  // the last checkpoint is of step 45
  EXPECT_THROW(train(&parts, *backend_, never_), Killed);
  StripModel::kill_at = -1;
  parts = reopened(parts);
  EXPECT_EQ(parts.state.step, 45);
  train(&parts, *backend_, never_);
  EXPECT_TRUE(same_weights(parts.state, whole.state));
  EXPECT_EQ(curve(parts), curve(whole));
}

/// Restores what StripModel's steps do.
struct HarderStage {
  HarderStage(std::int64_t from, double by) {
    StripModel::harder_from = from;
    StripModel::harder_by = by;
  }
  ~HarderStage() {
    StripModel::harder_from = StripModel::spoiled_from = std::numeric_limits<std::int64_t>::max();
  }
};

// The schedule goes to images that have ten times the error: nothing diverges.
TEST_F(ImageMethodTest, AHarderStageIsNoDivergence) {
  const HarderStage stage(610, 0.5);  // behind the steps that start_watch.h watches
  redrive::Run run = strip_run("run", 1100);
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  EXPECT_EQ(run.state.rollbacks, 0);
  EXPECT_EQ(run.state.rate_factor, 1);
  std::vector<std::int64_t> around;
  for (const MetricsRow& row : read_metrics(run.paths)) {
    if (row.step > 580 && row.step < 640) around.push_back(row.step);
    EXPECT_EQ(row.loss > 0.4, row.step > 610) << "step " << row.step;
  }
  EXPECT_THAT(around, testing::ElementsAre(600, 610, 625)) << "no row has steps of both stages";
  EXPECT_GT(run.state.loss_watch.best, 0.4);
}

// A loss that rose before the change is not the reference of what follows.
TEST_F(ImageMethodTest, ADivergenceBeforeAHarderStageIsUndone) {
  const HarderStage stage(410, 0.01);
  StripModel::spoiled_from = 380;
  redrive::Run run = strip_run("run", 500);
  EXPECT_THROW(train(&run, *backend_, never_), UsageError) << "it is spoiled at every rate";
  const TrainState left = load_checkpoint(run.paths.checkpoint());
  EXPECT_EQ(left.rollbacks, kMaxRollbacks);
  EXPECT_LE(left.step, 380);
}

TEST_F(ImageMethodTest, AHarderStageIsTheSameForAResumedRun) {
  const HarderStage stage(41, 0.5);
  redrive::Run whole = strip_run("whole", 60), parts = strip_run("parts", 60);
  train(&whole, *backend_, never_);
  StripModel::stop = false;
  StripModel::stop_at = 42;
  EXPECT_EQ(train(&parts, *backend_, StripModel::stop), TrainEnd::kInterrupted);
  StripModel::stop_at = -1;
  parts = reopened(parts);
  train(&parts, *backend_, never_);
  EXPECT_TRUE(same_weights(parts.state, whole.state));
  EXPECT_EQ(parts.state.loss_watch, whole.state.loss_watch);
  EXPECT_EQ(curve(parts), curve(whole));
}

TEST_F(ImageMethodTest, SupportsPoseRefinementRestartsAndTheRunFolder) {
  TrainOptions options;
  options.recording = REDRIVE_SAMPLES "/analytic";
  options.method = "strips";
  options.refine_poses = "on";
  options.downscale = 8;
  options.max_steps = 30;
  field_named("strips").parse(options, "4");
  field_named("set").parse(options, "steps_per_split=10");
  validate(options);
  redrive::Run run;
  run.options = options;
  run.recording = open_recording(options);
  run.scene = make_scene(run.recording, scene_options(options));
  run.state = make_initial_state(options, run.scene);
  record_hyperparameters(*run.state.model, &run.options);
  run.paths = create_run(folder_.path / "run", run.options, {}, run.state.model.get());
  EXPECT_GT(estimate_memory(run, 2).total(), 0u);
  ThreadPool pool(2);
  train(&run, prepare_training_data(&run, pool), *backend_, never_);

  const nlohmann::json config = read_json(run.paths.config());
  EXPECT_EQ(config.at("strips"), 4);
  EXPECT_EQ(config.at("set"), nlohmann::json({{"steps_per_split", 10}}));
  EXPECT_EQ(config.at("hyperparameters").at("learning_rate"), 0.05);
  EXPECT_FALSE(config.contains("samples")) << "an option of other methods";
  const redrive::Run opened = open_run(run.paths.root);
  EXPECT_TRUE(same_weights(opened.state, run.state));
  EXPECT_EQ(strips(opened).strips, 16);
  const RenderedImage image =
      opened.state.model->render(*backend_, make_ray_table(opened.scene.rig[0].camera),
                                 opened.scene.shutter_poses(opened.scene.views[0]), {});
  EXPECT_EQ(image.rgb.size(), 3u * image.width * image.height);
}

TEST_F(ImageMethodTest, RejectsHyperparametersOfRayMarchers) {
  TrainOptions options;
  options.recording = "drive";
  options.method = "strips";
  options.set("samples", 8);
  try {
    validate(options);
    ADD_FAILURE() << "not rejected";
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), HasSubstr("--samples 8: belongs to --method"));
  }
}

}  // namespace
}  // namespace redrive
