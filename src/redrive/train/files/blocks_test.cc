// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/blocks.h"

#include <cmath>
#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// Frames 100, 101, ... at positions.
std::vector<PosedFrame> frames_at(const std::vector<Eigen::Vector3d>& positions) {
  std::vector<PosedFrame> frames;
  for (const Eigen::Vector3d& position : positions) {
    const auto i = static_cast<std::int64_t>(frames.size());
    frames.push_back({100 + i, 100'000'000 * i, Rigid3d(Eigen::Translation3d(position))});
  }
  return frames;
}

/// n frames along x, each `step_m` from the one before.
std::vector<PosedFrame> straight(int n, double step_m) {
  std::vector<Eigen::Vector3d> positions;
  for (int i = 0; i < n; ++i) positions.push_back({step_m * i, 0, 0});
  return frames_at(positions);
}

TEST(BlockOfFrame, IsTheBlockWhoseCoreHasIt) {
  const std::vector<Block> blocks = {{.name = "000", .first_core = 0, .last_core = 8},
                                     {.name = "001", .first_core = 10, .last_core = 18}};
  EXPECT_EQ(block_of_frame(blocks, 0).name, "000");
  EXPECT_EQ(block_of_frame(blocks, 8).name, "000");
  EXPECT_EQ(block_of_frame(blocks, 9).name, "001") << "the run left out frame 9";
  EXPECT_EQ(block_of_frame(blocks, 18).name, "001");
  EXPECT_EQ(block_of_frame(blocks, 30).name, "001");
}

TEST(WayDriven, IsTheDistanceAlongAStraightLine) {
  const std::vector<double> way = way_driven(straight(50, 0.3));
  for (int i = 0; i < 50; ++i) EXPECT_NEAR(way[i], 0.3 * i, 1e-9);
}

TEST(WayDriven, FollowsABend) {
  constexpr double kRadius_m = 30;
  std::vector<Eigen::Vector3d> positions;
  for (int i = 0; i <= 100; ++i) {
    const double angle = std::numbers::pi / 2 * i / 100;
    positions.push_back({kRadius_m * std::sin(angle), kRadius_m * (1 - std::cos(angle)), 0});
  }
  // A chord of c is shorter than its arc by c^3 / (24 R^2), here c < 1.5 m of a way of 47 m.
  EXPECT_NEAR(way_driven(frames_at(positions)).back(), kRadius_m * std::numbers::pi / 2, 0.01);
}

TEST(WayDriven, DoesNotGrowWhileTheCarStands) {
  std::vector<Eigen::Vector3d> positions;
  for (int i = 0; i < 20; ++i) positions.push_back({1.0 * i, 0, 0});
  for (int i = 0; i < 600; ++i)  // a minute of noise
    positions.push_back({19 + 0.05 * std::sin(7.0 * i), 0.05 * std::cos(11.0 * i), 0});
  for (int i = 20; i < 40; ++i) positions.push_back({1.0 * i, 0, 0});
  const std::vector<double> way = way_driven(frames_at(positions));
  EXPECT_NEAR(way.back(), 39, 0.2);
  EXPECT_TRUE(std::ranges::is_sorted(way));
}

TEST(Divide, MakesCoresOfEqualLengths) {
  // 100 m: three cores of 33.3 m, and 8 m beyond each of their ends.
  const std::vector<Block> blocks = divide(straight(101, 1), {40, 8, 1});
  ASSERT_EQ(blocks.size(), 3u);
  EXPECT_THAT((std::vector<std::string>{blocks[0].name, blocks[1].name, blocks[2].name}),
              ElementsAre("000", "001", "002"));
  EXPECT_EQ(blocks[0].first_frame, 100);
  EXPECT_EQ(blocks[0].first_core, 100);
  EXPECT_EQ(blocks[0].last_core, 133);
  EXPECT_EQ(blocks[0].last_frame, 141);
  EXPECT_EQ(blocks[1].first_frame, 126);
  EXPECT_EQ(blocks[1].first_core, 134);
  EXPECT_EQ(blocks[2].last_core, 200);
  EXPECT_EQ(blocks[2].last_frame, 200);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(blocks[i].start_m, i * 100.0 / 3, 1e-9);
    EXPECT_NEAR(blocks[i].end_m, (i + 1) * 100.0 / 3, 1e-9);
    EXPECT_FALSE(blocks[i].finished);
  }
}

TEST(Divide, CoresTileTheFrames) {
  const std::vector<PosedFrame> frames = straight(97, 0.7);
  for (const double length_m : {1.0, 5.0, 13.3, 60.0}) {
    const std::vector<Block> blocks = divide(frames, {length_m, 2, 1});
    std::int64_t next = 100;
    for (const Block& block : blocks) {
      EXPECT_EQ(block.first_core, next);
      EXPECT_LE(block.first_frame, block.first_core);
      EXPECT_LE(block.last_core, block.last_frame);
      EXPECT_LE(block.end_m - block.start_m, length_m + 1e-9);
      next = block.last_core + 1;
    }
    EXPECT_EQ(next, 197);
  }
}

TEST(Divide, LeavesAShortDriveWhole) {
  const std::vector<Block> blocks = divide(straight(30, 1), {30, 5, 1});
  ASSERT_EQ(blocks.size(), 1u);
  EXPECT_EQ(blocks[0].first_frame, 100);
  EXPECT_EQ(blocks[0].last_frame, 129);
  EXPECT_EQ(divide(straight(5, 0), {30, 5, 1}).size(), 1u) << "a car that stands";
}

TEST(Divide, MakesNoBlockOfAWayWithoutFrames) {
  // 20 m between two groups of frames, in parts of 4.3 m.
  const std::vector<Block> blocks =
      divide(frames_at({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}, {22, 0, 0}, {23, 0, 0}}), {5, 1, 1});
  ASSERT_EQ(blocks.size(), 2u);
  EXPECT_EQ(blocks[0].last_core, 102);
  EXPECT_EQ(blocks[1].first_core, 103);
  EXPECT_EQ(blocks[0].end_m, blocks[1].start_m);
  EXPECT_EQ(blocks[1].first_frame, 102) << "shares a frame, though it lies 20 m before";
}

TEST(Divide, BeginsAtFramesThatTheWholeHoldsOut) {
  for (const Block& block : divide(straight(200, 1), {30, 6, 8}))
    EXPECT_EQ((block.first_frame - 100) % 8, 0) << block.name;
}

TEST(Divide, OrdersByTheNumberOfFrames) {
  const std::vector<PosedFrame> frames = straight(100, 1);
  const std::vector<Block> blocks = {{"000", 100, 119}, {"001", 110, 169}, {"002", 160, 199}};
  EXPECT_THAT(longest_first(blocks, frames), ElementsAre(1, 2, 0));
}

TEST(Blocks, AreWrittenAndRead) {
  const TemporaryFolder folder;
  EXPECT_FALSE(is_divided_run(folder.path));
  std::vector<Block> blocks = divide(straight(101, 1), {40, 8, 1});
  blocks[1].finished = true;
  write_blocks(folder.path, blocks);
  EXPECT_TRUE(is_divided_run(folder.path));
  const std::vector<Block> read = read_blocks(folder.path);
  ASSERT_EQ(read.size(), 3u);
  EXPECT_EQ(blocks_text(read), blocks_text(blocks));
  EXPECT_EQ(read[2].start_m, blocks[2].start_m) << "bit for bit";
  EXPECT_TRUE(read[1].finished);
}

std::string error_of(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  text.replace(at, from.size(), to);
  try {
    parse_blocks(text, "RUN/blocks.json");
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(Blocks, BadFilesAreNamed) {
  const std::string text = blocks_text(divide(straight(101, 1), {40, 8, 1}));
  EXPECT_THAT(error_of(text, "redrive-blocks-1", "redrive-blocks-9"), HasSubstr("format"));
  EXPECT_THAT(error_of(text, "\"001\"", "\"../x\""), HasSubstr("blocks[1].name"));
  EXPECT_THAT(error_of(text, "\"first_core\": 134", "\"first_core\": 133"),
              HasSubstr("blocks[1].first_core"));
  EXPECT_THAT(error_of(text, "\"last_frame\": 141", "\"last_frame\": 41"),
              HasSubstr("blocks[0].last_frame"));
  EXPECT_THAT(error_of(text, "\"finished\": false", "\"finished\": 0"),
              HasSubstr("blocks[0].finished"));
  EXPECT_THAT(error_of(text, "\"start_m\": 33", "\"start_m\": 23"), HasSubstr("blocks[1].start_m"));
}

TEST(Blocks, HaveTheOptionsOfTheWholeWithFramesOfTheirOwn) {
  TrainOptions whole;
  whole.frames = "10:900:3";
  whole.downscale = 4;
  const TrainOptions options = block_options(whole, {"001", 40, 70, 46, 64});
  EXPECT_EQ(options.frames, "40:70:3");
  EXPECT_EQ(options.downscale, 4);
  EXPECT_EQ(options.refine_poses, "off");
}

}  // namespace
}  // namespace redrive
