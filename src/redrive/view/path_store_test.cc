// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/path_store.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/scene/scene_testing.h"

namespace redrive::view {
namespace {

namespace fs = std::filesystem;

class PathStoreTest : public testing::Test {
 protected:
  PathStoreTest() {
    run_.recording = make_test_recording(folder_.path, 3);
    run_.scene = make_scene(run_.recording, {});
    run_.paths.root = folder_.path / "run";
    fs::create_directory(run_.paths.root);
    message_.fps = 10;
    message_.keyframes = {{0, "FRONT", 10, {0, 0, 0}, 0, 0}, {1, "FRONT", 12, {0, 1, 0}, 30, 0}};
    message_.save = {"left", false};
  }
  TemporaryFolder folder_;
  redrive::Run run_;
  const PathStore store_{run_};
  PathMessage message_;
};

TEST_F(PathStoreTest, SavesWhatRenderAndOthersRead) {
  EXPECT_TRUE(store_.names().empty());
  store_.save(message_);
  EXPECT_EQ(store_.names(), std::vector<std::string>{"left"});
  const fs::path file = run_.paths.root / "paths/left.json";
  const CameraPath path = path_of_file(read_camera_path(file), run_.scene);
  EXPECT_EQ(path.camera, "FRONT");
  EXPECT_EQ(path.images(), 10);
  // Without our keys it is the same path.
  nlohmann::json theirs = read_json(file);
  theirs.erase("keyframes");
  const CameraPath same = path_of_file(parse_camera_path(theirs.dump(), file), run_.scene);
  ASSERT_EQ(same.images(), 10);
  for (int i = 0; i < 10; ++i)
    EXPECT_TRUE(
        same.at_image(i).world_from_camera.isApprox(path.at_image(i).world_from_camera, 1e-12))
        << i;
  // FRONT is 16 pixels high with f = 20.
  EXPECT_NEAR(same.at_image(3).fov_deg, 2 * std::atan(8.0 / 20) * 180 / M_PI, 1e-12);
  const nlohmann::json loaded = store_.load("left");
  EXPECT_EQ(loaded["fps"], 10);
  EXPECT_EQ(loaded["keyframes"][1]["yaw_deg"], 30);
}

TEST_F(PathStoreTest, OverwritesOnlyWhenAsked) {
  store_.save(message_);
  const std::string before = read_file(run_.paths.root / "paths/left.json");
  message_.fps = 20;
  EXPECT_THROW(store_.save(message_), InputError);
  EXPECT_EQ(read_file(run_.paths.root / "paths/left.json"), before);
  message_.save->overwrite = true;
  store_.save(message_);
  EXPECT_EQ(store_.load("left")["fps"], 20);
}

TEST_F(PathStoreTest, RefusesAPathOfTooManyImages) {
  message_.keyframes[1].time_s = 1000;
  message_.fps = 20;
  store_.save(message_);
  message_.fps = 20.1;
  message_.save->overwrite = true;
  try {
    store_.save(message_);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("more than 20000 images"));
  }
  EXPECT_EQ(store_.load("left")["fps"], 20);
}

TEST_F(PathStoreTest, SavesAHundredPathsOfARun) {
  for (int i = 0; i < 100; ++i) {
    message_.save->name = "path" + std::to_string(i);
    store_.save(message_);
  }
  message_.save->name = "more";
  try {
    store_.save(message_);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("has 100 paths"));
  }
  EXPECT_EQ(store_.names().size(), 100u);
  message_.save = {"path7", true};
  store_.save(message_);
  fs::remove(run_.paths.root / "paths/path7.json");
  message_.save = {"more", false};
  store_.save(message_);
  EXPECT_EQ(store_.names().front(), "more");
}

TEST_F(PathStoreTest, RefusesWhatTheRunDoesNotHave) {
  EXPECT_THROW(store_.load("left"), InputError);
  message_.keyframes[1].frame_id = 99;
  try {
    store_.save(message_);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("keyframes[1].frame_id = 99"));
  }
  EXPECT_FALSE(fs::exists(run_.paths.root / "paths"));
}

}  // namespace
}  // namespace redrive::view
