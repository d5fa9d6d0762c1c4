// SPDX-License-Identifier: Apache-2.0
// A drive of 300 m in memory whose images are tiny; the sample street where a run is opened again.
#include "redrive/train/divided_run.h"

#include <filesystem>
#include <set>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

class DividedRunTest : public testing::Test {
 protected:
  DividedRunTest() {
    whole_.options.recording = "in memory";
    whole_.options.method = "splat";
    whole_.options.max_steps = 10;
    whole_.recording = make_test_recording(folder_.path, 101);
    // Straight ahead, 3 m a frame.
    const Rigid3d begin = whole_.recording.frames.front().global_from_body;
    for (std::size_t f = 0; f < whole_.recording.frames.size(); ++f)
      whole_.recording.frames[f].global_from_body =
          begin * Rigid3d(Eigen::Translation3d(3.0 * static_cast<double>(f), 0, 0));
    whole_.scene = make_scene(whole_.recording, scene_options(whole_.options));
  }
  MemoryEstimate need(const std::string& text) {
    DividedRun divided{{},
                       whole_.options,
                       whole_.recording,
                       whole_.scene,
                       divide_as_told(text, whole_, {2, std::uint64_t{1} << 50})};
    return check_blocks(divided, {2, std::uint64_t{1} << 50});
  }
  std::vector<Block> automatic(std::uint64_t memory) {
    return divide_as_told("auto", whole_, {2, memory});
  }

  const TemporaryFolder folder_;
  DividedRun whole_;
};

TEST_F(DividedRunTest, AutoTakes200MetresAndLessWhereMemoryAsksForIt) {
  EXPECT_EQ(divide_as_told("100", whole_, {2, 0}).size(), 3u) << "metres are taken as told";
  EXPECT_EQ(automatic(std::uint64_t{1} << 50).size(), 2u) << "of 150 m";
  // Images that are decoded when needed are no reason for shorter blocks.
  const MemoryEstimate of_long = need("auto");
  ASSERT_LT(of_long.least(), of_long.total());
  EXPECT_EQ(automatic(of_long.least()).size(), 2u);
  EXPECT_GT(automatic(of_long.least() - 1).size(), 2u);
  EXPECT_LE(automatic(1).size(), 300u / 40 + 1) << "no block is shorter than 40 m";
}

TEST_F(DividedRunTest, SaysWhatTheLargestBlockNeeds) {
  whole_.blocks = divide(whole_.scene.posed_frames(), {100, 20, 1});
  const MemoryEstimate most = check_blocks(whole_, {2, std::uint64_t{1} << 50});
  EXPECT_EQ(most.total(), need("100").total());
  EXPECT_THROW(check_blocks(whole_, {2, most.least() - 1}), UsageError);
}

TEST_F(DividedRunTest, RefusesWhatCannotBeDivided) {
  TrainOptions options = whole_.options;
  Recording recording = whole_.recording;
  EXPECT_NO_THROW(check_divisible("auto", options, recording));
  for (const char* text : {"", "-3", "20m", "1e99"})
    EXPECT_THROW(check_divisible(text, options, recording), UsageError) << text;
  options.refine_poses = "on";
  EXPECT_THROW(check_divisible("auto", options, recording), UsageError);
  options.refine_poses = "auto";
  recording.metric = false;
  EXPECT_THROW(check_divisible("auto", options, recording), UsageError);
}

TEST_F(DividedRunTest, ABlockIsARunOfItsFramesWithTheMasksOfTheWhole) {
  DividedRun whole;
  whole.options.recording = REDRIVE_SAMPLES "/street";
  whole.options.cameras = {"F_MIDLONGRANGECAM_CL"};
  whole.options.method = "splat";
  whole.options.set("initial.sky", 800);
  whole.options.downscale = 16;
  whole.options.max_steps = 10;
  whole.recording = open_recording(whole.options);
  whole.scene = make_scene(whole.recording, scene_options(whole.options));
  whole.blocks = divide(whole.scene.posed_frames(), {13, 3, 1});
  ASSERT_EQ(whole.blocks.size(), 2u);
  ThreadPool pool(2);
  create_divided_run(folder_.path / "run", &whole, pool, {});
  ASSERT_TRUE(is_divided_run(folder_.path / "run"));
  folder_.write("run/blocks/.001.redrive-tmp/config.json", "half");  // leftover of a killed process

  DividedRun again = open_divided_run(folder_.path / "run");
  EXPECT_EQ(blocks_text(again.blocks), blocks_text(whole.blocks));
  const Block& second = again.blocks[1];
  create_block(again, second);
  EXPECT_FALSE(std::filesystem::exists(folder_.path / "run/blocks/.001.redrive-tmp"));
  create_block(again, second);  // does nothing
  again.options.max_steps = 20;
  const redrive::Run run = open_block(again, second);
  EXPECT_EQ(run.scene.frames.front().id, second.first_frame);
  EXPECT_EQ(run.scene.frames.back().id, second.last_frame);
  EXPECT_TRUE(run.scene.global_from_world.isApprox(whole.scene.global_from_world, 0));
  EXPECT_EQ(run.options.max_steps, 20);
  EXPECT_EQ(std::filesystem::canonical(run.paths.masks()),
            std::filesystem::canonical(again.paths.masks()));

  std::vector<Block> other = again.blocks;
  other[0].first_frame = 3;
  write_blocks(again.paths.root, other);
  try {
    open_divided_run(again.paths.root);
    ADD_FAILURE() << "the street has no frame 3";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), HasSubstr("blocks.000"));
  }
}

TEST_F(DividedRunTest, RowsAreMeansOfTheBlocksThatGotSoFar) {
  whole_.blocks = divide(whole_.scene.posed_frames(), {100, 20, 1});
  write_blocks(folder_.path, whole_.blocks);
  EXPECT_TRUE(read_block_metrics(folder_.path).rows.empty());
  const auto append = [&](const char* block, std::int64_t step, double psnr_db, double loss) {
    const RunPaths paths{folder_.path / "blocks" / block};
    std::filesystem::create_directories(paths.root);
    append_metrics(paths,
                   {.step = step, .seconds = 2.0 * double(step), .loss = loss, .psnr_db = psnr_db});
  };
  append("000", 25, 20, 0.5);
  append("000", 50, 24, 0.25);
  append("001", 25, 22, 0.25);
  const BlockMetrics all = read_block_metrics(folder_.path);
  ASSERT_EQ(all.rows.size(), 2u);
  EXPECT_EQ(all.rows[0].step, 25);
  EXPECT_EQ(all.rows[0].psnr_db, 21);
  EXPECT_EQ(all.rows[0].loss, 0.375);
  EXPECT_EQ(all.rows[1].step, 50);
  EXPECT_EQ(all.rows[1].psnr_db, 24);
  EXPECT_EQ(all.steps, 50 + 25);
  EXPECT_EQ(all.seconds, 100 + 50);
}

}  // namespace
}  // namespace redrive
