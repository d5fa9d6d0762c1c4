// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/preflight.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/align/textured_drive_testing.h"
#include "redrive/align/tracks/patch.h"

namespace redrive {
namespace {

constexpr int kStreetFrames = 30;
// cameras of the street in the order of their names
enum Camera4 { kFrontLong, kFront, kLeft, kRight };

/// The street's first two seconds, as its files have them: poses with noise, the left fisheye 12 ms
/// early.
class StreetPreflight : public ::testing::Test {
 protected:
  static const Recording& street() {
    static const Recording recording = [] {
      Recording all = open_recording(REDRIVE_SAMPLES "/street");
      all.frames.resize(kStreetFrames);
      for (RecordedCamera& camera : all.cameras) camera.images.resize(kStreetFrames);
      std::erase_if(all.lidar_files,
                    [&](const FrameFile& f) { return f.frame_id > all.frames.back().id; });
      return all;
    }();
    return recording;
  }
  static RigImages images() {
    static const RigImages all = [] {
      ThreadPool pool(2);
      return load_rig_images(street(), {}, 7, pool);
    }();
    return all;
  }
  /// Checks the recording after `fault` has changed its metadata. `with_lidar`: measures time
  /// offsets with the LiDAR, too, which is slow.
  static Preflight check(const std::function<void(Recording*)>& fault, bool with_lidar = false) {
    Recording recording = street();
    fault(&recording);
    RigImages seen = images();
    seen.scene = make_scene(recording, {});
    ThreadPool pool(2);
    std::vector<LidarSample> lidar;
    if (with_lidar) lidar = load_lidar_samples(recording, seen.scene, seen.moving, pool);
    return check_recording(recording, seen, lidar, pool, {.pairs = 10});
  }
  /// Expects a good verdict for all cameras but `named`.
  static void expect_others_fine(const Preflight& result, const std::vector<int>& wrong) {
    for (int c = 0; c < static_cast<int>(result.cameras.size()); ++c) {
      const CameraCheck& camera = result.cameras[c];
      SCOPED_TRACE(camera.name + ": " + camera.why);
      if (std::ranges::find(wrong, c) == wrong.end())
        EXPECT_TRUE(camera.verdict == Verdict::kGood || camera.verdict == Verdict::kUsable);
      else
        EXPECT_EQ(camera.verdict, Verdict::kWrong);
    }
    EXPECT_EQ(result.passes(), wrong.empty());
  }
  static Rigid3d& extrinsics(Recording* r, int camera) {
    return r->cameras[camera].calibration.body_from_sensor;
  }
};

TEST(Preflight, NamesAlternativesThatFitNearlyAsWell) {
  std::vector<Hypothesis> tried = {{Fault::kNone, "as recorded", 8},
                                   {Fault::kInvertedExtrinsic, "inverted", 0.4},
                                   {Fault::kAxesConvention, "OpenGL", 0.44},
                                   {Fault::kAxesConvention, "upside down", 2}};
  EXPECT_EQ(explanation_of(tried),
            "inverted, or OpenGL: then half of the points agree to 0.40 or 0.44 px, as recorded to "
            "8.00 px");
  tried[2].error_px = 0.52;
  EXPECT_EQ(explanation_of(tried),
            "inverted: then half of the points agree to 0.40 px, as recorded to 8.00 px");
  tried.resize(2);
  EXPECT_EQ(explanation_of(tried),
            "inverted: then half of the points agree to 0.40 px, as recorded to 8.00 px");
}

TEST(Preflight, HeadlineNamesUncheckedCameras) {
  Preflight result;
  result.clock.verdict = Verdict::kCannotTell;
  for (const char* name : {"A", "B", "C"}) {
    result.cameras.emplace_back().name = name;
    result.cameras.back().verdict = Verdict::kGood;
  }
  EXPECT_EQ(result.headline(), "Nothing speaks against training");
  result.cameras[0].verdict = result.cameras[2].verdict = Verdict::kCannotTell;
  EXPECT_EQ(result.headline(), "Nothing speaks against training; could not be checked: A, C");
  result.cameras[1].verdict = Verdict::kCannotTell;
  EXPECT_EQ(result.headline(),
            "No camera could be checked: this check can neither recommend nor refuse training");
  result.cameras[1].verdict = Verdict::kWrong;
  EXPECT_EQ(result.headline(), "Training makes no sense before this is corrected");
}

TEST(Preflight, TheTimeOffsetWithTheLowerSigmaCounts) {
  CameraCheck check;
  check.offset_ms = -10;
  check.offset_sigma_ms = 4;
  EXPECT_FALSE(check.time_offset()) << "a scan without a minimum";
  check.offset_observable = true;
  EXPECT_EQ(check.time_offset()->offset_ms, -10);
  check.by_lidar = TimeOffsetEstimate{-12, 3, true};
  EXPECT_EQ(check.time_offset()->offset_ms, -12);
  check.by_lidar->sigma_ms = 5;
  EXPECT_EQ(check.time_offset()->offset_ms, -10);
  check.offset_observable = false;
  EXPECT_TRUE(check.time_offset()->by_lidar);
}

// The fisheye of the test drive exposes 20 ms later than calibrated. The drive is nearly straight,
// so the offset is unobservable from images alone.
TEST(Preflight, LidarMeasuresTimeOffsets) {
  const TemporaryFolder folder;
  Recording recording = make_test_drive(folder.path, 8);
  recording.cameras[0].calibration.time_offset_ns = 0;
  ThreadPool pool(2);
  const RigImages images = load_rig_images(recording, {}, kPatchHalf, pool);
  const std::vector<LidarSample> returns = make_test_returns(recording, 400'000);
  const CameraCheck by_both = check_recording(recording, images, returns, pool).cameras[0],
                    by_images = check_recording(recording, images, {}, pool).cameras[0];
  ASSERT_TRUE(by_both.by_lidar) << by_both.why;
  EXPECT_NEAR(by_both.by_lidar->offset_ms, 20, 10);
  EXPECT_LT(by_both.by_lidar->sigma_ms, 15);
  ASSERT_EQ(by_both.contrast.size(), 41u);
  EXPECT_EQ(by_both.contrast.front().offset_ms, -40);
  EXPECT_EQ(by_both.contrast[20].offset_ms, 0);
  EXPECT_TRUE(by_images.contrast.empty());
  EXPECT_FALSE(by_images.by_lidar);
}

TEST_F(StreetPreflight, FindsNoFaultAsRecorded) {
  const Preflight result = check([](Recording*) {}, true);
  expect_others_fine(result, {});
  EXPECT_EQ(result.clock.verdict, Verdict::kGood);
  for (const CameraCheck& camera : result.cameras) {
    EXPECT_LT(camera.tried[0].error_px, 0.8);
    EXPECT_LT(std::abs(camera.offset_ms), 15);
    EXPECT_EQ(camera.tried[0].what, "as recorded");
  }
  // 12 ms early; noise of the poses changes the estimate.
  const CameraCheck& left = result.cameras[kLeft];
  EXPECT_LT(left.offset_ms, -5);
  EXPECT_EQ(left.verdict, Verdict::kUsable) << left.why << " +- " << left.offset_sigma_ms;
  EXPECT_EQ(left.fault, Fault::kUnsynchronised);
  EXPECT_THAT(left.why, ::testing::MatchesRegex(
                            "time offset of about [0-9]+ ms \\(\\+- [0-9]+\\).*, exposed earlier "
                            "than recorded.*"));
  ASSERT_TRUE(left.by_lidar);
  EXPECT_NEAR(left.by_lidar->offset_ms, -12, 3 * left.by_lidar->sigma_ms);
  EXPECT_LT(left.by_lidar->sigma_ms, 8);
  EXPECT_LE(left.time_offset()->sigma_ms, std::min(left.offset_sigma_ms, left.by_lidar->sigma_ms));
  for (const int c : {kFrontLong, kFront, kRight}) {
    EXPECT_EQ(result.cameras[c].verdict, Verdict::kGood) << result.cameras[c].why;
    EXPECT_EQ(result.cameras[c].fault, Fault::kNone);
  }
  EXPECT_EQ(result.headline(), "Nothing speaks against training");
}

// With exact poses offsets of 12 ms and of 8 ms are certain, and correct offsets are not reported.
TEST_F(StreetPreflight, MeasuresTimeOffsets) {
  const Recording ground_truth =
      open_recording(REDRIVE_SAMPLES "/street", PoseSource::kGroundTruth);
  for (const std::int64_t left_ns : {0, 4'000'000}) {
    const Preflight result = check([&](Recording* r) {
      for (std::size_t f = 0; f < r->frames.size(); ++f)
        r->frames[f].global_from_body = ground_truth.frames[f].global_from_body;
      for (std::size_t c = 0; c < r->cameras.size(); ++c)
        r->cameras[c].calibration = ground_truth.cameras[c].calibration;
      ASSERT_EQ(r->cameras[kLeft].calibration.time_offset_ns, -12'000'000);
      r->cameras[kLeft].calibration.time_offset_ns = -left_ns;
    });
    expect_others_fine(result, {});
    const CameraCheck& left = result.cameras[kLeft];
    EXPECT_EQ(left.verdict, Verdict::kUsable) << left.why;
    EXPECT_EQ(left.fault, Fault::kUnsynchronised);
    EXPECT_NEAR(left.offset_ms, -12 + 1e-6 * static_cast<double>(left_ns), 2.5);
    EXPECT_LT(left.offset_sigma_ms, 2.5);
    EXPECT_THAT(
        left.why,
        ::testing::MatchesRegex(
            "time offset of about [0-9]+ ms \\(\\+- [0-9]+\\), exposed earlier than recorded.*"));
    for (const int c : {kFrontLong, kFront, kRight}) {
      const CameraCheck& camera = result.cameras[c];
      EXPECT_EQ(camera.verdict, Verdict::kGood) << camera.name << ": " << camera.why;
      EXPECT_LT(std::abs(camera.offset_ms), 3) << camera.name;
      EXPECT_EQ(camera.why.find("time offset"), std::string::npos) << camera.why;
    }
  }
}

// The median of the drive does not see one position that is 3 m off.
TEST_F(StreetPreflight, NamesSingleWrongPoses) {
  const Preflight result = check([](Recording* r) {
    FramePose& frame = r->frames[15];
    frame.global_from_body = frame.global_from_body * Eigen::Translation3d(0, 3, 0);
  });
  expect_others_fine(result, {});
  const std::string id = std::to_string(street().frames[15].id);
  ASSERT_EQ(result.shared.size(), 1u);
  EXPECT_EQ(result.shared[0].name, "motion");
  EXPECT_EQ(result.shared[0].verdict, Verdict::kUsable);
  EXPECT_THAT(result.shared[0].why, ::testing::HasSubstr("frame " + id + " lies "));
  EXPECT_THAT(result.headline(), ::testing::StartsWith("Align before training: the pose of frame"));
  bool named = false;
  for (const CameraCheck& camera : result.cameras)
    for (const OddPair& pair : camera.odd_pairs)
      named |= pair.first_id <= street().frames[15].id && pair.last_id >= street().frames[15].id;
  EXPECT_TRUE(named);
}

TEST_F(StreetPreflight, NamesWrongExtrinsics) {
  for (const int c : {kFrontLong, kFront, kLeft, kRight}) {
    const Preflight inverted =
        check([&](Recording* r) { extrinsics(r, c) = extrinsics(r, c).inverse(); });
    expect_others_fine(inverted, {c});
    EXPECT_EQ(inverted.cameras[c].fault, Fault::kInvertedExtrinsic) << inverted.cameras[c].why;
    const Preflight opengl = check([&](Recording* r) {
      extrinsics(r, c).linear() *= Eigen::Vector3d(1, -1, -1).asDiagonal();
    });
    expect_others_fine(opengl, {c});
    EXPECT_EQ(opengl.cameras[c].fault, Fault::kAxesConvention) << opengl.cameras[c].why;
    EXPECT_NE(opengl.cameras[c].why.find("OpenGL"), std::string::npos) << opengl.cameras[c].why;
  }
}

TEST_F(StreetPreflight, NamesSwappedCameras) {
  const Preflight sides =
      check([](Recording* r) { std::swap(extrinsics(r, kLeft), extrinsics(r, kRight)); });
  expect_others_fine(sides, {kLeft, kRight});
  for (const int c : {kLeft, kRight}) {
    EXPECT_EQ(sides.cameras[c].fault, Fault::kSwappedCameras) << sides.cameras[c].why;
    EXPECT_NE(
        sides.cameras[c].why.find(street().cameras[c == kLeft ? kRight : kLeft].calibration.name),
        std::string::npos);
  }
  // Both cameras look ahead, 2 degrees apart; both have to be reported.
  const Preflight front =
      check([](Recording* r) { std::swap(extrinsics(r, kFrontLong), extrinsics(r, kFront)); });
  expect_others_fine(front, {kFrontLong, kFront});
  for (const int c : {kFrontLong, kFront})
    EXPECT_EQ(front.cameras[c].fault, Fault::kSwappedCameras) << front.cameras[c].why;
}

TEST_F(StreetPreflight, NamesWrongTimes) {
  for (const int c : {kFront, kLeft, kRight}) {
    const Preflight late =
        check([&](Recording* r) { r->cameras[c].calibration.time_offset_ns += 80'000'000; });
    expect_others_fine(late, {c});
    EXPECT_EQ(late.cameras[c].fault, Fault::kUnsynchronised) << late.cameras[c].why;
    EXPECT_NEAR(late.cameras[c].offset_ms, -80, 15);
  }
  for (const double rate : {2.0, 0.5}) {
    const Preflight result = check([&](Recording* r) {
      for (FramePose& frame : r->frames)
        frame.t_ns =
            r->frames[0].t_ns + std::llround(rate * double(frame.t_ns - r->frames[0].t_ns));
    });
    EXPECT_EQ(result.clock.verdict, Verdict::kWrong);
    EXPECT_NEAR(result.clock.frame_seconds_per_lidar_second, rate, 0.02);
    EXPECT_FALSE(result.passes());
    for (const CameraCheck& camera : result.cameras)
      EXPECT_NE(camera.verdict, Verdict::kWrong) << camera.why;
  }
}

TEST_F(StreetPreflight, NamesImagesOfAnotherRate) {
  RigImages seen = images();
  for (const int c : {kFront, kLeft}) {
    const auto all = seen.grey[c];
    // Images have half the rate of frames, but are numbered as if they had the same.
    for (int f = 0; f < kStreetFrames; ++f)
      seen.grey[c][f] = 2 * f < kStreetFrames ? all[2 * f] : cv::Mat();
  }
  ThreadPool pool(2);
  const Preflight result = check_recording(street(), seen, {}, pool);
  expect_others_fine(result, {kFront, kLeft});
  for (const int c : {kFront, kLeft}) {
    EXPECT_EQ(result.cameras[c].fault, Fault::kWrongRate) << result.cameras[c].why;
    EXPECT_NE(result.cameras[c].why.find(" 0.5 times"), std::string::npos) << result.cameras[c].why;
  }
}

TEST_F(StreetPreflight, NamesCamerasThatCannotBeChecked) {
  const Preflight standing = check([](Recording* r) { r->metric = false; });
  for (const CameraCheck& camera : standing.cameras)
    EXPECT_EQ(camera.verdict, Verdict::kCannotTell);
  RigImages dark = images();
  for (cv::Mat& grey : dark.grey[kLeft]) grey = cv::Mat::zeros(grey.size(), CV_8U);
  for (cv::Mat& grey : dark.grey[kFront]) grey = dark.grey[kFront][0];  // stands still
  ThreadPool pool(2);
  const Preflight result = check_recording(street(), dark, {}, pool, {.pairs = 6});
  EXPECT_EQ(result.cameras[kLeft].verdict, Verdict::kCannotTell) << result.cameras[kLeft].why;
  EXPECT_EQ(result.cameras[kFront].verdict, Verdict::kCannotTell) << result.cameras[kFront].why;
  EXPECT_EQ(result.cameras[kRight].verdict, Verdict::kGood);
}

}  // namespace
}  // namespace redrive
