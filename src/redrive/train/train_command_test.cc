// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/train_command.h"

#include <gtest/gtest.h>

#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

class TrainCommand : public ::testing::Test {
 protected:
  TrainCommand() { recording_ = make_test_recording(folder_.path); }

  /// Returns the command of a run that was trained with these options.
  std::string command(TrainOptions options, std::vector<std::string> given) {
    options.recording = "/data/drive 7";
    given.insert(given.end(), {"recording", "method"});
    apply_preset(&options, given);
    redrive::Run run;
    run.recording = recording_;
    resolve_bounds(&options, given, run.recording);
    run.scene = make_scene(run.recording, scene_options(options));
    record_hyperparameters(*make_run_model(options, run.scene), &options);
    run.blocks = blocks_;
    return train_command(run, options, "/runs/a");
  }

  const TemporaryFolder folder_;
  Recording recording_;
  std::vector<Block> blocks_;
};

TEST_F(TrainCommand, DividesADriveInBlocksAsItIs) {
  blocks_.resize(2);
  blocks_[0].end_m = blocks_[1].start_m = 12.345;
  blocks_[1].end_m = 24.69;
  EXPECT_EQ(command({}, {}),
            "redrive train '/data/drive 7' --method splat --blocks 12.35 --out /runs/a");
}

TEST_F(TrainCommand, HasWhatDiffersFromTheDefaultsOfTheMethod) {
  for (const char* method : {"splat", "grid", "nerf"}) {
    TrainOptions options;
    options.method = method;
    EXPECT_EQ(command(options, {}),
              "redrive train '/data/drive 7' --method " + std::string(method) + " --out /runs/a");
  }
  TrainOptions options;
  options.method = "splat";
  options.downscale = 4;
  options.holdout_every = 8;
  options.cameras = {"FRONT", "FISHEYE"};
  options.ground_truth_poses = true;
  options.near_m = 0.25;
  EXPECT_EQ(command(options, {"downscale", "holdout-every", "cameras", "truth-poses", "near"}),
            "redrive train '/data/drive 7' --method splat --cameras FRONT,FISHEYE --downscale 4 "
            "--holdout-every 8 --near 0.25 --truth-poses --out /runs/a");
}

TEST_F(TrainCommand, KnowsThatLimitsChangeOtherDefaults) {
  TrainOptions options;
  options.method = "splat";
  options.max_steps = 60;
  EXPECT_EQ(command(options, {"max-steps"}),
            "redrive train '/data/drive 7' --method splat --max-steps 60 --out /runs/a");
  options.max_steps = 0;
  options.max_seconds = 900;  // has more Gaussians
  EXPECT_EQ(command(options, {"max-seconds"}),
            "redrive train '/data/drive 7' --method splat --max-seconds 900 --out /runs/a");
  options.max_seconds = 0;
  EXPECT_EQ(command(options, {"max-seconds"}),
            "redrive train '/data/drive 7' --method splat --max-seconds 0 --out /runs/a");
}

TEST_F(TrainCommand, HasPresetsHyperparametersAndTheBoundsThatWereGiven) {
  TrainOptions options;
  options.method = "nerf";
  options.preset = "report-2";
  options.cameras = {"FRONT"};
  options.hyperparameters = {
      {"width", "64"}, {"lr_milestones", "100,200"}, {"position_octaves", "8"}};
  EXPECT_EQ(command(options, {"preset", "cameras", "width", "lr-milestones", "set"}),
            "redrive train '/data/drive 7' --method nerf --cameras FRONT --lr-milestones 100,200 "
            "--preset report-2 --set position_octaves=8 --width 64 --out /runs/a");
  recording_.metric = false;
  recording_.bounds = {recording_.frames[0].global_from_body.translation(), 10};
  options = TrainOptions();
  options.method = "grid";
  EXPECT_EQ(command(options, {}), "redrive train '/data/drive 7' --method grid --out /runs/a");
  options.far_m = 50;
  EXPECT_EQ(command(options, {"far"}),
            "redrive train '/data/drive 7' --method grid --far 50 --out /runs/a");
}

TEST_F(TrainCommand, QuotesWhatAShellWouldChange) {
  TrainOptions options;
  options.method = "nerf";
  options.poses = "it's $HOME";
  EXPECT_EQ(command(options, {"poses"}),
            "redrive train '/data/drive 7' --method nerf --poses 'it'\\''s $HOME' --out /runs/a");
}

}  // namespace
}  // namespace redrive
