// SPDX-License-Identifier: Apache-2.0
// Alignment of the street recording recovers the errors that tools/street/README.md states.
#include <cmath>

#include <gtest/gtest.h>

#include "redrive/align/align.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/frame_range.h"

namespace redrive {
namespace {

TEST(Street, IsAligned) {
  const std::filesystem::path root = REDRIVE_SAMPLES "/street";
  Recording recording = open_recording(root);
  keep_frames(parse_frame_range("1000:1035"), &recording);
  const Recording ground_truth = open_recording(root, PoseSource::kGroundTruth);
  ThreadPool pool(2);
  const AlignResult result = align(recording, {}, pool);
  EXPECT_GT(result.initial_vs_ground_truth->residual_m, 0.05);
  EXPECT_GT(result.initial_vs_ground_truth->residual_deg, 0.15);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.01);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.02);
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const CameraCalibration &found = result.cameras[c],
                            &exact = ground_truth.cameras[c].calibration;
    SCOPED_TRACE(found.name);
    const Eigen::Matrix3d error =
        found.body_from_sensor.linear() * exact.body_from_sensor.linear().transpose();
    if (found.name == "F_MIDRANGECAM_C") {
      constexpr int kYaw = 5;
      constexpr double kSigmas = 2, kMost_deg = 0.03;
      const auto& sigma_rad = result.camera_corrections[c].extrinsic_sigmas[kYaw];
      ASSERT_TRUE(sigma_rad);
      EXPECT_LT(std::abs(so3_log(error).z()), kSigmas * *sigma_rad);
      EXPECT_LT(std::abs(so3_log(error).z()) * kDegreesPerRadian, kMost_deg);
    }
    EXPECT_LT(std::abs(static_cast<double>(found.time_offset_ns - exact.time_offset_ns)), 1e6);
    EXPECT_LT(result.bundle.cameras[c].aligned_px, 0.5 * result.bundle.cameras[c].initial_px);
  }
}

// The readout time of 30 ms is not in the calibration.
TEST(StreetRolling, EstimatesReadouts) {
  ThreadPool pool(2);
  AlignOptions options;
  options.bundle.readouts = {true, true};
  const AlignResult result =
      align(open_recording(REDRIVE_SAMPLES "/street_rolling"), options, pool);
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const CameraCorrection& camera = result.camera_corrections[c];
    SCOPED_TRACE(camera.name);
    EXPECT_EQ(result.cameras[c].readout_ns, std::llround(1e9 * camera.readout_s));
    ASSERT_TRUE(camera.readout_sigma_s);
    EXPECT_NEAR(1e3 * camera.readout_s, 30, 1);
  }
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, result.initial_vs_ground_truth->residual_m);
}

}  // namespace
}  // namespace redrive
