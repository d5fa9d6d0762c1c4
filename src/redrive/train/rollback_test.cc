// SPDX-License-Identifier: Apache-2.0
// Roll-backs when training diverges. Separate from trainer_test.cc, whose tests also run under
// ThreadSanitizer: these take thousands of steps.
#include "redrive/train/loss_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

using RollbackTest = TrainingTest;

TEST_F(RollbackTest, FiftyBadStepsRollBackToTheLastCheckpointAtHalfTheRate) {
  TrainOptions options = tiny_options(1200);
  options.set("batch_rays", 16);
  redrive::Run run = run_named("run", options);
  Interference interference{.nan_from = 1060, .nan_to = 1110};
  InterferingBackend backend(*backend_, &interference);
  EXPECT_EQ(train(&run, backend, never_), TrainEnd::kFinished);
  EXPECT_EQ(run.state.rollbacks, 1);
  EXPECT_EQ(run.state.rate_factor, 0.5);
  EXPECT_EQ(run.state.skipped_steps, 50);
  EXPECT_EQ(run.state.step, 1200);
  EXPECT_THAT(read_file(run.paths.metrics()),
              AllOf(HasSubstr("\"event\":\"rollback\""), HasSubstr("\"to_step\":1040"),
                    HasSubstr("50 steps on end were not finite")));
  std::int64_t before = 0;
  for (const MetricsRow& row : read_metrics(run.paths)) {
    EXPECT_GT(row.step, before) << "rows that a roll-back undid are not read";
    before = row.step;
    EXPECT_DOUBLE_EQ(row.learning_rate,
                     2e-3 * (row.step > 1040 ? 0.5 : 1) *
                         std::pow(0.5, (row.step > 600) + (row.step > 900) + (row.step > 1050)));
  }
  EXPECT_EQ(before, 1200);
}

TEST_F(RollbackTest, GivesUpAfterFourRollBacks) {
  TrainOptions options = tiny_options(2000);
  options.set("batch_rays", 16);
  redrive::Run run = run_named("run", options);
  Interference interference{.nan_from = 1050, .nan_to = 5000};
  InterferingBackend backend(*backend_, &interference);
  try {
    train(&run, backend, never_);
    ADD_FAILURE() << "no UsageError";
  } catch (const UsageError& error) {
    EXPECT_THAT(error.what(), AllOf(HasSubstr("--learning-rate"),
                                    HasSubstr("50 steps on end were not finite, as 4 times"),
                                    HasSubstr("checkpoint.safetensors")));
  }
  EXPECT_EQ(run.state.skipped_steps, 250);
  const TrainState left = load_checkpoint(run.paths.checkpoint());
  EXPECT_EQ(left.step, 1040);
  EXPECT_EQ(left.rollbacks, 4);
  EXPECT_EQ(left.rate_factor, 1 / 16.0);
}

/// 512 rays: a window of 25 steps has more than 10^4 rays, so it is not smoothed. Tiny networks
/// learn the two images in a few windows.
TrainOptions watched_options(std::int64_t max_steps) {
  TrainOptions options = tiny_options(max_steps);
  options.set("batch_rays", 512);
  options.set("samples", 4);
  return options;
}

// Parameters are corrupted in the middle of a healthy run: the error rises tenfold and stays there,
// because all gradients vanish. It happens within the steps that train/start_watch.h watches, but
// meets none of its criteria.
TEST_F(RollbackTest, ADivergenceIsUndoneAndAResumedRunUndoesTheSame) {
  redrive::Run whole = run_named("whole", watched_options(700));
  Interference interference{.spoil_at = 210};
  InterferingBackend backend(*backend_, &interference);
  EXPECT_EQ(train(&whole, backend, never_), TrainEnd::kFinished);
  EXPECT_EQ(whole.state.rollbacks, 1);
  EXPECT_EQ(whole.state.rate_factor, 0.5);
  EXPECT_EQ(whole.state.step, 700);
  const std::string metrics = read_file(whole.paths.metrics());
  EXPECT_THAT(metrics, HasSubstr("diverging: mean squared error"));
  EXPECT_THAT(metrics, HasSubstr("\"to_step\":200"))
      << "the checkpoint before the first high window, which ends at 225";

  redrive::Run parts = run_named("parts", watched_options(700));
  {
    Interference killed;
    killed.spoil_at = 210;
    killed.kill_at = 400;
    InterferingBackend killer(*backend_, &killed);
    EXPECT_THROW(train(&parts, killer, never_), Killed);
  }
  parts = reopened(parts);
  ASSERT_EQ(parts.state.step, 200) << "no checkpoint while the loss is high";
  interference.spoil_at = 10;
  InterferingBackend again(*backend_, &interference);
  EXPECT_EQ(train(&parts, again, never_), TrainEnd::kFinished);
  EXPECT_EQ(parts.state.rollbacks, 1);
  EXPECT_EQ(curve(parts), curve(whole));
  EXPECT_TRUE(same_weights(parts.state, whole.state));
}

// A high loss at the end, or at Ctrl-C, is rolled back before the final checkpoint.
TEST_F(RollbackTest, ARunDoesNotEndWithALossThatRose) {
  for (const bool ctrl_c : {false, true}) {
    redrive::Run run =
        run_named(ctrl_c ? "stopped" : "finished", watched_options(ctrl_c ? 1000 : 300));
    Interference interference{.spoil_at = 210};
    if (ctrl_c) interference.stop_after = 300;
    InterferingBackend backend(*backend_, &interference);
    EXPECT_EQ(train(&run, backend, interference.stop),
              ctrl_c ? TrainEnd::kInterrupted : TrainEnd::kFinished);
    EXPECT_EQ(run.state.rollbacks, ctrl_c ? 0 : 1);
    EXPECT_EQ(run.state.step, load_checkpoint(run.paths.checkpoint()).step);
    if (ctrl_c)
      EXPECT_EQ(run.state.step, 200);
    else
      EXPECT_EQ(run.state.step, 300);
    EXPECT_EQ(run.state.loss_watch.high, 0);
  }
}

}  // namespace
}  // namespace redrive
