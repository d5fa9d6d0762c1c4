// SPDX-License-Identifier: Apache-2.0
// The cameras of a real car; skipped where its recording is missing.
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/camera/camera.h"
#include "redrive/recording/formats/calibration_json.h"

namespace redrive {
namespace {

TEST(RealCameras, RoundTripOverTheWholeImage) {
  const std::filesystem::path file =
      REDRIVE_SHARED "/data/aimotive_night/sensor/calibration/calibration.json";
  if (!std::filesystem::exists(file)) GTEST_SKIP() << file << " is not here";
  const auto cameras = parse_calibration(read_file(file), file, nullptr);
  ASSERT_EQ(cameras.size(), 4u);
  for (const CameraCalibration& calibration : cameras) {
    SCOPED_TRACE(calibration.name);
    const Camera camera = make_camera(calibration);
    std::size_t seen = 0;
    for (int v = 0; v < camera.height; ++v)
      for (int u = 0; u < camera.width; ++u) {
        const auto direction = camera.unproject({double(u), double(v)});
        if (!direction) continue;
        ++seen;
        const auto back = camera.project(*direction);
        ASSERT_TRUE(back) << u << ' ' << v;
        ASSERT_LT((*back - Eigen::Vector2d(u, v)).norm(), 1e-6) << u << ' ' << v;
      }
    // Both pinholes are one-to-one everywhere (9 k1^2 < 20 k2); the fisheyes' corners lie beyond
    // their fold.
    const std::size_t pixels = std::size_t(camera.width) * camera.height;
    if (calibration.model == "mei") {
      EXPECT_GT(seen, pixels * 7 / 10);
      EXPECT_LT(seen, pixels);
    } else {
      EXPECT_EQ(seen, pixels);
    }
  }
}

}  // namespace
}  // namespace redrive
