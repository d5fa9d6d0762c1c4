// SPDX-License-Identifier: Apache-2.0
#include <algorithm>

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
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

TEST(LoadViews, ADamagedImageHasNoPixelThatIsUsed) {
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 8);
  write_file(recording.cameras[1].images[5].path, "no image");
  ThreadPool pool(4);
  const Scene scene = make_scene(recording, {});
  DamagedViews damaged;
  const std::vector<Image8> images = load_views(scene, pool, &damaged);
  std::size_t without = 0;
  for (std::size_t i = 0; i < images.size(); ++i) {
    ASSERT_EQ(images[i].rgb.size(), 3u * images[i].width * images[i].height);
    const bool none = !images[i].used.empty() &&
                      std::ranges::count(images[i].used, 0) == std::ssize(images[i].used);
    EXPECT_EQ(none, damaged.contains(scene.views[i])) << i;
    without += none;
  }
  EXPECT_EQ(without, 1u);
  const std::vector<Finding> findings = damaged.judge(recording, scene);
  ASSERT_EQ(findings.size(), 1u);
  EXPECT_EQ(findings[0].subject, "FRONT");
  EXPECT_NE(findings[0].what.find("1 of 8 records left out: frame 15: "), std::string::npos)
      << findings[0].what;
  write_file(recording.cameras[1].images[6].path, "no image");
  DamagedViews two;
  load_views(scene, pool, &two);
  EXPECT_THROW(two.judge(recording, scene), InputError);
}

}  // namespace
}  // namespace redrive
