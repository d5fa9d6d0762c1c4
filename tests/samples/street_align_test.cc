// SPDX-License-Identifier: Apache-2.0
// The street as a program is given it, put right: what tools/street/README.md says is wrong is
// found.
#include <cmath>
#include <numbers>

#include <gtest/gtest.h>

#include "redrive/align/align.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

TEST(Street, IsAligned) {
  const std::filesystem::path root = REDRIVE_SAMPLES "/street";
  const Recording given = open_recording(root),
                  truth = open_recording(root, PoseSource::kGroundTruth);
  ThreadPool pool(2);
  const AlignResult result = align(given, {}, pool);
  EXPECT_GT(result.initial_vs_ground_truth->residual_m, 0.05);
  EXPECT_GT(result.initial_vs_ground_truth->residual_deg, 0.15);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_m, 0.01);
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, 0.02);
  for (std::size_t c = 0; c < result.cameras.size(); ++c) {
    const CameraCalibration &found = result.cameras[c], &right = truth.cameras[c].calibration;
    SCOPED_TRACE(found.name);
    const Eigen::Matrix3d rest =
        found.body_from_sensor.linear() * right.body_from_sensor.linear().transpose();
    if (found.name == "F_MIDRANGECAM_C") {
      EXPECT_LT(std::abs(so3_log(rest).z()) * kDegrees, 0.02);
    }
    EXPECT_LT(std::abs(static_cast<double>(found.time_offset_ns - right.time_offset_ns)), 1e6);
    EXPECT_LT(result.bundle.cameras[c].aligned_px, 0.5 * result.bundle.cameras[c].initial_px);
  }
}

// Rows read within 30 ms, of which the calibration does not say a word.
TEST(StreetRolling, ReadoutsAreFound) {
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
