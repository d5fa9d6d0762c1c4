// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/lidar_images.h"

#include <gtest/gtest.h>

#include "redrive/eval/standing_lidar_testing.h"

namespace redrive {
namespace {

std::vector<Eigen::Vector3d> points_on_a_wall() {
  std::vector<Eigen::Vector3d> points;
  for (int i = -20; i < 20; ++i) points.emplace_back(20, 0.53 * i, 0.31 * (i % 7));
  return points;
}

class LidarImages : public StandingLidarTest {
 protected:
  LidarImages() : StandingLidarTest(points_on_a_wall()) {}
  std::vector<ImageRow> images(float wall_m) {
    PaintBackend backend([](const auto&, const auto&) { return std::array<float, 3>{}; },
                         [&](const auto&, const auto& direction) { return wall_m / direction[0]; });
    return lidar_image_rows(run_, backend);
  }
};

TEST_F(LidarImages, ShowTheRecordedScanBesideTheRenderedOne) {
  std::vector<ImageRow> rows = images(20);
  ASSERT_EQ(rows.size(), 2u) << "no intensities";
  for (const ImageRow& row : rows) {
    EXPECT_NE(row.title.find("LiDAR, frame 12, held out"), std::string::npos) << row.title;
    ASSERT_EQ(row.images.size(), 2u);
    std::size_t painted = 0;
    for (std::size_t i = 0; i < row.images[0].image.rgb.size(); i += 3)
      painted += row.images[0].image.rgb[i + 2] != 40;
    EXPECT_GE(painted, 40u);
  }
  EXPECT_EQ(rows[0].images[0].image.rgb, rows[0].images[1].image.rgb);
  rows = images(30);
  EXPECT_NE(rows[0].images[0].image.rgb, rows[0].images[1].image.rgb) << "another range";
  EXPECT_NE(rows[1].images[0].image.rgb, rows[1].images[1].image.rgb) << "another place";
}

TEST_F(LidarImages, AreNoneWhereNoScanIsHeldOut) {
  for (View& view : run_.scene.views) view.held_out = false;
  EXPECT_TRUE(images(20).empty());
}

}  // namespace
}  // namespace redrive
