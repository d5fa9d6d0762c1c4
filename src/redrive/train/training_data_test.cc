// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/training_data.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/perception/moving_file.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class TrainingDataTest : public testing::Test {
 protected:
  TrainingDataTest() {
    run_.options = tiny_options(1);
    run_.recording = make_test_recording(folder_.path, 4);  // FRONT 24 x 16
    std::filesystem::create_directory(masks_);
  }
  void prepare() {
    run_.scene = make_scene(run_.recording, scene_options(run_.options));
    run_.state.model = make_run_model(run_.options, run_.scene);
  }
  /// A mask of all but the pixel (5, 3).
  void write(const std::filesystem::path& folder) {
    Mask mask = full_mask(24, 16);
    mask.used[3 * 24 + 5] = 0;
    write_mask(mask_file(folder, run_.scene.rig[0]), mask, run_.scene.rig[0], 1);
  }
  std::string rejection() {
    try {
      prepare_training_data(&run_, pool_);
    } catch (const UsageError& error) {
      return error.what();
    }
    return "not rejected";
  }

  TemporaryFolder folder_;
  const std::filesystem::path masks_ = folder_.path / "given";
  redrive::Run run_;
  ThreadPool pool_{2};
};

// A resumed run must train on the same pixels.
TEST_F(TrainingDataTest, RunKeepsTheComputedMasks) {
  run_.options.downscale = 3;
  run_.options.masks = masks_;
  run_.options.holdout_every = 3;
  prepare();
  write(masks_);
  const TrainingData found = prepare_training_data(&run_, pool_);
  ASSERT_EQ(found.images.size(), 4u);
  EXPECT_TRUE(found.images[0].rgb.empty()) << "held out";
  ASSERT_EQ(found.images[1].used.size(), 8u * 5);
  EXPECT_EQ(std::ranges::count(found.images[1].used, 0), 1);
  EXPECT_EQ(found.images[1].used[1 * 8 + 1], 0);

  run_.paths = create_run(folder_.path / "run", run_.options,
                          [&](const RunPaths& paths) { write_run_masks(paths, found, run_); });
  std::filesystem::remove_all(masks_);
  const TrainingData loaded = load_training_data(run_, pool_);
  for (std::size_t i = 0; i < loaded.images.size(); ++i) {
    EXPECT_EQ(loaded.images[i].rgb, found.images[i].rgb) << i;
    EXPECT_EQ(loaded.images[i].used, found.images[i].used) << i;
  }
}

TEST_F(TrainingDataTest, ARemovedMaskMasksNothing) {
  run_.options.masks = masks_;
  prepare();
  write(masks_);
  const TrainingData found = prepare_training_data(&run_, pool_);
  run_.paths = create_run(folder_.path / "run", run_.options,
                          [&](const RunPaths& paths) { write_run_masks(paths, found, run_); });
  ASSERT_TRUE(std::filesystem::remove(run_.paths.masks() / "FRONT.png"));
  EXPECT_TRUE(load_training_data(run_, pool_).images[0].used.empty());
}

TEST_F(TrainingDataTest, NoneComputesNoMasks) {
  run_.options.masks = "none";
  prepare();
  run_.paths.root = folder_.path;
  std::filesystem::create_directory(run_.paths.masks());
  write(run_.paths.masks());
  EXPECT_TRUE(load_training_data(run_, pool_).images[0].used.empty());
  EXPECT_TRUE(prepare_training_data(&run_, pool_).images[0].used.empty());
}

// Else the LiDAR of held-out frames could not be scored. Runs of earlier builds go on as they
// began.
TEST_F(TrainingDataTest, RevolutionsOfHeldOutFramesDoNotTrain) {
  run_.options.holdout_every = 2;  // frames 10 and 12
  run_.options.masks = "none";
  prepare();
  run_.state.model = std::make_unique<GridModel>();
  run_.recording.reader = aimotive::make_reader();
  run_.recording.lidars = {{"lidar", Rigid3d::Identity()}};
  std::vector<std::int64_t> times;
  for (const FramePose& frame : run_.recording.frames) {
    const LidarRecord point{{20, 0, 0}, frame.t_ns};
    const std::string name = "frame_" + std::to_string(frame.id) + ".las";
    folder_.write(name, make_las(std::span(&point, 1)));
    run_.recording.lidar_files.push_back({frame.id, folder_.path / name});
    times.push_back(frame.t_ns);
  }
  EXPECT_EQ(prepare_training_data(&run_, pool_).lidar.t_ns,
            (std::vector<std::int64_t>{times[1], times[3]}));
  for (View& view : run_.scene.views) view.held_out = false;
  EXPECT_EQ(prepare_training_data(&run_, pool_).lidar.t_ns, times);
}

TEST_F(TrainingDataTest, RejectsAFolderWithoutMasks) {
  prepare();
  run_.options.masks = masks_;
  EXPECT_THAT(rejection(),
              AllOf(HasSubstr("--masks"), HasSubstr("FRONT.png"), HasSubstr(masks_.string())));
  run_.options.masks = "nowhere";
  EXPECT_THAT(rejection(), AllOf(HasSubstr("--masks"), HasSubstr("nowhere"),
                                 HasSubstr("auto, none or a folder")));
}

TEST_F(TrainingDataTest, AFolderMayHoldMovingObjectsAlone) {
  run_.options.masks = masks_;
  prepare();
  MovingObject object;
  object.id = -2;
  object.size_m = {4, 2, 2};
  for (const FramePose& frame : run_.recording.frames) {
    Rigid3d pose = Rigid3d::Identity();
    pose.translation().x() = 6;
    object.keys.push_back({frame.t_ns, pose, Eigen::Vector3d::Zero()});
  }
  write_moving_file(moving_file(masks_), {object});
  TrainingData data = prepare_training_data(&run_, pool_);
  ASSERT_EQ(run_.moving.objects().size(), 1u);
  EXPECT_EQ(run_.moving.objects()[0].id, -2);
  EXPECT_TRUE(run_.scene.actors.empty()) << "of a method that draws none";
  EXPECT_EQ(data.left_out.moving.objects().size(), 1u);

  run_.state.model = std::make_unique<SplatModel>();
  data = prepare_training_data(&run_, pool_);
  ASSERT_EQ(run_.scene.actors.size(), 1u);
  EXPECT_EQ(run_.scene.actors[0].type, kFound);
  EXPECT_TRUE(data.left_out.moving.objects().empty());
}

}  // namespace
}  // namespace redrive
