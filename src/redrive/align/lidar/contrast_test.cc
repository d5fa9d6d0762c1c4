// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/contrast.h"

#include <gtest/gtest.h>

#include "redrive/align/bundle/synthetic_rig_testing.h"
#include "redrive/align/textured_drive_testing.h"
#include "redrive/align/tracks/patch.h"
#include "redrive/align/tracks/tracks.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

constexpr int kDriveFrames = 8, kReturns = 400'000;

/// One drive and its LiDAR returns for all tests.
class ContrastOfLidar : public ::testing::Test {
 protected:
  static const Recording& drive() {
    static const TemporaryFolder folder;
    static const Recording recording = make_test_drive(folder.path, kDriveFrames);
    return recording;
  }
  static const RigImages& images() {
    static const RigImages loaded = [] {
      ThreadPool pool(2);
      return load_track_images(drive(), pool);
    }();
    return loaded;
  }
  static const std::vector<LidarSample>& returns() {
    static const std::vector<LidarSample> samples = make_test_returns(drive(), kReturns);
    return samples;
  }

  ContrastFit fit(const Recording& recording, int camera, const std::vector<LidarSample>& samples) {
    const RigModel model = make_rig_model(recording);
    return fit_time_offsets(model, {images(), samples}, pool_)[camera];
  }
  ThreadPool pool_{2};
};

// FISHEYE is exposed 20 ms late and looks sideways; FRONT looks ahead.
TEST_F(ContrastOfLidar, FindsTimeOffsets) {
  for (const int said_ms : {20, 0, 45}) {
    Recording recording = drive();
    recording.cameras[0].calibration.time_offset_ns = std::int64_t{1'000'000} * said_ms;
    const ContrastFit found = fit(recording, 0, returns());
    ASSERT_TRUE(found.observable) << said_ms;
    EXPECT_GT(found.cells, 5000);
    EXPECT_NEAR(found.offset_s, 0.020, 0.010) << "4 cm at 4 m/s, less than a pixel at 5 m";
    EXPECT_LT(std::abs(found.offset_s - 0.020), 2 * found.sigma_s);
    EXPECT_LT(found.sigma_s, 0.015);
  }
}

// Rows of a rolling shutter have their own times at every image size.
TEST_F(ContrastOfLidar, DownscaledImagesGiveTheSameOffset) {
  Recording recording = drive();
  recording.cameras[0].calibration.readout_ns = 80'000'000;
  const RigModel model = make_rig_model(recording);
  const RigImages half = downscaled_to_width(images(), 100, kPatchHalf, pool_);
  ASSERT_EQ(half.factor[0], 2);
  const ContrastFit of_all = fit_time_offsets(model, {images(), returns()}, pool_)[0],
                    of_half = fit_time_offsets(model, {half, returns()}, pool_)[0];
  ASSERT_TRUE(of_all.observable);
  ASSERT_TRUE(of_half.observable);
  EXPECT_NEAR(of_half.offset_s, of_all.offset_s, 0.008)
      << "as rows of the full-size image they would be 20 ms early";
}

TEST_F(ContrastOfLidar, IsLowerWithWrongExtrinsics) {
  Recording recording = drive();
  const ContrastFit right = fit(recording, 1, returns());
  EXPECT_GT(right.now(), 0.25);
  Rigid3d& extrinsics = recording.cameras[1].calibration.body_from_sensor;
  extrinsics.linear() = extrinsics.linear() * so3_exp({0, 0.03, 0});  // 4 pixels
  EXPECT_LT(fit(recording, 1, returns()).now(), 0.5 * right.now());
}

TEST_F(ContrastOfLidar, IsUnobservableWithoutCorrelation) {
  std::vector<LidarSample> grey = returns();
  for (LidarSample& sample : grey) sample.intensity = 100;
  EXPECT_FALSE(fit(drive(), 0, grey).observable) << "equal intensities";
  testing::SyntheticNoise noise(12);
  for (LidarSample& sample : grey) sample.intensity = static_cast<float>(noise.uniform(0, 250));
  const ContrastFit random = fit(drive(), 0, grey);
  EXPECT_FALSE(random.observable);
  EXPECT_EQ(random.offset_s, 0);
  EXPECT_LT(std::abs(random.now()), 0.05);
}

TEST_F(ContrastOfLidar, IsUnobservableWithoutReturns) {
  const ContrastFit nothing = fit(drive(), 0, {});
  EXPECT_FALSE(nothing.observable);
  EXPECT_EQ(nothing.cells, 0);
}

}  // namespace
}  // namespace redrive
