// SPDX-License-Identifier: Apache-2.0
// The trainer with method splat, whose parameters grow while it trains.
#include <optional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/train/memory.h"
#include "redrive/train/train_testing.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

/// InterferingBackend with steps of Gaussians, which begin with rasterise().
class InterferingRasteriser final : public InterferingBackend, public kernels::GaussianStages {
 public:
  InterferingRasteriser(kernels::Backend& inner, Interference* what)
      : InterferingBackend(inner, what), inner_(inner.gaussians()), what_(*what) {}

  kernels::GaussianStages& gaussians() override { return *this; }
  kernels::Raster rasterise(const kernels::GaussianCamera& camera,
                            const kernels::Gaussians& gaussians,
                            const kernels::RasterOptions& options) override {
    if (++step_ == what_.stop_after) what_.stop = true;
    if (step_ == what_.kill_at) throw Killed();
    return inner_.rasterise(camera, gaussians, options);
  }
  kernels::ImageLossOutput image_loss(const kernels::ImageLossInput& input, std::span<float> d_rgb,
                                      std::span<float> error) override {
    return inner_.image_loss(input, d_rgb, error);
  }
  void update_gaussians(const kernels::GaussianUpdate& update, std::size_t n,
                        std::span<const float> gradients, std::span<const float> errors) override {
    inner_.update_gaussians(update, n, gradients, errors);
  }
  void project_points(const kernels::GaussianCamera& camera, std::span<const float> points,
                      std::span<float> pixels) override {
    inner_.project_points(camera, points, pixels);
  }
  void fetch() override { inner_.fetch(); }
  void release() override { inner_.release(); }

 private:
  kernels::GaussianStages& inner_;
  Interference& what_;
  std::int64_t step_ = -1;
};

class SplatTrainingTest : public TrainingTest {
 protected:
  /// A run on images of the sky alone: there is no LiDAR.
  redrive::Run splat_run(const std::string& name, std::int64_t max_steps) {
    TrainOptions options;
    options.recording = "in memory";
    options.method = "splat";
    options.max_steps = max_steps;
    options.max_seconds = 0;
    options.checkpoint_every = 15;
    options.refine_poses = "on";
    options.set("initial.sky", 800);
    options.set("max_gaussians", 1700);
    options.set("densify_every", 8);
    return tiny_run(folder_.path / name, folder_.path, options);
  }
  static const SplatModel& splat(const redrive::Run& run) {
    return dynamic_cast<const SplatModel&>(*run.state.model);
  }
};

TEST_F(SplatTrainingTest, TrainsWhileItsGaussiansBecomeMore) {
  redrive::Run run = splat_run("run", 120);
  EXPECT_EQ(train(&run, *backend_, never_), TrainEnd::kFinished);
  const SplatModel& model = splat(run);
  EXPECT_GT(model.first_gaussians, 50);
  EXPECT_GT(model.gaussians, model.first_gaussians + 50);
  EXPECT_EQ(model.parameters.size(), model.size());
  const std::vector<MetricsRow> rows = read_metrics(run.paths);
  EXPECT_LT(rows.back().loss, 0.7 * rows.front().loss);
  EXPECT_THAT(rows.back().losses,
              testing::UnorderedElementsAre(testing::Key("l1"), testing::Key("dssim"),
                                            testing::Key("opacity"), testing::Key("lidar"),
                                            testing::Key("scans")));
  EXPECT_TRUE(same_weights(load_checkpoint(run.paths.checkpoint()), run.state));
}

TEST_F(SplatTrainingTest, KilledInterruptedAndResumedEndsBitEqual) {
  redrive::Run whole = splat_run("whole", 60), parts = splat_run("parts", 60);
  train(&whole, *backend_, never_);
  // Steps of each part: before the first change of their number, right after one, then later.
  for (const std::int64_t stop_after : {5, 9, 7}) {
    Interference interference{.stop_after = stop_after};
    InterferingRasteriser backend(*backend_, &interference);
    EXPECT_EQ(train(&parts, backend, interference.stop), TrainEnd::kInterrupted);
    parts = reopened(parts);
  }
  EXPECT_EQ(parts.state.step, 6 + 10 + 8);
  Interference interference{.kill_at = 13};  // step 37; the last checkpoint is of step 30
  InterferingRasteriser backend(*backend_, &interference);
  EXPECT_THROW(train(&parts, backend, never_), Killed);
  parts = reopened(parts);
  EXPECT_EQ(parts.state.step, 30);
  Interference late{.stop_after = 26};  // step 57; 55 counts in the mean
  InterferingRasteriser backend_of_late(*backend_, &late);
  EXPECT_EQ(train(&parts, backend_of_late, late.stop), TrainEnd::kInterrupted);
  parts = reopened(parts);
  EXPECT_EQ(parts.state.mean.steps, 1);
  train(&parts, *backend_, never_);
  EXPECT_GT(splat(whole).gaussians, splat(whole).first_gaussians);
  EXPECT_TRUE(same_weights(parts.state, whole.state));
  EXPECT_EQ(parts.state.poses.corrections.values, whole.state.poses.corrections.values);
  EXPECT_EQ(curve(parts), curve(whole));
}

TEST_F(SplatTrainingTest, EndsWithTheMeanOfLateSteps) {
  struct Observer final : StepObserver {
    std::vector<std::vector<float>> late;
    void between_steps(redrive::Run& run) override {
      const std::span<const float> now = run.state.model->parameters;
      if (run.state.step == 55 || run.state.step == 60) late.emplace_back(now.begin(), now.end());
    }
  } observer;
  redrive::Run run = splat_run("run", 60);  // steps count from progress 0.85 on
  train(&run, *backend_, never_, &observer);
  ASSERT_EQ(observer.late.size(), 2u);
  ASSERT_EQ(observer.late[0].size(), run.state.model->parameters.size());
  double moved = 0;
  for (std::size_t i = 0; i < observer.late[0].size(); ++i) {
    const float a = observer.late[0][i], b = observer.late[1][i];
    EXPECT_FLOAT_EQ(run.state.model->parameters[i], a + (b - a) / 2) << i;
    moved += std::fabs(b - a);
  }
  EXPECT_GT(moved, 0);
  const TrainState saved = load_checkpoint(run.paths.checkpoint());
  EXPECT_TRUE(same_weights(saved, run.state));
  EXPECT_EQ(saved.mean.steps, 0);

  redrive::Run last = splat_run("last", 60);
  dynamic_cast<SplatModel&>(*last.state.model).averaged_every = 0;
  train(&last, *backend_, never_);
  EXPECT_TRUE(std::ranges::equal(last.state.model->parameters.span(), observer.late[1]));
}

TEST_F(SplatTrainingTest, ARunWithALaterEndForgetsTheMean) {
  redrive::Run run = splat_run("run", 60);
  Interference late{.stop_after = 56};
  InterferingRasteriser backend(*backend_, &late);
  EXPECT_EQ(train(&run, backend, late.stop), TrainEnd::kInterrupted);
  run = reopened(run);
  EXPECT_EQ(run.state.mean.steps, 1);
  run.options.max_steps = 120;
  Interference soon{.stop_after = 5};
  InterferingRasteriser backend_of_soon(*backend_, &soon);
  EXPECT_EQ(train(&run, backend_of_soon, soon.stop), TrainEnd::kInterrupted);
  EXPECT_EQ(run.state.mean.steps, 0);
  EXPECT_EQ(run.state.mean.values.size(), 0u);
}

TEST_F(SplatTrainingTest, ThreadsChangeNoBit) {
  redrive::Run one = splat_run("one", 50), four = splat_run("four", 50);
  train(&one, *processor_backend(1), never_);
  train(&four, *processor_backend(4), never_);
  EXPECT_GT(splat(one).gaussians, splat(one).first_gaussians);
  EXPECT_TRUE(same_weights(one.state, four.state));
  EXPECT_EQ(one.state.poses.corrections.values, four.state.poses.corrections.values);
  EXPECT_EQ(curve(one), curve(four));
}

/// Trains on a sample with these bytes of images, or with all in memory.
struct Streamed {
  redrive::Run run;
  std::optional<TrainingData> data;
};

Streamed train_streamed(const std::filesystem::path& root, TrainOptions options,
                        std::optional<std::uint64_t> cache_bytes, kernels::Backend& backend) {
  const std::atomic<bool> never{false};
  options.method = "splat";
  options.max_seconds = 0;
  validate(options);
  Streamed out;
  redrive::Run& run = out.run;
  run.options = options;
  run.recording = open_recording(options);
  run.scene = make_scene(run.recording, scene_options(options));
  run.state = make_initial_state(options, run.scene);
  run.paths = create_run(root, run.options, {}, run.state.model.get());
  ThreadPool pool(backend.threads());
  out.data.emplace(prepare_training_data(&run, pool, cache_bytes));
  train(&run, *out.data, backend, never);
  return out;
}

class StreamedTraining : public TrainingTest, public ::testing::WithParamInterface<const char*> {};

// Masks of the vehicle and of moving objects, LiDAR, actors, halved images and windows.
TEST_P(StreamedTraining, EndsBitEqualWithAnySizeOfTheCache) {
  TrainOptions options;
  options.recording = std::string(REDRIVE_SAMPLES) + GetParam();
  options.downscale = 4;
  options.max_steps = 60;
  options.holdout_every = 7;
  options.refine_poses = "off";
  options.set("max_gaussians", 4000);
  options.set("densify_every", 25);
  options.set("window_pixels", 4096);  // images are cut, and halved at first
  const auto backend = processor_backend(2), other = processor_backend(3);
  const Streamed whole = train_streamed(folder_.path / "whole", options, {}, *backend);
  ASSERT_FALSE(whole.data->cache);
  const Streamed tiny = train_streamed(folder_.path / "tiny", options, 1, *other);
  ASSERT_TRUE(tiny.data->cache);
  EXPECT_TRUE(tiny.data->images.empty());
  const Streamed some = train_streamed(folder_.path / "some", options, 3 << 20, *backend);
  for (const Streamed* streamed : {&tiny, &some}) {
    EXPECT_EQ(streamed->data->pixels, whole.data->sampler(whole.run.scene, 1).pixels());
    for (std::size_t c = 0; c < whole.data->left_out.masks.size(); ++c)
      EXPECT_EQ(streamed->data->left_out.masks[c].used, whole.data->left_out.masks[c].used) << c;
    EXPECT_TRUE(same_weights(streamed->run.state, whole.run.state));
    EXPECT_EQ(curve(streamed->run), curve(whole.run));
  }
  EXPECT_LT(some.data->cache->statistics().decoded, tiny.data->cache->statistics().decoded);
  EXPECT_GT(tiny.data->cache->statistics().waited_s, 0);
}

INSTANTIATE_TEST_SUITE_P(Samples, StreamedTraining, testing::Values("/street", "/street_traffic"));

TEST_F(SplatTrainingTest, AnImageThatBreaksWhileItTrainsIsNamed) {
  redrive::Run run = splat_run("run", 60);
  run.recording = make_test_recording(folder_.path, 8);
  run.scene = make_scene(run.recording, scene_options(run.options));
  run.state = make_initial_state(run.options, run.scene);
  ThreadPool pool(2);
  const TrainingData data = prepare_training_data(&run, pool, 1);
  const std::filesystem::path broken = run.scene.views[3].image;
  folder_.write(broken.filename(), "no image");
  try {
    train(&run, data, *backend_, never_);
    ADD_FAILURE() << "no error";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr(broken.string()));
  }
}

TEST_F(SplatTrainingTest, ADriveThatDoesNotFitGetsASmallerCache) {
  redrive::Run run = splat_run("run", 1);
  run.recording = make_test_recording(folder_.path, 200);
  run.scene = make_scene(run.recording, scene_options(run.options));
  run.state = make_initial_state(run.options, run.scene);
  const MemoryEstimate need = estimate_memory(run, 2);
  ASSERT_GT(need.least_images, 0u);
  ASSERT_LT(need.least_images, need.images);
  EXPECT_FALSE(image_cache_bytes(need, need.total())) << "all fit";
  const std::uint64_t least = need.least(), some = (least + need.total()) / 2;
  check_memory(need, least, run.options);
  EXPECT_EQ(*image_cache_bytes(need, least), need.least_images - need.decoders);
  EXPECT_GT(*image_cache_bytes(need, some), need.least_images - need.decoders);
  EXPECT_LT(*image_cache_bytes(need, some), need.images);
  EXPECT_THROW(check_memory(need, least - 1, run.options), UsageError);

  run.options.memory = std::to_string(3 * some);
  const RunMemory alone = reserve_memory(run, *backend_);
  EXPECT_FALSE(alone.cache_bytes);
  EXPECT_EQ(alone.of_device, 0u);
  const RunMemory shared = reserve_memory(run, *backend_, false, 3);
  EXPECT_EQ(shared.allowed, some);
  EXPECT_TRUE(shared.cache_bytes) << "processes that share the machine have a part each";
  EXPECT_THROW(reserve_memory(run, *backend_, false, alone.allowed / least + 1), UsageError);
}

// The objects of samples/street_traffic come from the recording again; their Gaussians, bounds and
// corrections from the checkpoint.
TEST_F(SplatTrainingTest, AResumedRunHasItsMovingObjectsAgain) {
  const auto begin = [&](const char* name) {
    redrive::Run run;
    run.options.recording = REDRIVE_SAMPLES "/street_traffic";
    run.options.method = "splat";
    run.options.cameras = {"F_MIDLONGRANGECAM_CL"};
    run.options.downscale = 8;
    run.options.holdout_every = 6;
    run.options.max_steps = 30;
    run.options.max_seconds = 0;
    run.options.checkpoint_every = 10;
    run.options.set("max_gaussians", 4000);
    run.options.set("densify_every", 12);
    run.recording = open_recording(run.options);
    run.scene = make_scene(run.recording, scene_options(run.options));
    run.state = make_initial_state(run.options, run.scene);
    record_hyperparameters(*run.state.model, &run.options);
    ThreadPool pool(2);
    const TrainingData data = prepare_training_data(&run, pool);
    run.paths = create_run(
        folder_.path / name, run.options,
        [&](const RunPaths& paths) { write_run_masks(paths, data, run); }, run.state.model.get());
    return run;
  };
  redrive::Run whole = begin("whole"), parts = begin("parts");
  ASSERT_EQ(whole.scene.actors.size(), 2u) << "the parked one is of the world";
  EXPECT_EQ(train(&whole, *backend_, never_), TrainEnd::kFinished);
  for (const std::int64_t stop_after : {3, 10}) {  // before and after the number changes
    Interference interference{.stop_after = stop_after};
    InterferingRasteriser backend(*backend_, &interference);
    EXPECT_EQ(train(&parts, backend, interference.stop), TrainEnd::kInterrupted);
    parts = open_run(parts.paths.root, /*to_resume=*/true);
    ASSERT_EQ(parts.scene.actors.size(), 2u);
    for (std::size_t a = 0; a < 2; ++a) {
      EXPECT_EQ(parts.scene.actors[a].id, whole.scene.actors[a].id);
      EXPECT_TRUE(parts.scene.actors[a].corrections.empty()) << "the state has them";
    }
  }
  EXPECT_EQ(train(&parts, *backend_, never_), TrainEnd::kFinished);
  EXPECT_TRUE(same_weights(parts.state, whole.state));
  EXPECT_EQ(splat(parts).actor_ids, splat(whole).actor_ids);
  EXPECT_EQ(splat(parts).actor_ends, splat(whole).actor_ends);
  EXPECT_EQ(curve(parts), curve(whole));
  const redrive::Run opened = open_run(parts.paths.root);
  const MovingObject& actor = opened.scene.actors[0];
  EXPECT_EQ(actor.corrections.size(), 6 * actor.keys.size());
}

TEST_F(SplatTrainingTest, TheRunFolderIsComplete) {
  TrainOptions options;
  options.recording = REDRIVE_SAMPLES "/analytic";
  options.method = "splat";
  options.downscale = 4;
  options.max_steps = 40;
  options.set("max_gaussians", 3000);
  options.set("densify_every", 15);
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

  const redrive::Run opened = open_run(run.paths.root);
  EXPECT_TRUE(same_weights(opened.state, run.state));
  EXPECT_GT(splat(opened).gaussians, 1000);
  EXPECT_LE(splat(opened).gaussians, 3000);
  EXPECT_EQ(splat(opened).max_gaussians, 3000);
  for (const std::size_t v : {std::size_t{0}, opened.scene.views.size() - 1}) {
    const View& view = opened.scene.views[v];
    const RenderedImage image =
        opened.state.model->render(*backend_, make_ray_table(opened.scene.rig[view.camera].camera),
                                   opened.scene.shutter_poses(view), opened.scene.exposure(view));
    EXPECT_EQ(image.rgb.size(), 3u * image.width * image.height);
  }
}

}  // namespace
}  // namespace redrive
