// SPDX-License-Identifier: Apache-2.0
// Evaluation of a run whose rendered image is a formula, so that the scores follow by hand.
#include "redrive/eval/evaluate.h"
#include "redrive/image/image_io.h"

#include <cmath>
#include <fstream>
#include <numbers>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/eval/edited_score.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/perception/masks.h"
#include "redrive/render/paint_backend_testing.h"

namespace redrive {
namespace {

constexpr int kWidth = 24, kHeight = 16;

/// Two pinhole cameras, four frames 1 m apart, images of constant grey: 51 * frame (steps of 0.2)
/// in camera A, 255 in B.
class EvaluateTest : public testing::Test {
 protected:
  EvaluateTest() {
    std::filesystem::create_directories(folder_ / "novel" / "aside");
    CameraCalibration calibration;
    calibration.model = "opencv_pinhole";
    calibration.parameters = {20, 20, 11.5, 7.5, 0, 0, 0, 0, 0};
    calibration.width = kWidth;
    calibration.height = kHeight;
    calibration.body_from_sensor = Rigid3d::Identity();
    Scene& scene = run_.scene;
    scene.global_from_world = Rigid3d::Identity();
    for (const char* name : {"A", "B"})
      scene.rig.push_back(
          {name, make_camera(calibration), make_camera(calibration), calibration.body_from_sensor});
    for (int f = 0; f < 4; ++f) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation().x() = f;
      scene.add_frame({100 + f, f, pose});
      run_.recording.frames.push_back({100 + f, f, pose});
    }
    for (int c = 0; c < 2; ++c)
      for (int f = 0; f < 4; ++f)
        scene.views.push_back(
            {c,
             f,
             grey(scene.rig[c].name + std::to_string(f) + ".png", c == 0 ? 51 * f : 255),
             false,
             {}});
    auto own = std::make_unique<NerfModel>();
    NerfModel& model = *own;
    run_.state.model = std::move(own);
    model.config.width = 32;
    model.samples = 4;
    model.near_m = 1;
    model.far_m = 10;
    model.parameters = Buffer<float>(nerf_parameter_count(model.config));
  }

  std::filesystem::path grey(const std::string& name, int value, int width = kWidth,
                             int height = kHeight) {
    const std::filesystem::path path = folder_ / name;
    write_image(path,
                {width, height,
                 std::vector<std::uint8_t>(3 * width * height, static_cast<std::uint8_t>(value))});
    return path;
  }
  void poses(const std::string& text) {
    run_.recording.novel = {{"aside", folder_ / "novel" / "aside" / "poses.json"}};
    std::ofstream(folder_ / "novel" / "aside" / "poses.json") << text;
  }

  const TemporaryFolder temporary_;
  const std::filesystem::path folder_ = temporary_.path;
  redrive::Run run_;
  PaintBackend black_{[](const auto&, const auto&) { return std::array<float, 3>{0, 0, 0}; }};
};

double psnr_of(double error) { return -20 * std::log10(error); }

// Greys come from bytes as float: 51 / 255 is 0.2 within 1e-8, that is 4e-7 dB of its PSNR.
constexpr double kTolerance = 1e-6;

TEST_F(EvaluateTest, AveragesOverHeldOutViewsOnly) {
  for (View& view : run_.scene.views) view.held_out = view.frame == 1 || view.frame == 3;
  std::vector<std::pair<int, double>> scored;  // frames of camera A
  EvalOptions options;
  options.scored = [&](const View& view, const Score& score) {
    if (view.camera == 0) scored.emplace_back(view.frame, score.psnr_db);
  };
  const Evaluation result = evaluate(run_, black_, options);
  EXPECT_TRUE(result.held_out);
  ASSERT_EQ(scored.size(), 2u);
  EXPECT_EQ(scored[1].first, 3);
  EXPECT_NEAR(scored[1].second, psnr_of(0.6), kTolerance);
  EXPECT_EQ(result.cameras.at("A").images, 2);
  EXPECT_NEAR(result.cameras.at("A").psnr_db, (psnr_of(0.2) + psnr_of(0.6)) / 2, kTolerance);
  EXPECT_NEAR(result.cameras.at("B").psnr_db, 0, kTolerance);
  EXPECT_EQ(result.overall.images, 4);
  EXPECT_NEAR(result.overall.psnr_db, (psnr_of(0.2) + psnr_of(0.6)) / 4, kTolerance);
  EXPECT_NEAR(result.overall.luma_psnr_db, result.overall.psnr_db, kTolerance);  // greys
  EXPECT_NEAR(result.cameras.at("A").channel_psnr_db[2], result.cameras.at("A").psnr_db,
              kTolerance);
  // Constant images of 0 and m: C1 / (m^2 + C1).
  EXPECT_NEAR(result.cameras.at("A").ssim, (1e-4 / (0.04 + 1e-4) + 1e-4 / (0.36 + 1e-4)) / 2, 1e-9);
  EXPECT_TRUE(result.novel.empty());
}

TEST_F(EvaluateTest, ScoresTrainingViewsWhereNoneIsHeldOut) {
  EvalOptions options;
  options.max_images = 1;  // the middle one: frame 2
  const Evaluation result = evaluate(run_, black_, options);
  EXPECT_FALSE(result.held_out);
  EXPECT_EQ(result.cameras.at("A").images, 1);
  EXPECT_NEAR(result.cameras.at("A").psnr_db, psnr_of(0.4), kTolerance);
  options.all = true;
  const Evaluation all = evaluate(run_, black_, options);
  EXPECT_EQ(all.overall.images, 8);
  // Frame 0 of camera A is black: equal, so infinite, so capped.
  EXPECT_NEAR(all.cameras.at("A").psnr_db,
              (kPsnrCapDb + psnr_of(0.2) + psnr_of(0.4) + psnr_of(0.6)) / 4, kTolerance);
}

// Eval writes the pose corrections of the checkpoint.
TEST_F(EvaluateTest, ReportsThePoseCorrections) {
  EXPECT_FALSE(evaluate(run_, black_).pose_changes.has_value());
  run_.state.poses = PoseState(run_.scene);
  PoseCorrections& corrections = run_.state.poses.corrections;
  corrections.values[corrections.frame_slot(3) + 1] = 0.25f;
  corrections.values[corrections.time_slot(1)] = -0.03125f;
  const auto changes = evaluate(run_, black_).pose_changes;
  ASSERT_TRUE(changes.has_value());
  EXPECT_EQ(changes->frames.at(3).translation_m, Eigen::Vector3d(0, 0.25, 0));
  EXPECT_EQ(changes->translation_m, 0.125);
  EXPECT_EQ(changes->cameras.at(1).time_offset_s, -0.03125);
}

TEST_F(EvaluateTest, ScoresNovelViewsThatHaveGroundTruthAtTheirPoses) {
  // Frame 102 (x = 2) shifted by 0.5: a backend that paints the origin's x / 5 shows 0.5 there.
  PaintBackend place([](const auto& origin, const auto&) {
    return std::array<float, 3>{origin[0] / 5, origin[0] / 5, origin[0] / 5};
  });
  poses(
      R"({"images": [{"file": "a.png", "camera": "A", "frame_id": 102, "shift_body_m": [0.5, 0, 0]},
                       {"file": "none.png", "camera": "A", "frame_id": 101,
                         "shift_body_m": [0, 0, 0]},
                       {"file": "other.png", "camera": "UNTRAINED", "frame_id": 101,
                         "shift_body_m": [0, 0, 0]}]})");
  grey("novel/aside/a.png", 51);  // 0.2: off by 0.3
  grey("novel/aside/other.png", 51);
  EvalOptions options;
  options.max_images = 1;
  const Evaluation result = evaluate(run_, place, options);
  ASSERT_EQ(result.novel.count("aside"), 1u);
  EXPECT_EQ(result.novel.at("aside").images, 1);
  EXPECT_NEAR(result.novel.at("aside").psnr_db, psnr_of(0.3), kTolerance);
  EXPECT_EQ(result.overall.images, 2) << "novel views are not part of the overall score";
}

TEST_F(EvaluateTest, RejectsNovelGroundTruthOfAnotherSize) {
  poses(
      R"({"images": [{"file": "a.png", "camera": "A", "frame_id": 102,
          "shift_body_m": [0, 0, 0]}]})");
  grey("novel/aside/a.png", 51, kWidth + 1, kHeight);
  EXPECT_THROW(evaluate(run_, black_), InputError);
}

// Camera A at frame 2 is 0.4 grey; the backend paints its left half black, which the mask excludes.
TEST_F(EvaluateTest, IgnoresPixelsMaskedInTheImage) {
  Image8 mask{kWidth, kHeight, std::vector<std::uint8_t>(3 * kWidth * kHeight, 0)};
  for (int i = 0; i < kWidth * kHeight; ++i)
    if (i % kWidth >= kWidth / 2) mask.rgb[3 * i] = 255;
  write_image(folder_ / "mask.png", mask);
  for (View& view : run_.scene.views) {
    view.held_out = view.camera == 0 && view.frame == 2;
    view.mask = {folder_ / "mask.png", true};
  }
  PaintBackend half([](const auto&, const auto& direction) {
    const float value = direction[0] > 0 ? 0.3f : 0.0f;
    return std::array<float, 3>{value, value, value};
  });
  EXPECT_NEAR(evaluate(run_, half).overall.psnr_db, psnr_of(0.1), 1e-4);
}

// The images are 0.4 grey and the masked part of camera A is white: it affects neither PSNR nor
// windows at its edge.
TEST_F(EvaluateTest, IgnoresPixelsMaskedByTheRun) {
  run_.paths.root = folder_;
  std::filesystem::create_directory(run_.paths.masks());
  Image8 image{kWidth, kHeight, std::vector<std::uint8_t>(3 * kWidth * kHeight, 102)};
  Mask mask = full_mask(kWidth, kHeight);
  for (int i = 0; i < kWidth * kHeight; ++i)
    if (i % kWidth >= 16) std::fill_n(&image.rgb[3 * i], 3, std::uint8_t(255)), mask.used[i] = 0;
  write_image(folder_ / "A2.png", image);
  for (View& view : run_.scene.views) view.held_out = view.frame == 2;
  PaintBackend left_part([](const auto&, const auto& direction) {
    const float value = direction[0] > (15.5f - 11.5f) / 20 * direction[2] ? 0.0f : 0.4f;
    return std::array<float, 3>{value, value, value};
  });
  const Score seen = evaluate(run_, left_part).cameras.at("A");
  EXPECT_EQ(seen.left_out, 0);
  EXPECT_NEAR(seen.psnr_db, -10 * std::log10(1.0 / 3), 1e-4);
  EXPECT_LT(seen.ssim, 0.9);

  write_mask(mask_file(run_.paths.masks(), run_.scene.rig[0]), mask, run_.scene.rig[0], 1);
  const Evaluation masked = evaluate(run_, left_part);
  EXPECT_EQ(masked.cameras.at("A").left_out, 8 * kHeight);
  EXPECT_EQ(masked.cameras.at("B").left_out, 0);
  EXPECT_EQ(masked.overall.left_out, 8 * kHeight);
  EXPECT_GT(masked.cameras.at("A").psnr_db, 90);
  EXPECT_NEAR(masked.cameras.at("A").ssim, 1, 1e-6);
  EXPECT_NEAR(masked.cameras.at("A").flip, 0, 1e-3);

  run_.options.masks = "none";
  EXPECT_EQ(evaluate(run_, left_part).cameras.at("A").psnr_db, seen.psnr_db);
}

// A run that undistorts has pinhole cameras only; a set's calibration may still hold a fisheye.
TEST_F(EvaluateTest, UndistortsAFisheyeOfTheNovelSet) {
  const std::string rest = R"("focal_length_px": [20, 20], "principal_point_px": [11.5, 7.5],
      "image_resolution_px": [24, 16], "distortion_coeffs": [0, 0, 0, 0, 0],
      "RT_body_from_sensor": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]})";
  poses(R"({"calibration": {"A": {"model": "opencv_pinhole", )" + rest +
        R"(, "FISH": {"model": "mei", "xi": 1, )" + rest + R"(},
            "images": [{"file": "a.png", "camera": "A", "frame_id": 102,
              "shift_body_m": [0, 0, 0]}]})");
  grey("novel/aside/a.png", 51);
  run_.scene.undistort = true;
  EXPECT_NEAR(evaluate(run_, black_).novel.at("aside").psnr_db, psnr_of(0.2), kTolerance);
}

TEST_F(EvaluateTest, AMissingImageIsLeftOutAndNamed) {
  std::filesystem::remove(folder_ / "A1.png");
  const Evaluation result = evaluate(run_, black_);
  ASSERT_EQ(result.damaged.size(), 1u);
  EXPECT_THAT(result.damaged[0].what, testing::HasSubstr("A1.png"));
}

// The backend renders depth 2 m everywhere. Two thirds of the known depths are 2.5 m, so the median
// error is 0.5 / 2.5. Values 0 and 65535 mm mean unknown.
TEST_F(EvaluateTest, DepthErrorIsTheMedianWhereGroundTruthIsKnown) {
  poses(R"({"images": [{"file": "a.png", "camera": "A", "frame_id": 102, "shift_body_m": [0, 0, 0]},
                       {"file": "b.png", "camera": "A", "frame_id": 102,
                         "shift_body_m": [0, 0, 0]}]})");
  grey("novel/aside/a.png", 0);
  grey("novel/aside/b.png", 0);
  std::vector<std::uint16_t> depth_mm(kWidth * kHeight);
  for (int i = 0; i < kWidth * kHeight; ++i) {
    constexpr std::uint16_t kValues[] = {0, 65535, 2500, 2500, 1000};
    depth_mm[i] = kValues[i % 5];
  }
  write_png16(folder_ / "novel/aside/a_depth.png", {kWidth, kHeight, depth_mm});
  const Evaluation result = evaluate(run_, black_);
  EXPECT_NEAR(result.novel.at("aside").depth_error, 0.2, 1e-6)
      << "b.png has no depth: only a.png counts";
  EXPECT_TRUE(std::isnan(result.overall.depth_error));
  write_png16(folder_ / "novel/aside/b_depth.png", {1, 1, {7}});
  EXPECT_THROW(evaluate(run_, black_), InputError) << "of another size";
}

// The run's poses are the ground truth rotated by a quarter turn about z and translated: evaluation
// transforms ground-truth poses to the run's.
TEST_F(EvaluateTest, TransformsGroundTruthPosesByTheAlignment) {
  Rigid3d true_from_run = Rigid3d::Identity();
  true_from_run.translation() = Eigen::Vector3d(7, 8, 9);
  true_from_run.linear() << 0, -1, 0, 1, 0, 0, 0, 0, 1;
  for (const FramePose& frame : run_.recording.frames)
    run_.recording.ground_truth_frames.push_back(
        {frame.id, frame.t_ns, true_from_run * frame.global_from_body});
  // The ground-truth pose of x = 2.5 in the run: (7, 8 + 2.5, 9), rotated.
  poses(R"({"images": [{"file": "a.png", "camera": "A", "frame_id": 102,
                        "RT_ECEF_body": [[0, -1, 0, 7], [1, 0, 0, 10.5], [0, 0, 1, 9],
                          [0, 0, 0, 1]]}]})");
  grey("novel/aside/a.png", 51);  // 0.2
  PaintBackend place([](const auto& origin, const auto&) {
    return std::array<float, 3>{origin[0] / 5, origin[0] / 5, origin[0] / 5};
  });
  const Evaluation result = evaluate(run_, place);
  EXPECT_NEAR(result.novel.at("aside").psnr_db, psnr_of(0.3), 1e-4);
  ASSERT_TRUE(result.alignment.has_value());
  EXPECT_NEAR(result.alignment->rotation_deg, 90, 1e-6);
  EXPECT_LT(result.alignment->residual_m, 1e-6);
}

TEST(EvaluationJson, HasTheDocumentedKeys) {
  Evaluation evaluation;
  evaluation.held_out = false;
  const Score three{.psnr_db = 20.5,
                    .luma_psnr_db = 22,
                    .channel_psnr_db = {20, 20.25, 20.75},
                    .ssim = 0.5,
                    .flip = 0.25,
                    .depth_error = std::nan(""),
                    .images = 3};
  Score camera = three, inside = three, car = three;
  camera.ssim = std::nan("");
  camera.depth_error = 0.125;
  camera.left_out = 7;
  camera.pixels = 80;
  camera.scored = 20;
  inside.psnr_db = 24;
  car.psnr_db = 25;
  evaluation.overall = three;
  evaluation.cameras["F_CAM"] = camera;
  evaluation.view_alignment = ViewAlignment{8, 0.25, 0.5};
  evaluation.alignment = TrajectoryRegistration{Rigid3d::Identity(), 5, 0.5, 0.25, 0.125, 1};
  EXPECT_TRUE(
      nlohmann::json::parse(evaluation_to_json(evaluation).dump()).at("pose_changes").is_null());
  const PoseChange change{{0.5, -0.25, 2}, {0, std::numbers::pi / 2, 0}, true};
  evaluation.pose_changes =
      PoseChanges{{change, {}}, {{"F_CAM", change, 0.125}}, 0.75, std::numbers::pi};
  EXPECT_TRUE(nlohmann::json::parse(evaluation_to_json(evaluation).dump()).at("moving").is_null());
  EXPECT_TRUE(nlohmann::json::parse(evaluation_to_json(evaluation).dump()).at("lidar").is_null());
  evaluation.moving = MovingEvaluation{inside, three, {{-7, {"CAR", car}}}};
  evaluation.lidar =
      LidarScore{{100, 0.25, 0.375, 0.75, 0.5},     2, 0.125, 0.0625, LostRayScore{20, 0.75, 0.5},
                 RangeScore{7, 0.5, 0.625, 1, 0.25}};
  evaluation.lidars["up"] = evaluation.novel_lidar["aside"] =
      LidarScore{{9, std::nan(""), std::nan(""), 0, 0}, 1, 0.5};
  const auto json = nlohmann::json::parse(evaluation_to_json(evaluation).dump());
  EXPECT_EQ(json, nlohmann::json::parse(R"({
    "overall": {"psnr_db": 20.5, "luma_psnr_db": 22, "channel_psnr_db": [20, 20.25, 20.75],
      "ssim": 0.5, "flip": 0.25, "depth_error": null, "images": 3,
      "masked_pixels": 0, "scored_share": 1},
    "cameras": {"F_CAM": {"psnr_db": 20.5, "luma_psnr_db": 22,
      "channel_psnr_db": [20, 20.25, 20.75], "ssim": null, "flip": 0.25, "depth_error": 0.125,
      "images": 3, "masked_pixels": 7, "scored_share": 0.25}},
    "moving": {
      "inside": {"psnr_db": 24, "luma_psnr_db": 22, "channel_psnr_db": [20, 20.25, 20.75],
        "ssim": 0.5, "flip": 0.25, "depth_error": null, "images": 3,
        "masked_pixels": 0, "scored_share": 1},
      "outside": {"psnr_db": 20.5, "luma_psnr_db": 22, "channel_psnr_db": [20, 20.25, 20.75],
        "ssim": 0.5, "flip": 0.25, "depth_error": null, "images": 3,
        "masked_pixels": 0, "scored_share": 1},
      "objects": {"-7": {"type": "CAR", "psnr_db": 25, "luma_psnr_db": 22, "ssim": 0.5,
        "images": 3}}},
    "lidar": {"returns": 100, "range_error_m": 0.25, "mean_range_error_m": 0.375,
      "hit_rate": 0.75, "near_hit_rate": 0.5, "revolutions": 2, "chamfer_m": 0.125,
      "intensity_rmse": 0.0625,
      "lost": {"rays": 20, "accuracy": 0.75, "f1": 0.5},
      "moving": {"returns": 7, "range_error_m": 0.5, "mean_range_error_m": 0.625, "hit_rate": 1,
        "near_hit_rate": 0.25}},
    "lidars": {"up": {"returns": 9, "range_error_m": null, "mean_range_error_m": null,
      "hit_rate": 0, "near_hit_rate": 0, "revolutions": 1, "chamfer_m": 0.5,
      "intensity_rmse": null, "lost": null, "moving": null}},
    "novel_lidar": {"aside": {"returns": 9, "range_error_m": null, "mean_range_error_m": null,
      "hit_rate": 0, "near_hit_rate": 0, "revolutions": 1, "chamfer_m": 0.5,
      "intensity_rmse": null, "lost": null, "moving": null}},
    "novel": {}, "held_out": false,
    "alignment": {"translation_m": 0.5, "rotation_deg": 0.25, "residual_m": 0.125,
                  "residual_deg": 1, "frames": 5},
    "view_alignment": {"translation_m": 0.25, "rotation_deg": 0.5, "views": 8},
    "pose_changes": {"frames": {"translation_m": 0.75, "rotation_deg": 180, "at_bound": 1},
                     "cameras": {"F_CAM": {"translation_m": [0.5, -0.25, 2],
                                           "rotation_deg": [0, 90, 0],
                       "time_offset_s": 0.125, "at_bound": true}}}})"));
}

// Ground truth of an edit: 0.2 where it changed the image, the left third, and 0.6 elsewhere.
class EditedTest : public EvaluateTest {
 protected:
  EditedTest() {
    std::filesystem::create_directories(edited_ / "gone");
    MovingObject actor;
    actor.id = 7;
    actor.size_m = {4, 2, 1.5};
    actor.keys = {{0, Rigid3d::Identity(), Eigen::Vector3d::Zero()}};
    run_.scene.actors = {actor};
    write_file(edited_ / "gone" / "edit.json", R"({"actors": {"7": {"remove": true}}})");
    Image8 image{kWidth, kHeight, std::vector<std::uint8_t>(3 * kWidth * kHeight, 153)},
        mask = image;
    for (int i = 0; i < 3 * kWidth * kHeight; ++i) {
      const bool changed = i / 3 % kWidth < 8;
      mask.rgb[i] = changed ? 255 : 0;
      if (changed) image.rgb[i] = 51;
    }
    write_image(edited_ / "gone" / "A_102.png", image);
    write_image(edited_ / "gone" / "A_102_changed.png", mask);
  }
  const std::filesystem::path edited_ = folder_ / "edited";
};

TEST_F(EditedTest, ScoresChangedPixelsApart) {
  for (const auto& folder : {edited_, edited_ / "gone"}) {
    const auto scores = score_edited(run_, black_, folder);
    ASSERT_EQ(scores.size(), 1u);
    const EditedScore& gone = scores.at("gone");
    EXPECT_NEAR(gone.inside.psnr_db, psnr_of(0.2), kTolerance);
    EXPECT_NEAR(gone.outside.psnr_db, psnr_of(0.6), kTolerance);
    EXPECT_EQ(gone.inside.images, 1);
    EXPECT_EQ(gone.inside.left_out, 16 * kHeight);
    EXPECT_EQ(gone.outside.left_out, 8 * kHeight);
  }
  EXPECT_EQ(
      edited_to_json(score_edited(run_, black_, edited_))["edited"]["gone"]["inside"]["images"], 1);
}

TEST_F(EditedTest, RejectsWhatDoesNotBelongToTheRun) {
  EXPECT_THROW(score_edited(run_, black_, folder_), InputError) << "no edit.json";
  std::filesystem::rename(edited_ / "gone" / "A_102_changed.png", edited_ / "other.png");
  EXPECT_THROW(score_edited(run_, black_, edited_), InputError) << "no mask";
  run_.scene.actors[0].id = 8;
  EXPECT_THROW(score_edited(run_, black_, edited_), InputError) << "no such object";
  std::filesystem::rename(edited_ / "gone" / "A_102.png", edited_ / "gone" / "A_99.png");
  EXPECT_THROW(score_edited(run_, black_, edited_), InputError) << "no such frame";
}

}  // namespace
}  // namespace redrive
