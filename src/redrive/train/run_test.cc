// SPDX-License-Identifier: Apache-2.0
// A run folder opens only if its checkpoint belongs to its options and its recording.
#include "redrive/train/run.h"

#include <functional>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/methods/grid/grid_model.h"
#include "redrive/methods/nerf/nerf_model.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

TrainOptions options_of(const std::string& method) {
  TrainOptions options;
  options.recording = REDRIVE_SAMPLES "/analytic";
  options.method = method;
  apply_preset(&options, {});
  options.set("width", 32);
  options.set("samples", 12);
  return options;
}

/// Opens a run folder of `method` with the initial checkpoint of a run of `options`, modified by
/// `change`; returns the error message, "" if none.
std::string error_message(const std::string& method, const TrainOptions& options,
                          const std::function<void(Trainee&)>& change = {}) {
  const TemporaryFolder folder;
  const RunPaths paths = create_run(folder.path / "run", options_of(method));
  const Scene scene = make_scene(open_recording(options), scene_options(options));
  std::unique_ptr<Trainee> model = make_run_model(options, scene);
  if (change) change(*model);
  save_checkpoint(paths.checkpoint(), initial_state(std::move(model), 1));
  try {
    open_run(paths.root);
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr(paths.checkpoint().string()));
    return error.what();
  }
  return "";
}

TEST(RunFolder, OpensWithACheckpointOfItsOptions) {
  EXPECT_EQ(error_message("nerf", options_of("nerf")), "");
}

TEST(RunFolder, RejectsACheckpointOfOtherOptions) {
  TrainOptions options = options_of("nerf");
  EXPECT_THAT(error_message("grid", options), HasSubstr("method = nerf"));
  options.set("width", 64);
  EXPECT_THAT(error_message("nerf", options), HasSubstr("width = 64"));
  options = options_of("nerf");
  options.set("samples", 13);
  EXPECT_THAT(error_message("nerf", options), HasSubstr("samples = 13"));
  options = options_of("nerf");
  options.far_m *= 1.001;
  EXPECT_THAT(error_message("nerf", options), HasSubstr("far_m"));
}

TEST(RunFolder, RejectsACheckpointOfAnotherTrajectory) {
  const auto moved_by = [](float metres) {
    return [=](Trainee& model) {
      dynamic_cast<NerfModel&>(model).unit_from_world.center[1] += metres;
    };
  };
  EXPECT_THAT(error_message("nerf", options_of("nerf"), moved_by(0.01f)), HasSubstr("center_y"));
  EXPECT_EQ(error_message("nerf", options_of("nerf"), moved_by(1e-7f)), "")
      << "another compiler's rounding";
}

TEST(RunFolder, ChecksTheOptionsOfAGrid) {  // few cases, because its checkpoint is large
  TrainOptions options = options_of("grid");
  EXPECT_EQ(
      error_message("grid", options,
                    [](Trainee& m) { dynamic_cast<GridModel&>(m).contraction.center[1] += 1e-7f; }),
      "");
  EXPECT_THAT(
      error_message("grid", options,
                    [](Trainee& m) { dynamic_cast<GridModel&>(m).contraction.center[1] += 0.01f; }),
      HasSubstr("contraction.center_y"));
  const auto small = [](Trainee& m) {
    dynamic_cast<GridModel&>(m).field.grid.log2_hashmap_size = 4;
  };
  EXPECT_THAT(error_message("grid", options, small), HasSubstr("grid.log2_hashmap_size = 4"));
  EXPECT_THAT(error_message("nerf", options, small), HasSubstr("method = grid"));
}

// Opens with the refined poses for rendering, with the initial ones to resume.
TEST(RunFolder, OpensWithItsRefinedPoses) {
  const TemporaryFolder folder;
  const TrainOptions options = options_of("grid");
  const RunPaths paths = create_run(folder.path / "run", options);
  const Recording recording = open_recording(options);
  const Scene scene = make_scene(recording, scene_options(options));
  TrainState state = make_initial_state(options, scene);
  ASSERT_TRUE(state.poses.refines()) << "drives are refined";
  PoseCorrections& corrections = state.poses.corrections;
  corrections.values[corrections.frame_slot(1)] = 0.25f;
  corrections.values[corrections.camera_slot(0) + 2] = -0.125f;
  save_checkpoint(paths.checkpoint(), state);
  const redrive::Run looked_at = open_run(paths.root),
                     resumed = open_run(paths.root, /*to_resume=*/true);
  const auto moved = [&](const redrive::Run& run, std::size_t view) {
    return (run.scene.world_from_camera(run.scene.views[view]).translation() -
            scene.world_from_camera(scene.views[view]).translation())
        .norm();
  };
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    EXPECT_EQ(moved(resumed, v), 0);
    const View& view = scene.views[v];
    if (view.frame == 1 && view.camera != 0) {
      EXPECT_NEAR(moved(looked_at, v), 0.25, 1e-6);
    }
    if (view.frame == 3 && view.camera == 0) {
      EXPECT_NEAR(moved(looked_at, v), 0.125, 1e-6);
    }
  }
  EXPECT_NEAR((looked_at.scene.corrected_trajectory()[1].global_from_body.translation() -
               looked_at.recording.frames[1].global_from_body.translation())
                  .norm(),
              0.25, 1e-6);
  state.poses = {};
  state.poses.corrections.frames = static_cast<int>(scene.frames.size()) + 1;
  state.poses.corrections.cameras = static_cast<int>(scene.rig.size());
  state.poses.corrections.values.resize(state.poses.corrections.size());
  state.poses.moments = AdamMoments(state.poses.corrections.size());
  save_checkpoint(paths.checkpoint(), state);
  try {
    open_run(paths.root);
    FAIL() << "poses of another recording";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("no longer the recording"));
  }
}

TEST(ModelOf, IsBoundedByTheCubeSeenFromOutsideOrOnABackground) {
  const TrainOptions options = options_of("grid");
  Scene scene;
  scene.metric = false;
  scene.half_side = 2;
  scene.rig.resize(1);
  scene.rig[0].body_from_sensor = Rigid3d::Identity();
  const auto grid = [&](double x) {
    scene.frames.clear();
    scene.trajectory.clear();
    scene.add_frame({0, 0, Rigid3d(Eigen::Translation3d(x, 0, 0))});
    scene.views = {View()};
    const auto model = make_run_model(options, scene);
    const auto& grid = dynamic_cast<const GridModel&>(*model);
    EXPECT_EQ(grid.contraction.half_m, 2);
    return std::tuple(grid.contraction.unbounded, grid.sky.n_levels > 0, grid.field.colour_layers);
  };
  EXPECT_EQ(grid(5), std::tuple(false, true, 2));
  EXPECT_EQ(grid(1), std::tuple(true, true, 1));
  scene.background = Background::kWhite;
  EXPECT_EQ(grid(5), std::tuple(false, false, 2));
  EXPECT_EQ(grid(1), std::tuple(false, false, 2));
}

TEST(RunFolder, ResumesFromTheStartWithoutACheckpoint) {
  const TemporaryFolder folder;
  create_run(folder.path / "run", options_of("nerf"));
  EXPECT_THROW(open_run(folder.path / "run"), std::runtime_error);
  const redrive::Run run = open_run(folder.path / "run", /*fresh_if_untrained=*/true);
  EXPECT_EQ(run.state.step, 0);
  EXPECT_EQ(run.state.adam.first_moment.size(), run.state.model->size());
  EXPECT_THROW(open_run(folder.path / "nowhere"), InputError);
}

}  // namespace
}  // namespace redrive
