// SPDX-License-Identifier: Apache-2.0
// The bundle adjustment on a synthetic drive (synthetic_rig.h), and what align does where nothing
// can be recovered. Results are registered with the ground truth first, since no measurement fixes
// the gauge.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/align/align.h"
#include "redrive/align/bundle/synthetic_rig_testing.h"
#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/lidar_sensor.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using testing::make_synthetic_rig;
using testing::SyntheticOptions;
using testing::SyntheticRig;

SyntheticOptions short_drive() { return {.frames = 24, .points = 250, .lidar_points = 9000}; }

AlignResult aligned(const SyntheticRig& rig, const AlignOptions& options = {}) {
  ThreadPool pool(2);
  return align_with(rig.recording, rig.tracks, rig.lidar, options, pool);
}

AlignOptions seeking_readouts() {
  AlignOptions options;
  options.bundle.readouts = {true, true, true};
  return options;
}

std::string reason_why_not(const SyntheticRig& rig) {
  try {
    const AlignResult result = aligned(rig);
    ADD_FAILURE() << "no InsufficientDataError; the trajectory's residual is "
                  << result.aligned_vs_ground_truth->residual_m << " m, "
                  << result.aligned_vs_ground_truth->residual_deg << " degrees";
  } catch (const InsufficientDataError& error) {
    return error.what();
  }
  return "";
}

/// RMS of the sigmas of the result's poses: the expected RMS of the residuals.
struct Stated {
  double m = 0, deg = 0;
};
Stated stated(const AlignResult& result) {
  Stated sum;
  for (const Correction& c : result.corrections) {
    sum.m += c.sigma.head<3>().squaredNorm();
    sum.deg += c.sigma.tail<3>().squaredNorm();
  }
  const double n = static_cast<double>(result.corrections.size());
  return {std::sqrt(sum.m / n), std::sqrt(sum.deg / n) / kRadiansPerDegree};
}

/// Error of a camera's yaw in degrees, in body axes.
double yaw_off_deg(const SyntheticRig& rig, const AlignResult& result, int camera) {
  const Eigen::Matrix3d error = result.cameras[camera].body_from_sensor.linear() *
                                rig.true_cameras[camera].body_from_sensor.linear().transpose();
  return so3_log(error).z() / kRadiansPerDegree;
}
double offset_off_ms(const SyntheticRig& rig, const AlignResult& result, int camera) {
  return 1e-6 * static_cast<double>(result.cameras[camera].time_offset_ns -
                                    rig.true_cameras[camera].time_offset_ns);
}

// Without noise only the priors (1 cm, 0.03 degrees, 2 ms) pull, against thousands of pixels of
// 0.05 px: 1 % of the errors and less. Points in corners, which could be tied to the wrong surface,
// have no ties (lidar_ties.h).
TEST(Bundle, RecoversGroundTruthWithoutNoise) {
  SyntheticOptions options = short_drive();
  options.noise_px = options.noise_m = 0;
  const SyntheticRig rig = make_synthetic_rig(options);
  const AlignResult result = aligned(rig);
  EXPECT_GT(result.initial_vs_ground_truth->residual_m, 0.03);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.001);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.002);
  EXPECT_NEAR(yaw_off_deg(rig, result, 0), 0, 0.002);
  EXPECT_NEAR(offset_off_ms(rig, result, 1), 0, 0.1);
  EXPECT_LT(result.bundle.cameras[0].aligned_px, 0.05);
  EXPECT_GT(result.bundle.cameras[0].initial_px, 0.5);
}

// With noise the errors have to be as large as the stated sigmas. A factor of three allows for the
// sample and for the simplified model of noise.
TEST(Bundle, ErrorsAgreeWithStatedSigmas) {
  const SyntheticRig rig = make_synthetic_rig(short_drive());
  const AlignResult result = aligned(rig);
  const Stated sigma = stated(result);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 3 * sigma.m);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 3 * sigma.deg);
  EXPECT_LT(sigma.m, 0.01);
  EXPECT_LT(sigma.deg, 0.02);
  for (int c = 0; c < 3; ++c) {
    const CameraCorrection& camera = result.camera_corrections[c];
    ASSERT_TRUE(camera.extrinsic_sigmas[5]) << c;
    EXPECT_LT(std::abs(yaw_off_deg(rig, result, c)),
              2 * *camera.extrinsic_sigmas[5] / kRadiansPerDegree)
        << c;
    ASSERT_TRUE(camera.offset_sigma_s) << c;
    EXPECT_LT(std::abs(offset_off_ms(rig, result, c)), 4e3 * *camera.offset_sigma_s) << c;
    EXPECT_NEAR(result.bundle.cameras[c].sigma_px, 0.2, 0.03) << c;
  }
  EXPECT_LT(std::abs(yaw_off_deg(rig, result, 0)), 0.02);
  EXPECT_LT(std::abs(offset_off_ms(rig, result, 1)), 1);
  EXPECT_TRUE(result.remarks.empty());
}

// Corrections of cameras and of frames have the same axes: forward, left and up of the body, and
// roll, pitch and yaw about them.
TEST(Bundle, CorrectionsOfCamerasAndFramesAreInTheBodysAxes) {
  SyntheticOptions options = short_drive();
  options.frames = 10;
  const SyntheticRig rig = make_synthetic_rig(options);
  const AlignResult result = aligned(rig);
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const Rigid3d &found = result.cameras[c].body_from_sensor,
                  &initial = rig.recording.cameras[c].calibration.body_from_sensor;
    Vector6d change;
    change << found.translation() - initial.translation(),
        so3_log(found.linear() * initial.linear().transpose());
    EXPECT_LT((result.camera_corrections[c].extrinsics - change).norm(), 1e-9) << c;
  }
  for (std::size_t f = 0; f < result.frames.size(); ++f) {
    // ECEF is stored in steps of 1e-9 m.
    const Rigid3d change = rig.recording.frames[f].global_from_body.inverse(Eigen::Isometry) *
                           result.frames[f].global_from_body;
    Vector6d expected;
    expected << change.translation(), so3_log(change.linear());
    EXPECT_LT((result.corrections[f].value - expected).norm(), 1e-7) << f;
  }
}

TEST(Bundle, RecoversFromPoseErrorsOfHalfAMetreAndADegree) {
  SyntheticOptions options = short_drive();
  options.pose_noise_m = 0.5;
  options.pose_noise_rad = kRadiansPerDegree;
  const SyntheticRig rig = make_synthetic_rig(options);
  const AlignResult result = aligned(rig);
  EXPECT_GT(result.initial_vs_ground_truth->residual_m, 0.3);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.01);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.02);
}

TEST(Bundle, RefinesPosesFromLidarAlone) {
  SyntheticOptions options = short_drive();
  options.points = 0;
  options.lidar_points = 20'000;
  const AlignResult result = aligned(make_synthetic_rig(options));
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.015);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.05);
  EXPECT_EQ(result.remarks.size(), 3u);  // one of each camera: no image points
  EXPECT_EQ(result.cameras[1].time_offset_ns, 0);
}

// As RecoversGroundTruthWithoutNoise with a readout time of 25 ms, once from the calibration and
// once estimated.
TEST(Bundle, RecoversRollingShuttersWithoutNoise) {
  SyntheticOptions options = short_drive();
  options.noise_px = options.noise_m = 0;
  options.readout_s = 0.025;
  SyntheticRig rig = make_synthetic_rig(options);
  for (const bool known : {false, true}) {
    SCOPED_TRACE(known);
    for (RecordedCamera& camera : rig.recording.cameras)
      camera.calibration.readout_ns = known ? 25'000'000 : 0;
    const AlignResult result = aligned(rig, known ? AlignOptions{} : seeking_readouts());
    EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.001);
    EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.002);
    EXPECT_NEAR(yaw_off_deg(rig, result, 0), 0, 0.002);
    EXPECT_NEAR(offset_off_ms(rig, result, 1), 0, 0.1);
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(1e-6 * static_cast<double>(result.cameras[c].readout_ns), 25, known ? 0 : 0.05)
          << c;
      EXPECT_EQ(result.camera_corrections[c].readout_sigma_s.has_value(), !known) << c;
    }
    EXPECT_TRUE(result.remarks.empty());
  }
}

TEST(Bundle, ErrorsOfReadoutsAgreeWithStatedSigmas) {
  SyntheticOptions options = short_drive();
  options.readout_s = -0.02;  // the lowest row first
  SyntheticRig rig = make_synthetic_rig(options);
  rig.recording.cameras[2].calibration.readout_ns = -20'000'000;
  AlignOptions sought = seeking_readouts();
  sought.bundle.readouts[2] = false;
  const AlignResult result = aligned(rig, sought), global = aligned(rig);
  for (int c = 0; c < 2; ++c) {
    const CameraCorrection& camera = result.camera_corrections[c];
    ASSERT_TRUE(camera.readout_sigma_s) << c;
    EXPECT_LT(*camera.readout_sigma_s, 3.5e-3) << c;
    EXPECT_LT(std::abs(camera.readout_s + 0.02), 4 * *camera.readout_sigma_s) << c;
    EXPECT_LT(result.bundle.cameras[c].sigma_px, global.bundle.cameras[c].sigma_px) << c;
  }
  EXPECT_EQ(result.cameras[2].readout_ns, -20'000'000);
  EXPECT_FALSE(result.camera_corrections[2].readout_sigma_s);
}

// The rows of a camera at rest see the same at any time.
TEST(Bundle, UnobservableReadoutsKeepTheirInitialValue) {
  SyntheticOptions options = short_drive();
  options.frames = 12;
  options.points = 120;
  options.noise_px = 0.5;
  options.speed_m_per_s = 0;
  options.readout_s = 0.025;
  SyntheticRig rig = make_synthetic_rig(options);
  rig.recording.cameras[0].calibration.readout_ns = 10'000'000;
  const AlignResult result = aligned(rig, seeking_readouts());
  EXPECT_EQ(result.cameras[0].readout_ns, 10'000'000);
  EXPECT_EQ(result.cameras[1].readout_ns, 0);
  ASSERT_GE(result.remarks.size(), 3u);  // and of some time offsets
  EXPECT_THAT(result.remarks[0], HasSubstr("A_FRONT: the readout is unobservable"));
  EXPECT_THAT(result.remarks[0], HasSubstr("keeps its initial value of 10.00 ms"));
  EXPECT_FALSE(result.camera_corrections[0].readout_sigma_s);
}

// The scale is the egomotion's: 6 cm RMS over 12 m with a correlation of a second leave 1 %, 3 cm
// RMS of position.
TEST(Bundle, RefinesPosesFromOneCameraWithoutLidar) {
  SyntheticOptions options = short_drive();
  options.lidar_points = 0;
  options.cameras = {0};
  options.yaw_rad = 0;
  const AlignResult result = aligned(make_synthetic_rig(options));
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.06);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg,
            0.8 * result.initial_vs_ground_truth->residual_deg);
  ASSERT_EQ(result.remarks.size(), 1u);
  EXPECT_THAT(result.remarks[0], HasSubstr("no LiDAR"));
}

/// A straight drive with one camera, whose calibration is rotated about the driving direction.
SyntheticRig rolled_camera(SyntheticOptions options, double roll_deg) {
  options.straight = true;
  options.cameras = {0};
  options.yaw_rad = 0;
  SyntheticRig rig = make_synthetic_rig(options);
  Rigid3d& calibrated = rig.recording.cameras[0].calibration.body_from_sensor;
  calibrated.linear() =
      so3_exp({roll_deg * kRadiansPerDegree, 0, 0}) * rig.true_cameras[0].body_from_sensor.linear();
  return rig;
}

// The camera sees the same road and walls as the LiDAR: 0.3 degrees lift a point 5 m to the side by
// 2.6 cm.
TEST(Bundle, PointsOnLidarSurfacesTellRollOnAStraightDrive) {
  const SyntheticRig rig = rolled_camera(short_drive(), 0.3);
  const AlignResult result = aligned(rig);
  const CameraCorrection& camera = result.camera_corrections[0];
  EXPECT_GT(result.bundle.ties_of_camera[0], 60);
  ASSERT_TRUE(camera.extrinsic_sigmas[3]);
  EXPECT_LT(*camera.extrinsic_sigmas[3], 0.05 * kRadiansPerDegree);
  EXPECT_NEAR(camera.extrinsics[3], -0.3 * kRadiansPerDegree, 2 * *camera.extrinsic_sigmas[3]);
}

// Without a LiDAR nothing tells the rotation about the driving direction, nor the camera's position
// in the car: they stay exactly as calibrated.
TEST(Bundle, RollIsUnobservableOnAStraightDriveWithoutLidar) {
  SyntheticOptions options = short_drive();
  options.lidar_points = 0;
  const SyntheticRig rig = rolled_camera(options, 0.3);
  const AlignResult result = aligned(rig);
  const CameraCorrection& camera = result.camera_corrections[0];
  for (const int axis : {0, 1, 2, 3}) {
    EXPECT_FALSE(camera.extrinsic_sigmas[axis]) << axis;
    EXPECT_NEAR(camera.extrinsics[axis], 0, 1e-12) << axis;
  }
  const Rigid3d& calibrated = rig.recording.cameras[0].calibration.body_from_sensor;
  EXPECT_LT((result.cameras[0].body_from_sensor.translation() - calibrated.translation()).norm(),
            1e-9);
}

// At constant velocity each camera's points fit at any time of exposure. The calibrated offsets are
// kept, though the left camera is 12 ms late.
TEST(Bundle, TimeOffsetsAreUnobservableAtConstantVelocity) {
  SyntheticOptions options = short_drive();
  options.straight = true;
  options.joined = false;
  SyntheticRig rig = make_synthetic_rig(options);
  rig.recording.cameras[2].calibration.time_offset_ns = 3'000'000;
  const AlignResult result = aligned(rig);
  ASSERT_EQ(result.remarks.size(), 3u);
  EXPECT_THAT(result.remarks[1], HasSubstr("B_LEFT: the time offset is unobservable"));
  EXPECT_THAT(result.remarks[2], HasSubstr("keeps its initial value of 3.00 ms"));
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(result.cameras[c].time_offset_ns, c == 2 ? 3'000'000 : 0) << c;
    EXPECT_FALSE(result.camera_corrections[c].offset_sigma_s) << c;
    EXPECT_LT(result.bundle.cameras[c].aligned_px, 0.4) << c;
  }
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.01);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.02);
}

// Points seen by several cameras constrain their offsets: at 20 m/s 12 ms are 24 cm.
TEST(Bundle, SharedPointsMakeTimeOffsetsObservable) {
  SyntheticOptions options = short_drive();
  options.straight = true;
  options.speed_m_per_s = 20;
  const SyntheticRig rig = make_synthetic_rig(options);
  const AlignResult result = aligned(rig);
  EXPECT_TRUE(result.remarks.empty()) << result.remarks[0];
  EXPECT_NEAR(offset_off_ms(rig, result, 1), 0, 1.5) << "1 cm of each camera's position is 0.5 ms";
}

/// Displaces the recorded poses of some frames by that much to the left.
void displace(SyntheticRig* rig, std::vector<int> frames, double left_m) {
  for (const int f : frames)
    rig->recording.frames[f].global_from_body =
        rig->recording.frames[f].global_from_body * Eigen::Translation3d(0, left_m, 0);
}

/// Distance of a frame's aligned position from the true one, by the motion to the frame before.
double step_off_m(const SyntheticRig& rig, const AlignResult& result, int frame) {
  const auto step = [&](const std::vector<FramePose>& frames) -> Eigen::Vector3d {
    return (frames[frame - 1].global_from_body.inverse(Eigen::Isometry) *
            frames[frame].global_from_body)
        .translation();
  };
  return (step(result.frames) - step(rig.recording.ground_truth_frames)).norm();
}

// A position that is wrong by decimetres or metres makes outliers of its frame's observations. It
// must neither stay nor bend others.
TEST(Bundle, SinglePosesThatAreWrongAreFound) {
  const AlignResult without = aligned(make_synthetic_rig(short_drive()));
  for (const double left_m : {0.6, -12.0}) {
    for (const int lidar_points : {9000, 0}) {
      SCOPED_TRACE(left_m);
      SyntheticOptions options = short_drive();
      options.lidar_points = lidar_points;
      SyntheticRig rig = make_synthetic_rig(options);
      const double scale_m = lidar_points > 0 ? 0.02 : 0.04;  // without LiDAR the egomotion's
      displace(&rig, {10}, left_m);
      const AlignResult result = aligned(rig);
      EXPECT_LT(step_off_m(rig, result, 10), scale_m);
      EXPECT_LT(step_off_m(rig, result, 11), scale_m);
      EXPECT_LT(result.corrections[10].sigma.head<3>().norm(), 0.03);
      EXPECT_TRUE(result.bundle.unsupported_frames.empty());
      for (int c = 0; c < 3 && lidar_points > 0; ++c)
        EXPECT_NEAR(result.camera_corrections[c].offset_s, without.camera_corrections[c].offset_s,
                    0.0005)
            << "its standard deviation is "
            << result.camera_corrections[c].offset_sigma_s.value_or(-1);
    }
  }
}

TEST(Bundle, JumpsOfThePosesAreMended) {
  SyntheticRig rig = make_synthetic_rig(short_drive());
  std::vector<int> later;
  for (int f = 12; f < 24; ++f) later.push_back(f);
  displace(&rig, later, 3);
  const AlignResult result = aligned(rig);
  EXPECT_LT(step_off_m(rig, result, 12), 0.02);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.015);
}

// Observations that fit no pose say nothing about their frame: it is placed between its neighbours,
// with the standard deviation of that interpolation.
TEST(Bundle, FramesWithContradictoryObservationsAreInterpolated) {
  SyntheticOptions options = short_drive();
  options.lidar_points = 0;
  SyntheticRig rig = make_synthetic_rig(options);
  testing::SyntheticNoise noise(9);
  for (Track& track : rig.tracks)
    for (Observation& seen : track.seen)
      if (seen.frame == 10) seen.pixel = {noise.uniform(0, 479), noise.uniform(0, 263)};
  const AlignResult result = aligned(rig), without = aligned(make_synthetic_rig(options));
  EXPECT_EQ(result.bundle.unsupported_frames, std::vector<int>{10});
  const double sigma_m = result.corrections[10].sigma.head<3>().norm();
  EXPECT_GT(sigma_m, 1.2 * without.corrections[10].sigma.head<3>().norm());
  EXPECT_LT(step_off_m(rig, result, 10), 3 * sigma_m);
  EXPECT_LT(step_off_m(rig, result, 12), 0.04);
}

TEST(Bundle, IsDeterministic) {
  SyntheticOptions options = short_drive();
  options.frames = 10;
  const SyntheticRig rig = make_synthetic_rig(options);
  const AlignResult a = aligned(rig), b = aligned(rig);
  for (std::size_t f = 0; f < a.frames.size(); ++f)
    EXPECT_EQ(a.frames[f].global_from_body.matrix(), b.frames[f].global_from_body.matrix());
}

TEST(InsufficientData, WithoutMotionAndLidar) {
  SyntheticOptions options = short_drive();
  options.speed_m_per_s = 0;
  options.lidar_points = 0;
  EXPECT_THAT(reason_why_not(make_synthetic_rig(options)), HasSubstr("stands still"));
}

TEST(InsufficientData, WithoutObservations) {
  SyntheticOptions options = short_drive();
  options.points = options.lidar_points = 0;
  EXPECT_THAT(reason_why_not(make_synthetic_rig(options)), HasSubstr("too few observations"));
}

// The last third of the drive has no observations.
TEST(InsufficientData, WithUnconstrainedFrames) {
  SyntheticOptions options = short_drive();
  options.frames = 40;
  SyntheticRig rig = make_synthetic_rig(options);
  for (Track& track : rig.tracks)
    std::erase_if(track.seen, [](const Observation& seen) { return seen.frame > 25; });
  std::erase_if(rig.tracks, [](const Track& track) { return track.seen.size() < 2; });
  rig.lidar.clear();
  EXPECT_THAT(reason_why_not(rig), HasSubstr("is not determined"));
}

// Points that move as no static point does.
TEST(InsufficientData, WithContradictoryObservations) {
  SyntheticOptions options = short_drive();
  options.lidar_points = 0;
  SyntheticRig rig = make_synthetic_rig(options);
  testing::SyntheticNoise noise(9);
  for (Track& track : rig.tracks)
    for (Observation& seen : track.seen)
      seen.pixel = {noise.uniform(0, 479), noise.uniform(0, 263)};
  EXPECT_THAT(reason_why_not(rig), HasSubstr("cannot"));
}

/// Adjusts a rig whose scans show elevations that are off by `error_deg`.
struct ElevationFit {
  double correction_deg = 0;
  BundleResult result;
};
ElevationFit fit_elevation(const SyntheticOptions& options, double error_deg) {
  SyntheticRig rig = make_synthetic_rig(options);
  rig.recording.lidars = {{"lidar", Rigid3d(Eigen::Translation3d(1, 0, 1.8))}};
  for (LidarSample& sample : rig.lidar)
    sample.in_body = RaisedReturn(rig.recording.lidars[0].body_from_lidar, sample.in_body)
                         .at(error_deg * kRadiansPerDegree);
  RigModel model = make_rig_model(rig.recording);
  BundleOptions bundle;
  bundle.lidar_elevation = true;
  ThreadPool pool(2);
  BundleResult result = adjust_bundle(&model, rig.tracks, rig.lidar, nullptr, bundle, pool);
  return {model.lidar_elevation_rad * kDegreesPerRadian, std::move(result)};
}

TEST(Bundle, FindsTheErrorOfElevations) {
  for (const double error_deg : {0.0, -0.2}) {
    const ElevationFit fit = fit_elevation(short_drive(), error_deg);
    EXPECT_NEAR(fit.correction_deg, -error_deg, 0.02);
    ASSERT_TRUE(fit.result.elevation_sigma_rad);
    EXPECT_LT(*fit.result.elevation_sigma_rad * kDegreesPerRadian, 0.02);
    EXPECT_LT(std::abs(fit.correction_deg + error_deg),
              3 * *fit.result.elevation_sigma_rad * kDegreesPerRadian);
    EXPECT_FALSE(fit.result.unobservable_elevation_rad);
  }
}

// All scans of a car that stands are alike, and a cone is as good as a plane.
TEST(Bundle, KeepsElevationsThatItCannotSee) {
  SyntheticOptions standing = short_drive();
  standing.speed_m_per_s = 0;
  standing.straight = true;
  const ElevationFit fit = fit_elevation(standing, 0.2);
  EXPECT_EQ(fit.correction_deg, 0);
  ASSERT_TRUE(fit.result.unobservable_elevation_rad);
  EXPECT_GT(*fit.result.elevation_sigma_rad, kMaxElevationSigma_rad);
}

}  // namespace
}  // namespace redrive
