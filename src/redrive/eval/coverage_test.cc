// SPDX-License-Identifier: Apache-2.0
// Coverage in a scene of two parallel walls, whose geometry follows by hand.
#include "redrive/eval/coverage.h"

#include <gtest/gtest.h>

#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/perception/masks.h"
#include "redrive/render/paint_backend_testing.h"

namespace redrive {
namespace {

constexpr int kColumns = 41, kRows = 11;

/// Looks along z; columns -20..20 see x / z from -1 to 1. `finer`: pixels per column and row of
/// these.
Camera front_camera(int finer = 1) {
  CameraCalibration calibration;
  calibration.model = "opencv_pinhole";
  calibration.parameters = {
      20.0 * finer, 20.0 * finer, 20.5 * finer - 0.5, 5.5 * finer - 0.5, 0, 0, 0, 0, 0};
  calibration.width = kColumns * finer;
  calibration.height = kRows * finer;
  return make_camera(calibration);
}

/// A wall at z = 10 and in front of it, at z = 5, a board over x in [-1, 1].
float range_to_walls(const std::array<float, 3>& origin, const std::array<float, 3>& direction) {
  const float to_board = (5 - origin[2]) / direction[2], to_wall = (10 - origin[2]) / direction[2];
  return std::abs(origin[0] + to_board * direction[0]) <= 1 ? to_board : to_wall;
}

class CoverageTest : public testing::Test {
 protected:
  CoverageTest() {
    run_.scene.rig = {{"A", front_camera(), front_camera(), Rigid3d::Identity()}};
    run_.scene.add_frame({0, 0, Rigid3d::Identity()});
    run_.scene.views = {{0, 0, "", false}};  // at the origin
    run_.scene.far_m = 100;
    auto own = std::make_unique<NerfModel>();
    NerfModel& model = *own;
    run_.state.model = std::move(own);
    model.config.width = 32;
    model.samples = 4;
    model.near_m = 1;
    model.far_m = 100;
    model.parameters = Buffer<float>(nerf_parameter_count(model.config));
  }

  /// Returns the middle row of the coverage, seen from x_m.
  std::vector<std::uint8_t> seen_from(double x_m) {
    const Rigid3d pose(Eigen::Translation3d(x_m, 0, 0));
    const RenderedImage image = render_image(walls_, *run_.state.model, front_camera(), pose);
    const auto seen = Coverage(run_, walls_).seen(front_camera(), pose, image);
    return {seen.begin() + 5 * kColumns, seen.begin() + 6 * kColumns};
  }

  /// Masks the columns below `first` of the run's camera.
  void mask_below(int first) {
    const RigCamera& rig = run_.scene.rig[0];
    Mask mask = full_mask(rig.camera.width, rig.camera.height);
    for (std::size_t i = 0; i < mask.used.size(); ++i)
      mask.used[i] = static_cast<int>(i) % mask.width >= first;
    run_.paths.root = folder_.path;
    std::filesystem::create_directory(run_.paths.masks());
    write_mask(mask_file(run_.paths.masks(), rig), mask, rig, 1);
  }

  TemporaryFolder folder_;
  redrive::Run run_;
  PaintBackend walls_{[](const auto&, const auto&) { return std::array<float, 3>{}; },
                      range_to_walls};
};

TEST_F(CoverageTest, ATrainingViewIsFullyCovered) {
  EXPECT_EQ(seen_from(0), std::vector<std::uint8_t>(kColumns, 1));
}

// From 2 m to the right, column c (x / z = (c - 20) / 20) meets the board (x in [-1, 1] at 5 m) in
// columns 8 to 16. The wall is seen at x = 2 + (c - 20) / 2. The board occludes x in [-2, 2] from
// the origin, columns 17 to 20 (12 to 16 are occluded here, too). x > 10 lies outside the training
// image, columns 37 to 40.
TEST_F(CoverageTest, OccludedAndOutsidePixelsAreNotSeen) {
  const std::vector<std::uint8_t> seen = seen_from(2);
  for (int c = 0; c < kColumns; ++c) {
    if (c == 20 || c == 36) continue;  // on the edge of a pixel
    const bool hidden = c >= 17 && c<20, outside = c> 36;
    EXPECT_EQ(seen[c], hidden || outside ? 0 : 1) << c;
  }
}

TEST_F(CoverageTest, ViewsAreRenderedOneByOneToo) {
  Rigid3d pose = Rigid3d::Identity();
  const RenderedImage image = render_image(walls_, *run_.state.model, front_camera(), pose);
  Coverage coverage(run_, walls_, /*at_once=*/false);
  EXPECT_EQ(coverage.seen_share(front_camera(), pose, image), 0);
  while (coverage.step()) {
  }
  EXPECT_EQ(coverage.seen_share(front_camera(), pose, image), 1);
  EXPECT_EQ(coverage.seen(front_camera(), pose, image),
            Coverage(run_, walls_).seen(front_camera(), pose, image));
}

TEST_F(CoverageTest, MaskedPixelsAreNotSeen) {
  mask_below(10);
  std::vector<std::uint8_t> right(kColumns, 1);
  std::fill_n(right.begin(), 10, 0);
  EXPECT_EQ(seen_from(0), right);

  run_.options.masks = "none";
  EXPECT_EQ(seen_from(0), std::vector<std::uint8_t>(kColumns, 1));
}

// From 5 m to the left the same points of the wall lie ten columns further right.
TEST_F(CoverageTest, AnotherViewSeesMaskedPixels) {
  mask_below(10);
  run_.scene.views.push_back({0, 0, "", false, {}, Rigid3d(Eigen::Translation3d(-5, 0, 0))});
  EXPECT_EQ(seen_from(0), std::vector<std::uint8_t>(kColumns, 1));
}

// 164 columns, with depth rendered at every other one: each depth stands for two columns of the
// mask.
TEST_F(CoverageTest, MasksHaveTheSizeOfTheFullImage) {
  run_.scene.rig[0].camera = run_.scene.rig[0].recorded = front_camera(4);
  mask_below(40);
  std::vector<std::uint8_t> right(kColumns, 1);
  std::fill_n(right.begin(), 10, 0);
  EXPECT_EQ(seen_from(0), right);
}

// The board hides the middle of the wall from the origin, not from 5 m to the left.
TEST_F(CoverageTest, FindsTheTrainingImagesThatSawAPoint) {
  run_.scene.views.push_back({0, 0, "", false, {}, Rigid3d(Eigen::Translation3d(-5, 0, 0))});
  run_.scene.views.push_back({0, 0, "", true, {}, Rigid3d(Eigen::Translation3d(-5, 0, 0))});
  PointObservers observers(run_, walls_);
  EXPECT_EQ(observers.training_views(), 2u);
  const auto seen_by = [&](double x_m, double z_m) {
    PointSearch search = observers.begin({x_m, 0, z_m});
    while (observers.step(&search)) {
    }
    return search.seen_by;
  };
  const View *origin = &run_.scene.views[0], *left = &run_.scene.views[1];
  EXPECT_EQ(seen_by(0, 10), std::vector<const View*>{left});
  EXPECT_EQ(seen_by(0, 5), (std::vector<const View*>{origin, left}));  // the board: nearest first
  EXPECT_EQ(seen_by(-3, 10), (std::vector<const View*>{left, origin}));
  EXPECT_EQ(seen_by(8, 10), std::vector<const View*>{origin});  // outside the other image
  EXPECT_EQ(seen_by(0, -10), std::vector<const View*>{});
}

// A car of 1 x 1 x 1 m that stands 3 m to the left of the board in the training image has moved 2 m
// to the right: its surface, which was seen, lies where the board's shadow is now.
TEST_F(CoverageTest, ASurfaceOfAnObjectIsSoughtWhereTheObjectWas) {
  MovingObject car{.id = 7, .type = "CAR", .size_m = {1, 1, 1}, .keys = {}};
  Rigid3d pose = Rigid3d::Identity();
  pose.translation() = Eigen::Vector3d(-4, 0, 10);
  car.keys = {{0, pose, Eigen::Vector3d::Zero()}};
  run_.scene.actors = {car};
  const Coverage coverage(run_, walls_);
  const auto middle_row = [&](double car_x_m) {
    Scene scene = run_.scene;
    scene.actors[0].keys[0].world_from_box.translation().x() = car_x_m;
    View view = scene.views[0];
    view.motion = Rigid3d(Eigen::Translation3d(2, 0, 0));
    const ShutterPoses poses = scene.shutter_poses(view);
    const RenderedImage image = render_image(walls_, *run_.state.model, front_camera(), poses);
    const auto seen = coverage.seen(front_camera(), poses, image);
    return std::vector<std::uint8_t>(seen.begin() + 5 * kColumns, seen.begin() + 6 * kColumns);
  };
  // Column 18 has x = 1 on the wall, which the board hides from the origin.
  EXPECT_EQ(middle_row(1)[18], 1) << "the car's middle, at x = -4 when it was seen";
  EXPECT_EQ(middle_row(-4)[18], 0);
}

}  // namespace
}  // namespace redrive
