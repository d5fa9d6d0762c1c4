// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/feature_flow.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <opencv2/video/tracking.hpp>

#include "redrive/perception/nearest_to_rays.h"

namespace redrive {
namespace {

constexpr int kSide = 96;

/// A pattern of smooth waves, shifted to the right and down.
cv::Mat waves(double right, double down, int type) {
  cv::Mat image(kSide, kSide, CV_32F);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x) {
      const double u = x - right, v = y - down;
      image.at<float>(y, x) = static_cast<float>(128 + 50 * std::sin(0.5 * u) * std::cos(0.4 * v) +
                                                 40 * std::sin(0.17 * u + 0.23 * v));
    }
  cv::Mat out;
  image.convertTo(out, type);
  return out;
}

std::vector<cv::Mat> pyramid_of(const cv::Mat& image) {
  std::vector<cv::Mat> pyramid;
  cv::buildOpticalFlowPyramid(image, pyramid, {7, 7}, 2);
  return pyramid;
}

TEST(FeatureFlow, CornersOfBytesAndFloatsHaveTheSameLevels) {
  const cv::Mat usable(kSide, kSide, CV_8U, cv::Scalar(255));
  for (const double levels : {0.5, 4.0, 12.0}) {
    std::vector<cv::Point> of_bytes, of_floats;
    const CornerGrid grid{12, 5, 4, levels};
    // Rounded to whole levels, so that both images are the same.
    const cv::Mat bytes = waves(0, 0, CV_8U);
    cv::Mat floats;
    bytes.convertTo(floats, CV_32F);
    for_each_corner(bytes, usable, grid, [&](const cv::Point& at) { of_bytes.push_back(at); });
    for_each_corner(floats, usable, grid, [&](const cv::Point& at) { of_floats.push_back(at); });
    EXPECT_EQ(of_bytes, of_floats) << levels;
    if (levels < 1) {
      EXPECT_EQ(of_bytes.size(), 64u) << "one in each of 8 x 8 cells";
    }
    for (const cv::Point& at : of_bytes)
      EXPECT_TRUE(cv::Rect(4, 4, kSide - 8, kSide - 8).contains(at));
  }
}

TEST(FeatureFlow, CornersLieWhereTheImageIsStillUsable) {
  cv::Mat usable(kSide, kSide, CV_8U, cv::Scalar(255));
  int corners = 0;
  for_each_corner(waves(0, 0, CV_8U), usable, {12, 5, 0, 0.1}, [&](const cv::Point& at) {
    EXPECT_NE(usable.at<std::uint8_t>(at), 0);
    usable.setTo(0);
    ++corners;
  });
  EXPECT_EQ(corners, 1);
}

TEST(FeatureFlow, FindsShiftedPointsAndDropsWrongOnes) {
  const auto from = pyramid_of(waves(0, 0, CV_8U)), to = pyramid_of(waves(1.6, -0.7, CV_8U));
  const std::vector<cv::Point2f> at = {{30, 40}, {60, 50}, {93, 50}};
  const auto found = flow_there_and_back(from, to, at, at, {7, 2, 0.5f});
  for (int i = 0; i < 2; ++i) {
    ASSERT_TRUE(found[i]) << i;
    // Steps below 0.02 pixels end the search, in an image that is interpolated linearly.
    EXPECT_NEAR(found[i]->x, at[i].x + 1.6f, 0.1f) << i;
    EXPECT_NEAR(found[i]->y, at[i].y - 0.7f, 0.1f) << i;
  }
  EXPECT_FALSE(found[2]) << "it leaves the image";
  const auto flat = pyramid_of(cv::Mat(kSide, kSide, CV_8U, cv::Scalar(100)));
  EXPECT_FALSE(flow_there_and_back(from, flat, at, at, {7, 2, 0.5f})[0]);
  EXPECT_TRUE(flow_there_and_back(from, to, {}, {}, {}).empty());
}

TEST(NearestToRays, MeetsThePointOfTwoRaysAndRatesParallelOnes) {
  const Eigen::Vector3d point(3, -2, 20), right(2, 0, 0);
  const WorldRay rays[] = {{{0, 0, 0}, point.normalized()}, {right, (point - right).normalized()}};
  const NearestToRays nearest = nearest_to_rays(rays);
  EXPECT_LT((nearest.from_first - point).norm(), 1e-11);
  // Two unit rays at the angle a: the eigenvalues of A are 2, 1 + cos a and 1 - cos a.
  EXPECT_NEAR(nearest.least_eigenvalue, 1 - rays[0].direction.dot(rays[1].direction), 1e-15);
  const WorldRay parallel[] = {rays[0], {right, rays[0].direction}};
  EXPECT_NEAR(nearest_to_rays(parallel).least_eigenvalue, 0, 1e-15);
}

}  // namespace
}  // namespace redrive
