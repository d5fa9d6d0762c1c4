// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/perception/seen_through.h"
#include "redrive/train/train_testing.h"

namespace redrive {
namespace {

constexpr std::uint64_t kPlanGiB = std::uint64_t{1} << 30;

/// 100 images of 1 MB, 2 GiB with all of them, 1 GiB with the smallest cache.
PlannedBlock planned_block(std::int64_t images) {
  PlannedBlock block;
  block.images = images;
  block.image_file_bytes = static_cast<std::uint64_t>(images) * 1'000'000;
  block.lidar_file_bytes = 500'000'000;
  block.memory_bytes = 2 * kPlanGiB;
  block.least_memory_bytes = kPlanGiB;
  block.checkpoint_bytes = 50'000'000;
  return block;
}

constexpr TrainingRates kRates{.prepare_s = 0.04, .decode_s = 0.02, .start_s = 0.1, .step_s = 0.06};

TEST(Plan, AQueueTakesTheLongestFirst) {
  EXPECT_EQ(queue_seconds({1, 2, 3, 4}, 1), 10);
  EXPECT_EQ(queue_seconds({1, 2, 3, 4}, 2), 5) << "4 + 1 and 3 + 2";
  EXPECT_EQ(queue_seconds({3, 3, 2, 2, 2}, 2), 7) << "3 + 2 + 2 and 3 + 2";
  EXPECT_EQ(queue_seconds({1, 2}, 8), 2);
}

TEST(Plan, OneBlockOnOneMachine) {
  const TrainingPlan plan =
      plan_training({planned_block(100)}, kRates, {1, 2, 4 * kPlanGiB}, {.max_steps = 1000});
  EXPECT_EQ(plan.ranks_per_machine, 1);
  EXPECT_EQ(plan.cores_per_rank, 2);
  EXPECT_DOUBLE_EQ(plan.blocks[0].prepare_s, 100 * (0.04 + 0.1) / 2);
  EXPECT_DOUBLE_EQ(plan.blocks[0].train_s, 1000 * 0.06 / 2);
  EXPECT_DOUBLE_EQ(plan.blocks[0].steps, 1000);
  EXPECT_DOUBLE_EQ(plan.seconds, 37);
  EXPECT_DOUBLE_EQ(plan.core_seconds, 74);
  EXPECT_DOUBLE_EQ(plan.efficiency, 1);
  EXPECT_EQ(plan.memory_bytes, 2 * kPlanGiB);
  EXPECT_EQ(plan.reads_bytes, 600'000'000u) << "each file once";
  EXPECT_DOUBLE_EQ(plan.reads_bytes_per_s, 600e6 / 2);
  EXPECT_EQ(plan.writes_bytes, 3 * 50'000'000u) << "at the start, after 1000 steps, at the end";
  EXPECT_EQ(plan.limit, "the longest block");
}

// Of 6 sweeps two pairs are 4 apart and one is 5 apart: each of these looks at the other.
TEST(Plan, PreparationIncludesMasksAndTheSearchForMovingObjects) {
  PlannedBlock block = planned_block(100);
  block.cameras = 3;
  block.sweeps = 6;
  TrainingRates rates = kRates;
  rates.mask_s = 2;
  rates.look_s = 0.5;
  EXPECT_EQ(search_looks(6), 6);
  const TrainingPlan plan =
      plan_training({block}, rates, {1, 2, 4 * kPlanGiB}, {.max_steps = 1000});
  EXPECT_DOUBLE_EQ(plan.blocks[0].prepare_s, (100 * (0.04 + 0.1) + 3 * 2 + 0.6 * 6 * 0.5) / 2);
}

// Seconds of training count from the first step on.
TEST(Plan, ATimeLimitIsTheTimeOfTraining) {
  const auto train_s = [](const TrainingLimits& limits) {
    return plan_training({planned_block(100)}, kRates, {1, 2, 4 * kPlanGiB}, limits)
        .blocks[0]
        .train_s;
  };
  EXPECT_DOUBLE_EQ(train_s({.max_seconds = 120}), 120);
  EXPECT_DOUBLE_EQ(train_s({.max_steps = 1000, .max_seconds = 120}), 30);
  EXPECT_DOUBLE_EQ(train_s({.max_steps = 1000, .max_seconds = 20}), 20);
}

TEST(Plan, MemoryDecidesHowManyBlocksAMachineTrainsAtOnce) {
  const std::vector<PlannedBlock> blocks(10, planned_block(100));
  const auto of = [&](const Machines& machines) {
    return plan_training(blocks, kRates, machines, {.max_steps = 1000});
  };
  const TrainingPlan plan = of({1, 8, 7 * kPlanGiB});
  EXPECT_EQ(plan.ranks_per_machine, 3);
  EXPECT_EQ(plan.cores_per_rank, 2);
  EXPECT_DOUBLE_EQ(plan.seconds, 4 * 37) << "10 blocks, 3 at a time";
  EXPECT_NEAR(plan.efficiency, 10.0 / 12, 1e-12);
  EXPECT_EQ(plan.memory_bytes, 6 * kPlanGiB);
  EXPECT_DOUBLE_EQ(of({2, 8, 7 * kPlanGiB}).seconds, 2 * 37);
  EXPECT_EQ(of({10, 8, 7 * kPlanGiB}).ranks_per_machine, 1) << "no more than there are blocks";
  EXPECT_EQ(of({1, 4, 100 * kPlanGiB}).ranks_per_machine, 4) << "no more than cores";
}

TEST(Plan, ImagesThatDoNotFitAreReadAgain) {
  const TrainingPlan plan =
      plan_training({planned_block(100)}, kRates, {1, 2, kPlanGiB}, {.max_steps = 1000});
  const PlannedBlock& block = plan.blocks[0];
  EXPECT_TRUE(block.streams);
  // Half of the steps decode an image.
  EXPECT_DOUBLE_EQ(block.prepare_s, 100 * (0.04 + 0.1 + (kStreamedPasses - 1) * 0.02) / 2);
  EXPECT_DOUBLE_EQ(block.train_s, 1000 * (0.06 + 0.5 * 0.02) / 2);
  EXPECT_NEAR(static_cast<double>(block.reads_bytes),
              kStreamedPasses * 100e6 + 500e6 + 1000 * 0.5 * 1e6, 1);
  EXPECT_EQ(plan.memory_bytes, kPlanGiB);
}

TEST(Plan, RefusesABlockThatDoesNotFit) {
  EXPECT_THROW(plan_training({planned_block(100)}, kRates, {1, 2, kPlanGiB - 1}, {.max_steps = 1}),
               UsageError);
}

TEST(Plan, AsJson) {
  const nlohmann::json json = to_json(
      plan_training({planned_block(100)}, kRates, {1, 2, 4 * kPlanGiB}, {.max_steps = 1000}));
  EXPECT_EQ(json.at("seconds"), 37.0);
  EXPECT_EQ(json.at("blocks").at(0).at("images"), 100);
}

class MeasuredRates : public TrainingTest {};

TEST_F(MeasuredRates, ArePositive) {
  for (const char* method : {"splat", "nerf"}) {
    TrainOptions options = tiny_options(1);
    if (std::string(method) == "splat") {
      options = {};
      options.recording = "in memory";
      options.method = method;
      options.set("initial.sky", 800);
    }
    redrive::Run run = tiny_run(folder_.path / method, folder_.path, options);
    const TrainingRates rates = measure_rates(&run, *backend_, {.steps = 20});
    for (const double rate : {rates.prepare_s, rates.decode_s, rates.start_s, rates.step_s})
      EXPECT_GT(rate, 0) << method;
    EXPECT_EQ(run.state.step, 22) << "two before those that count";
  }
}

}  // namespace
}  // namespace redrive
