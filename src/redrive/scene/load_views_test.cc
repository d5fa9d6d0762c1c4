// SPDX-License-Identifier: Apache-2.0
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

TEST(LoadViews, InParallelEqualsOneByOne) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 8);
  SceneOptions plain, undistorted;
  plain.downscale = 2;
  undistorted.undistort = true;
  undistorted.cameras = {"FRONT"};
  ThreadPool pool(4);
  for (const SceneOptions& options : {plain, undistorted}) {
    const Scene scene = make_scene(recording, options);
    const std::vector<Image8> images = load_views(scene, pool);
    ASSERT_EQ(images.size(), scene.views.size());
    for (std::size_t i = 0; i < images.size(); ++i)
      EXPECT_EQ(images[i].rgb, load_view(scene, scene.views[i]).rgb) << i;
  }
}

TEST(LoadViews, ChecksHeldOutImagesAndLeavesThemEmpty) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 4);
  SceneOptions options;
  options.holdout_every = 2;
  const Scene scene = make_scene(recording, options);
  ThreadPool pool(2);
  const std::vector<Image8> images = load_views(scene, pool);
  for (std::size_t i = 0; i < images.size(); ++i)
    EXPECT_EQ(images[i].rgb.empty(), scene.views[i].held_out) << i;
  write_file(scene.views[0].image, "no image");
  EXPECT_THROW(load_views(scene, pool), InputError);
}

TEST(LoadViews, ErrorsNameTheDamagedImage) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 8);
  write_file(recording.cameras[1].images[5].path, "no image");
  ThreadPool pool(4);
  const Scene scene = make_scene(recording, {});
  try {
    load_views(scene, pool);
    FAIL();
  } catch (const InputError& error) {
    EXPECT_NE(std::string(error.what()).find("FRONT_15.png"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace redrive
