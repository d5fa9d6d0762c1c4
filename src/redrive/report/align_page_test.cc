// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/align_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/math/angles.h"
#include "redrive/report/html_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

// A rotation of the cameras about the body's z axis stands in the table under the name that the
// curves give to the same rotation of the frames.
TEST(AlignPage, RotationsHaveOneNameInTableAndCurves) {
  constexpr double kYaw_rad = 0.5 * kRadiansPerDegree, kSigma_rad = 0.05 * kRadiansPerDegree;
  const TemporaryFolder folder;
  const Recording recording = make_test_recording(folder.path, 2);
  AlignResult result;
  result.frames = recording.frames;
  for (std::size_t f = 0; f < recording.frames.size(); ++f) {
    Correction correction;
    correction.value << 0.01, 0, 0, 0, 0, kYaw_rad;
    correction.sigma << 0.001, 0, 0, 0, 0, kSigma_rad;
    result.corrections.push_back(correction);
  }
  for (const RecordedCamera& camera : recording.cameras) {
    result.cameras.push_back(camera.calibration);
    CameraCorrection correction;
    correction.name = camera.calibration.name;
    correction.extrinsics[5] = kYaw_rad;
    correction.extrinsic_sigmas = {0, 0, 0, std::nullopt, 0, kSigma_rad};
    result.camera_corrections.push_back(correction);
    result.bundle.cameras.emplace_back();
    result.bundle.ties_of_camera.push_back(0);
  }
  result.bundle.tracks = result.bundle.lidar_points = result.bundle.patches = result.bundle.rounds =
      2'000'000'000;
  result.seconds = 74;
  write_align_page(folder.path / "aligned", recording, result);
  const std::string html = without_heads(read_file(folder.path / "aligned/report.html")),
                    script = read_file(folder.path / "aligned/figures/rotation.gnuplot");
  EXPECT_THAT(html, HasSubstr("2000000000 tracks of image points, 2000000000 LiDAR points on "
                              "2000000000 flat patches; 2000000000 rounds, 74 s</p>"))
      << "nothing cut off";
  EXPECT_THAT(html, HasSubstr("<th>roll deg</th><th>pitch deg</th><th>yaw deg</th>"));
  EXPECT_THAT(html, HasSubstr("<td>unobservable</td><td>+0.000 \u00b1 0.000</td>"
                              "<td>+0.500 \u00b1 0.050</td>"));
  // For each curve: value, and two standard deviations below and above it.
  EXPECT_THAT(script, HasSubstr("\n0.0666667 0 0 0 0 0 0 0.5 0.4 0.6\n"));
  EXPECT_LT(script.find("title 'roll'"), script.find("title 'pitch'"));
  EXPECT_LT(script.find("title 'pitch'"), script.find("title 'yaw'"));
}

}  // namespace
}  // namespace redrive
