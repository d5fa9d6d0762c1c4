// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/masks.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/point_cloud.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

class MasksTest : public ::testing::Test {
 protected:
  void load() {
    scene_ = make_scene(recording_, options_);
    images_ = load_views(scene_, pool_);
  }
  /// Sets a pixel in all images of a camera.
  void paint(int camera, int x0, int y0, int width, int height, std::uint8_t value) {
    for (std::size_t i = 0; i < images_.size(); ++i) {
      if (scene_.views[i].camera != camera) continue;
      Image8& image = images_[i];
      for (int y = y0; y < y0 + height; ++y)
        std::fill_n(image.rgb.begin() + 3 * (y * image.width + x0), 3 * width, value);
    }
  }
  static int used(const Mask& mask, int x, int y) {
    return mask.used[std::size_t(y) * mask.width + x];
  }

  TemporaryFolder folder_;
  Recording recording_ = make_test_recording(folder_.path);  // FISHEYE 20 x 14, FRONT 24 x 16
  SceneOptions options_;
  Scene scene_;
  std::vector<Image8> images_;
  ThreadPool pool_{2};
};

TEST_F(MasksTest, ReadsEditedMasks) {
  load();
  std::vector<Mask> masks = static_masks(scene_, images_, folder_.path, pool_, true);
  ASSERT_EQ(masks.size(), 2u);
  EXPECT_EQ(masks[1].left_out(), 0u);
  masks[1].used[3 * 24 + 5] = 0;
  write_mask(folder_.path / "FRONT.png", masks[1], scene_.rig[1], 1);
  const std::vector<Mask> again = static_masks(scene_, images_, folder_.path, pool_, true);
  EXPECT_EQ(again[0].used, masks[0].used);
  EXPECT_EQ(again[1].used, masks[1].used);
}

TEST_F(MasksTest, LoadsTheImagesItselfWithTheSameResult) {
  load();
  const std::vector<Mask> loaded = static_masks(scene_, images_, {}, pool_, true),
                          own = static_masks(scene_, ViewLoader(scene_, pool_), {}, pool_, true);
  ASSERT_EQ(own.size(), loaded.size());
  for (std::size_t c = 0; c < own.size(); ++c) EXPECT_EQ(own[c].used, loaded[c].used) << c;

  write_mask(folder_.path / "FRONT.png", full_mask(24, 16), scene_.rig[1], 1);
  const ViewLoader load(scene_, pool_);
  EXPECT_EQ(static_masks(scene_, load, folder_.path, pool_, true)[1].left_out(), 0u);
}

TEST_F(MasksTest, WritesMasksThatMaskAPixel) {
  load();
  std::vector<Mask> masks = {full_mask(20, 14), full_mask(24, 16)};
  masks[0].used[2 * 20 + 7] = 0;
  const std::filesystem::path folder = folder_.path / "masks";
  std::filesystem::create_directory(folder);
  write_masks(folder, masks, scene_);
  EXPECT_TRUE(std::filesystem::exists(folder / "FISHEYE.png"));
  EXPECT_FALSE(std::filesystem::exists(folder / "FRONT.png"));
  const std::vector<Mask> again = read_masks(folder, scene_);
  for (int c = 0; c < 2; ++c) EXPECT_EQ(again[c].used, masks[c].used) << c;
  EXPECT_EQ(read_masks(folder_.path / "none", scene_)[0].left_out(), 0u);
}

TEST_F(MasksTest, OneFileServesEverySize) {
  load();
  Mask mask = full_mask(24, 16);
  mask.used[7 * 24 + 5] = 0;  // in the block (1, 1) of 5 x 5
  const std::filesystem::path file = folder_.path / "FRONT.png";
  write_mask(file, mask, scene_.rig[1], 1);
  options_.downscale = 5;
  load();
  const Mask small = read_mask(file, scene_.rig[1], 5);
  EXPECT_EQ(small.width, 4);
  EXPECT_EQ(small.height, 3);
  EXPECT_EQ(small.left_out(), 1u);
  EXPECT_EQ(used(small, 1, 1), 0);
  write_mask(file, small, scene_.rig[1], 5);
  EXPECT_EQ(read_mask(file, scene_.rig[1], 5).used, small.used);
}

TEST_F(MasksTest, RejectsMasksOfAnotherSize) {
  load();
  write_mask(folder_.path / "FRONT.png", full_mask(20, 14), scene_.rig[0], 1);
  try {
    static_masks(scene_, images_, folder_.path, pool_, true);
    FAIL() << "not refused";
  } catch (const InputError& error) {
    EXPECT_THAT(error.what(),
                AllOf(HasSubstr("FRONT.png"), HasSubstr("20 x 14"), HasSubstr("24 x 16")));
  }
}

TEST_F(MasksTest, MasksBrokenRowsAndAMargin) {
  load();
  paint(1, 0, 13, 24, 1, 0);
  paint(1, 0, 14, 24, 2, 253);
  const Mask mask = find_static_mask(scene_, 1, images_, true);
  for (int y = 0; y < 16; ++y) EXPECT_EQ(used(mask, 7, y), y < 12) << y;
  EXPECT_EQ(find_static_mask(scene_, 1, images_, false).left_out(), 0u);
}

// A car at rest or a uniform image: all rows are alike, none is broken.
TEST_F(MasksTest, ConstantImagesHaveNoBrokenRows) {
  load();
  paint(1, 0, 0, 24, 16, 200);
  EXPECT_EQ(find_static_mask(scene_, 1, images_, true).left_out(), 0u);
}

TEST_F(MasksTest, MasksBlackCornersOfFisheyesOnly) {
  load();
  for (const int camera : {0, 1}) {
    paint(camera, 0, 0, 4, 3, 5);
    paint(camera, 9, 6, 2, 2, 5);  // also black, but in the middle
  }
  const Mask fisheye = find_static_mask(scene_, 0, images_, true);
  EXPECT_EQ(fisheye.left_out(), 5u * 4u);  // and a pixel around it
  EXPECT_EQ(used(fisheye, 0, 0), 0);
  EXPECT_EQ(used(fisheye, 9, 6), 1);
  EXPECT_EQ(find_static_mask(scene_, 1, images_, true).left_out(), 0u);
}

// The box's pixels against the projections of points all over it; both cameras, one of them exposed
// 20 ms early.
TEST_F(MasksTest, MarksPixelsOfDrawnObjects) {
  load();
  MovingObject car{.id = 3, .type = "CAR", .size_m = {2, 2, 2}, .keys = {}};
  const View& view = scene_.views[0];
  const RigCamera& rig = scene_.rig[view.camera];
  Rigid3d ahead = Rigid3d::Identity();
  ahead.translation() = scene_.world_from_camera(view) * Eigen::Vector3d(0, 0, 8);
  car.keys.push_back({scene_.frames[view.frame].t_ns, ahead, {0, 0, 0}});
  const MovingObjects objects({car});
  std::vector<Image8> images;
  for (const View& of : scene_.views) {
    const Camera& camera = scene_.rig[of.camera].camera;
    const std::size_t n = static_cast<std::size_t>(camera.width) * camera.height;
    images.push_back({camera.width, camera.height, std::vector<std::uint8_t>(3 * n)});
  }
  const Eigen::Vector2d at = *rig.camera.project({0, 0, 8});
  const auto middle = static_cast<std::size_t>(std::lround(at.y())) * rig.camera.width +
                      static_cast<std::size_t>(std::lround(at.x()));
  images[0].used.assign(images[0].rgb.size() / 3, 255);
  images[0].used[middle + 1] = 0;
  ThreadPool pool(2);
  mark_objects(scene_, objects, pool, &images);
  EXPECT_EQ(images[0].used[middle], kMovingPixel);
  EXPECT_EQ(images[0].used[middle + 1], 0) << "masked pixels stay so";
  EXPECT_EQ(images[0].used[0], 255);
  EXPECT_FALSE(static_pixel(images[0], at));
  EXPECT_TRUE(visible_pixel(images[0], at));
  EXPECT_TRUE(images.back().used.empty()) << "the object is not there yet";
}

TEST_F(MasksTest, MasksMovingObjectsAtEachImagesTime) {
  recording_.cameras[0].calibration.time_offset_ns = -20'000'000;
  load();
  std::vector<Box> boxes;
  for (const FramePose& frame : recording_.frames) {
    Box box;
    box.t_ns = frame.t_ns;
    box.body_from_box = Rigid3d(Eigen::Translation3d(7, 3.5, 0.8));
    box.size_m = Eigen::Vector3d(4, 2, 1.6);
    box.velocity_in_body_m_per_s =
        Eigen::Vector3d(0.5, 0, 0);  // so that it moves with the ego vehicle
    boxes.push_back(box);
  }
  const MovingObjects moving(boxes, recording_.frames, scene_.global_from_world);
  ASSERT_EQ(moving.objects().size(), 1u);
  const std::vector<Mask> whole = {full_mask(20, 14), full_mask(24, 16)};
  scene_.views[5].held_out = true;
  apply_masks(scene_, whole, moving, pool_, &images_);
  ASSERT_EQ(scene_.views.size(), 12u);
  for (std::size_t i = 0; i < scene_.views.size(); ++i) {
    const View& view = scene_.views[i];
    const Mask mask = view_mask(scene_, view, whole[view.camera], moving);
    for (std::size_t k = 0; k < mask.used.size() && !view.held_out; ++k)
      ASSERT_EQ(images_[i].used[k] != 0, mask.used[k] != 0) << i;
    const RigCamera& rig = scene_.rig[view.camera];
    const Rigid3d camera_from_world = scene_.world_from_camera(view).inverse();
    const MovingBox box = moving.at(scene_.frames[view.frame].t_ns + rig.time_offset_ns)[0];
    Mask expected = whole[view.camera];
    constexpr int kSteps = 60;
    for (int a = 0; a <= kSteps; ++a)
      for (int b = 0; b <= kSteps; ++b)
        for (int face = 0; face < 6; ++face) {
          Eigen::Vector3d p(2.0 * a / kSteps - 1, 2.0 * b / kSteps - 1, face % 2 ? 1 : -1);
          p = Eigen::Vector3d(p[face / 2], p[(face / 2 + 1) % 3], p[(face / 2 + 2) % 3])
                  .cwiseProduct(box.half_size_m);
          const auto at =
              rig.camera.project(camera_from_world * (box.box_from_world.inverse() * p));
          // A pixel is masked if its centre is in the box, so only points next to a centre are
          // compared.
          if (!at || (*at - at->array().round().matrix()).norm() > 0.1) continue;
          const int x = static_cast<int>(std::lround(at->x())),
                    y = static_cast<int>(std::lround(at->y()));
          if (x >= 0 && y >= 0 && x < expected.width && y < expected.height)
            expected.used[std::size_t(y) * expected.width + x] = 0;
        }
    EXPECT_GT(mask.left_out(), 3u) << i;
    EXPECT_LT(mask.left_out(), mask.used.size() * 3 / 4) << i;
    // Points near a centre may lie just outside the outline; all others have to agree.
    std::size_t differ = 0;
    for (std::size_t k = 0; k < expected.used.size(); ++k)
      differ += expected.used[k] != mask.used[k];
    EXPECT_LE(differ, 2u) << i;
  }
}

TEST_F(MasksTest, DoesNotMaskParkedObjects) {
  load();
  const std::vector<Mask> whole = {full_mask(20, 14), full_mask(24, 16)};
  const MovingObjects moving({}, recording_.frames, scene_.global_from_world);
  for (const View& view : scene_.views)
    EXPECT_EQ(view_mask(scene_, view, whole[view.camera], moving).left_out(), 0u);
  apply_masks(scene_, whole, moving, pool_, &images_);
  for (const Image8& image : images_) EXPECT_TRUE(image.used.empty());
}

TEST_F(MasksTest, CombinesMasks) {
  Image8 image{3, 1, std::vector<std::uint8_t>(9, 7)};
  apply_mask(full_mask(3, 1), &image);
  EXPECT_TRUE(image.used.empty());
  Mask mask = full_mask(3, 1);
  mask.used[1] = 0;
  apply_mask(mask, &image);
  EXPECT_EQ(image.used, (std::vector<std::uint8_t>{255, 0, 255}));
  image.used[0] = 0;
  apply_mask(mask, &image);
  EXPECT_EQ(image.used, (std::vector<std::uint8_t>{0, 0, 255}));
}

TEST_F(MasksTest, OverlayTintsMaskedPixels) {
  Image8 image{2, 1, {10, 20, 30, 10, 20, 30}};
  Mask mask = full_mask(2, 1);
  mask.used[1] = 0;
  EXPECT_EQ(overlay(image, mask).rgb, (std::vector<std::uint8_t>{10, 20, 30, 132, 10, 15}));
}

}  // namespace
}  // namespace redrive
