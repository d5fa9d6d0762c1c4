// SPDX-License-Identifier: Apache-2.0
// Scores of images whose errors inside and beside boxes are known.
#include "redrive/eval/moving_scores.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/recording/formats/recording_reader.h"
#include "redrive/render/paint_backend_testing.h"

namespace redrive {
namespace {

constexpr int kWidth_px = 160, kHeight_px = 120;

/// A car 10 m ahead and a van far away, which both move, and a parked car.
struct FewBoxes final : RecordingReader {
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    std::vector<Box> boxes;
    for (const auto& [id, type, x, y, speed] :
         {std::tuple(7, "CAR", 10.0, 0.0, 5.0), std::tuple(9, "VAN", 44.0, 16.0, 5.0),
          std::tuple(11, "CAR", 10.0, -6.0, 0.0)}) {
      Box box{.object_id = id, .type = type, .actor_name = "", .t_ns = 100'000'000 * file.frame_id};
      box.body_from_box = Rigid3d::Identity();
      box.body_from_box.translation() = Eigen::Vector3d(x, y, 0);
      box.size_m = {4, 2, 2};
      box.velocity_in_body_m_per_s.x() = speed;
      boxes.push_back(box);
    }
    return boxes;
  }
};

class MovingScoresTest : public ::testing::Test {
 protected:
  MovingScoresTest() {
    run_.recording.reader = std::make_shared<FewBoxes>();
    RigCamera camera;
    camera.name = "CAMERA";
    Rigid3d looking = Rigid3d::Identity();  // camera z is x of the body
    looking.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    camera.camera = make_camera({"CAMERA",
                                 "opencv_pinhole",
                                 {80, 80, 79.5, 59.5, 0, 0, 0, 0, 0},
                                 kWidth_px,
                                 kHeight_px,
                                 looking});
    camera.recorded = camera.camera;
    camera.body_from_sensor = looking;
    Scene& scene = run_.scene;
    scene.rig = {camera};
    scene.global_from_world = Rigid3d::Identity();
    for (int f = 0; f < 3; ++f) {
      scene.add_frame({f, 100'000'000ll * f, Rigid3d::Identity()});
      run_.recording.frames.push_back({f, 100'000'000ll * f, Rigid3d::Identity()});
      View view;
      view.frame = f;
      scene.views.push_back(view);
      if (f < 2) run_.recording.box_files.push_back({f, "frame"});
    }
    run_.moving = read_moving_objects(run_.recording, scene);
    ground_truth_.width = kWidth_px;
    ground_truth_.height = kHeight_px;
    for (std::size_t i = 0; i < 3 * kPixels; ++i)
      ground_truth_.rgb.push_back(static_cast<std::uint8_t>(60 + 40 * (i % 7 % 3)));
  }
  /// The ground truth with an error in the pixels of an object (an index of object_map), and
  /// another elsewhere.
  RenderedImage rendered(const View& view, std::uint32_t object, float inside, float outside) {
    const auto map = object_map(run_.scene, view, run_.moving);
    RenderedImage image;
    image.width = kWidth_px;
    image.height = kHeight_px;
    image.valid.assign(kPixels, 1);
    for (std::size_t i = 0; i < 3 * kPixels; ++i)
      image.rgb.push_back(ground_truth_.rgb[i] / 255.0f +
                          (map[i / 3] == object ? inside : outside));
    return image;
  }
  std::optional<MovingEvaluation> scored(
      const std::vector<std::tuple<std::size_t, float, float>>& images) {
    MovingScores scores(run_, backend_);
    for (const auto& [v, inside, outside] : images) {
      const View& view = run_.scene.views[v];
      scores.add(run_.scene, view, full_mask(kWidth_px, kHeight_px),
                 rendered(view, 1, inside, outside), ground_truth_);
    }
    return scores.mean();
  }

  static constexpr std::size_t kPixels = std::size_t{kWidth_px} * kHeight_px;
  redrive::Run run_;
  Image8 ground_truth_;
  PaintBackend backend_{[](const auto&, const auto&) { return std::array<float, 3>{}; }};
};

double psnr_of_error(double error) { return -20 * std::log10(error); }

TEST_F(MovingScoresTest, PixelsOfBoxesAndAllOthersCountApart) {
  const auto result = scored({{0, 0.2f, 0.1f}, {1, 0.05f, 0.1f}});
  ASSERT_TRUE(result);
  const MovingEvaluation& moving = *result;
  EXPECT_NEAR(moving.outside.psnr_db, psnr_of_error(0.1), 1e-3);
  EXPECT_EQ(moving.outside.images, 2);
  // The van has too few pixels to count, the parked car does not move.
  ASSERT_EQ(moving.objects.size(), 1u);
  const MovingEvaluation::Object& car = moving.objects.at(7);
  EXPECT_EQ(car.type, "CAR");
  EXPECT_EQ(car.score.images, 2);
  EXPECT_NEAR(car.score.psnr_db, (psnr_of_error(0.2) + psnr_of_error(0.05)) / 2, 1e-3);
  EXPECT_LT(car.score.ssim, 0.99);
  EXPECT_GT(car.score.ssim, 0.2);
  // `inside` has the van's pixels, too.
  EXPECT_LT(moving.inside.psnr_db, car.score.psnr_db + 0.5);
  EXPECT_EQ(moving.inside.images, 2);
}

TEST_F(MovingScoresTest, AnObjectWithoutErrorsScoresBest) {
  const auto moving = scored({{0, 0, 0.1f}});
  ASSERT_TRUE(moving);
  EXPECT_EQ(moving->objects.at(7).score.psnr_db, kPsnrCapDb);
  EXPECT_NEAR(moving->objects.at(7).score.ssim, 1, 1e-6) << "others are black in both";
  EXPECT_LT(moving->outside.psnr_db, 21);
}

TEST_F(MovingScoresTest, MaskedPixelsDoNotCount) {
  MovingScores scores(run_, backend_);
  Mask of_camera = full_mask(kWidth_px, kHeight_px);
  for (int y = 0; y < kHeight_px; ++y)
    for (int x = 0; x < kWidth_px / 2; ++x) of_camera.used[std::size_t(y) * kWidth_px + x] = 0;
  const View& view = run_.scene.views[0];
  RenderedImage image = rendered(view, 1, 0.1f, 0.1f);
  for (std::size_t i = 0; i < kPixels; ++i)
    for (std::size_t c = 0; !of_camera.used[i] && c < 3; ++c) image.rgb[3 * i + c] = 0.9f;
  scores.add(run_.scene, view, of_camera, image, ground_truth_);
  const auto moving = scores.mean();
  ASSERT_TRUE(moving);
  EXPECT_NEAR(moving->objects.at(7).score.psnr_db, psnr_of_error(0.1), 1e-3);
}

TEST_F(MovingScoresTest, NothingWithoutAnObjectInSight) {
  run_.scene.frames[2].t_ns = 10'000'000'000;  // nothing is there by then
  EXPECT_FALSE(scored({{2, 0.1f, 0.1f}}));
}

}  // namespace
}  // namespace redrive
