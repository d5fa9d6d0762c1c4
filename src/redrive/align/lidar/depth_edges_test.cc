// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/lidar/depth_edges.h"

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

constexpr int kWidth = 160, kHeight = 100;

/// A wall at 5 m left of column 80 in front of one at 20 m, returns 3 pixels apart.
std::vector<ProjectedReturn> wall_before_wall() {
  std::vector<ProjectedReturn> returns;
  for (double y = 2; y < kHeight; y += 3)
    for (double x = 1; x < kWidth; x += 3) returns.push_back({{x, y}, x < 80 ? 5.0 : 20.0});
  return returns;
}

cv::Mat step_at(int column) {
  cv::Mat grey(kHeight, kWidth, CV_8U, cv::Scalar(60));
  grey.colRange(column, kWidth).setTo(180);
  return grey;
}

cv::Mat noise() {
  cv::Mat grey(kHeight, kWidth, CV_8U);
  for (std::size_t i = 0; i < grey.total(); ++i)
    grey.data[i] = static_cast<std::uint8_t>(255 * random_unit(random_key(3, kStreamTest, i), 0));
  return grey;
}

const cv::Mat& everywhere() {
  static const cv::Mat usable(kHeight, kWidth, CV_8U, cv::Scalar(255));
  return usable;
}

TEST(DepthEdges, AreStepsBetweenNeighbouringReturns) {
  const std::vector<DepthEdge> edges = find_depth_edges(wall_before_wall(), {kWidth, kHeight});
  EXPECT_EQ(edges.size(), 33u);  // one a row of returns
  for (const DepthEdge& edge : edges) {
    EXPECT_EQ(edge.near_px.x(), 79);
    EXPECT_EQ(edge.far_px.x(), 82);
    EXPECT_EQ(edge.near_px.y(), edge.far_px.y());
  }
  std::vector<ProjectedReturn> sloping = wall_before_wall();
  for (ProjectedReturn& r : sloping) r.distance_m = 5 + 0.1 * r.pixel.x();
  EXPECT_TRUE(find_depth_edges(sloping, {kWidth, kHeight}).empty()) << "no step";
}

// The image changes only at its step: between the returns, or 7 pixels beside them.
TEST(DepthEdges, ScoreIsOneOnTheImagesEdges) {
  const std::vector<DepthEdge> edges = find_depth_edges(wall_before_wall(), {kWidth, kHeight});
  EXPECT_GT(score_depth_edges(step_at(81), everywhere(), edges).score(), 0.97);
  EXPECT_LT(score_depth_edges(step_at(88), everywhere(), edges).score(), 0.3);
  EXPECT_GT(score_depth_edges(step_at(88), everywhere(), edges, {7, 0}).score(), 0.97);
  EXPECT_GT(score_depth_edges(step_at(81), everywhere(), edges, {0, 5}).score(), 0.97)
      << "along the edge nothing changes";
  cv::Mat transposed = step_at(81).t(), usable = everywhere().t();
  std::vector<DepthEdge> swapped = edges;
  for (DepthEdge& edge : swapped) edge = {edge.near_px.reverse(), edge.far_px.reverse()};
  EXPECT_GT(score_depth_edges(transposed, usable, swapped).score(), 0.97);
}

TEST(DepthEdges, ScoreIsAHalfByChance) {
  const std::vector<DepthEdge> edges = find_depth_edges(wall_before_wall(), {kWidth, kHeight});
  EXPECT_NEAR(score_depth_edges(noise(), everywhere(), edges).score(), 0.5, 0.05);
}

TEST(DepthEdges, MaskedPixelsDoNotCount) {
  cv::Mat usable = everywhere().clone();
  usable.rowRange(0, 50).setTo(0);
  const std::vector<DepthEdge> edges = find_depth_edges(wall_before_wall(), {kWidth, kHeight});
  EXPECT_EQ(score_depth_edges(step_at(81), usable, edges).edges, 17);
}

}  // namespace
}  // namespace redrive
