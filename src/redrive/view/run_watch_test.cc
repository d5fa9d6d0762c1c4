// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/run_watch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive::view {
namespace {

using ::testing::HasSubstr;

class RunWatchTest : public testing::Test {
 protected:
  RunWatchTest() {
    options_.recording = REDRIVE_SAMPLES "/analytic";
    options_.method = "nerf";
    apply_preset(&options_, {});
    options_.set("width", 32);
    paths_ = create_run(folder_.path / "run", options_);
    save(1);
  }
  void save(std::int64_t step) {
    const Scene scene = make_scene(open_recording(options_), scene_options(options_));
    TrainState state = make_initial_state(options_, scene);
    state.step = step;
    save_checkpoint(paths_.checkpoint(), state);
  }

  TemporaryFolder folder_;
  TrainOptions options_;
  RunPaths paths_;
};

TEST_F(RunWatchTest, OpensANewerCheckpointOnce) {
  RunWatch watch(paths_.root);
  EXPECT_EQ(watch.run()->state.step, 1);
  EXPECT_EQ(watch.look().run, nullptr);
  save(2);
  const RunNews news = watch.look();
  ASSERT_NE(news.run, nullptr);
  EXPECT_EQ(news.run->state.step, 2);
  EXPECT_EQ(news.problem, "");
  EXPECT_EQ(watch.look().run, nullptr);
}

TEST_F(RunWatchTest, SaysThatTheRunIsGoneAndOpensItWhenItIsBack) {
  RunWatch watch(paths_.root);
  const auto elsewhere = folder_.path / "elsewhere";
  std::filesystem::rename(paths_.root, elsewhere);
  for (int i = 0; i < 2; ++i) {
    const RunNews gone = watch.look();
    EXPECT_EQ(gone.run, nullptr);
    EXPECT_THAT(gone.problem, HasSubstr(paths_.root.string() + " is gone"));
  }
  std::filesystem::rename(elsewhere, paths_.root);
  const RunNews back = watch.look();
  ASSERT_NE(back.run, nullptr);
  EXPECT_EQ(back.problem, "");
  std::filesystem::remove(paths_.checkpoint());
  EXPECT_THAT(watch.look().problem, HasSubstr("checkpoint.safetensors is gone"));
}

TEST_F(RunWatchTest, KeepsTheRunWhereTheNewerOneIsDamaged) {
  RunWatch watch(paths_.root);
  write_file(paths_.checkpoint(), "no checkpoint");
  for (int i = 0; i < 2; ++i) {
    const RunNews damaged = watch.look();
    EXPECT_EQ(damaged.run, nullptr);
    EXPECT_THAT(damaged.problem, HasSubstr("cannot be shown"));
  }
  EXPECT_EQ(watch.run()->state.step, 1);
  save(3);
  EXPECT_EQ(watch.look().run->state.step, 3);
  EXPECT_EQ(watch.look().problem, "");
}

TEST_F(RunWatchTest, RefusesAFolderWithoutARun) {
  EXPECT_THROW(RunWatch(folder_.path / "nowhere"), InputError);
}

}  // namespace
}  // namespace redrive::view
