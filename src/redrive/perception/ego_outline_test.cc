// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/ego_outline.h"

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

/// Uniform in 0..1, a function of two integers.
double noise(std::int64_t a, std::int64_t b) {
  return random_unit(random_key(1, kStreamTest, static_cast<std::uint64_t>(a)),
                     static_cast<std::uint64_t>(b));
}

/// A drive along x over a plane of grey squares of 0.4 m under a uniform sky, with lane lines, seen
/// by a camera 1.3 m up that looks ahead. From row `bonnet`[column] on, the vehicle: uniform paint
/// with a crease every 40 columns.
class EgoOutline : public ::testing::Test {
 protected:
  EgoOutline() {
    camera_.model = OpenCvPinhole{};
    camera_.fx = camera_.fy = 110;
    camera_.cx = 79.5;
    camera_.cy = 40;
    camera_.width = 160;
    camera_.height = 96;
    body_from_camera_.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    body_from_camera_.translation() = Eigen::Vector3d(1.5, 0, 1.3);
  }

  /// `road`: contrast of the squares. `translation_m`: distance driven per frame.
  std::vector<GreyView> drive(const std::vector<int>& bonnet, double road = 40,
                              double translation_m = 0.7, int frames = 30) {
    std::vector<GreyView> views;
    for (int n = 0; n < frames; ++n) {
      Rigid3d world_from_body = Rigid3d::Identity();
      world_from_body.translation().x() = n * translation_m;
      cv::Mat grey(camera_.height, camera_.width, CV_32F, 180.0f);
      for (int y = 0; y < camera_.height; ++y)
        for (int x = 0; x < camera_.width; ++x) {
          float& value = grey.at<float>(y, x);
          value += static_cast<float>(4 * noise(n, y * 1000 + x));  // sensor noise
          if (y >= bonnet[x]) {
            value = x % 40 == 20 ? 20 : value - 100;
            continue;
          }
          const Eigen::Vector3d ray =
              (world_from_body * body_from_camera_).linear() * *camera_.unproject({x, y});
          if (ray.z() >= 0) continue;
          const Eigen::Vector3d p =
              (world_from_body * body_from_camera_).translation() - 1.3 / ray.z() * ray;
          value += static_cast<float>(
              road * (noise(std::llround(p.x() / 0.4), std::llround(p.y() / 0.4)) - 1));
          // Antialiased as by a lens: at least a pixel and a half wide.
          const double width_m = std::max(0.1, 1.5 * (1.3 / -ray.z()) / 110);
          value +=
              static_cast<float>(90 * std::exp(-std::pow((std::abs(p.y()) - 1.8) / width_m, 2)));
        }
      views.push_back({grey, world_from_body, n * 66'666'667ll});
    }
    return views;
  }
  std::vector<int> none() const { return std::vector<int>(160, camera_.height); }

  Camera camera_;
  Rigid3d body_from_camera_ = Rigid3d::Identity();
};

TEST_F(EgoOutline, FindsABonnetByDay) {
  std::vector<int> bonnet = none();
  for (int x = 25; x < 140; ++x) bonnet[x] = 78 + (x - 80) * (x - 80) / 400;
  const std::vector<int> found = find_ego_outline(camera_, body_from_camera_, drive(bonnet));
  ASSERT_EQ(found.size(), 160u);
  int both = 0, either = 0;
  for (int x = 0; x < 160; ++x) {
    both += camera_.height - std::max(found[x], bonnet[x]);
    either += camera_.height - std::min(found[x], bonnet[x]);
  }
  EXPECT_GT(both, 0.9 * either);
}

// Dark, without squares, with static lane lines: the only evidence is the edge of the bonnet and
// its creases.
TEST_F(EgoOutline, FindsABonnetOnAUniformRoad) {
  const std::vector<int> bonnet(160, 80);
  const std::vector<int> found = find_ego_outline(camera_, body_from_camera_, drive(bonnet, 0));
  for (int x = 0; x < 160; ++x) EXPECT_NEAR(found[x], 80, 2) << x;
}

TEST_F(EgoOutline, DoesNotTakeRoadSkyOrLaneLinesForTheVehicle) {
  for (const double road : {0.0, 5.0, 40.0})
    EXPECT_EQ(find_ego_outline(camera_, body_from_camera_, drive(none(), road)), none()) << road;
}

TEST_F(EgoOutline, FindsNothingWithoutDriving) {
  const std::vector<int> bonnet(160, 80);
  EXPECT_EQ(find_ego_outline(camera_, body_from_camera_, drive(bonnet, 40, 0.01)), none());
  EXPECT_EQ(find_ego_outline(camera_, body_from_camera_, drive(bonnet, 40, 2, 7)), none());
}

// Static structure above the horizon (dirt on the lens, a cloud) or ahead of the car is not taken
// for it.
TEST_F(EgoOutline, SearchesTheVolumeOfACarOnly) {
  std::vector<GreyView> views = drive(none());
  for (GreyView& view : views) view.grey(cv::Rect(60, 20, 30, 20)).setTo(20);
  EXPECT_EQ(find_ego_outline(camera_, body_from_camera_, views), none());
}

}  // namespace
}  // namespace redrive
