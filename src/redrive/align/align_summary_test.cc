// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align_summary.h"

#include <numbers>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

namespace redrive {
namespace {

AlignResult made_result() {
  AlignResult result;
  result.frames.resize(2);
  result.corrections.resize(2);
  result.corrections[1].sigma << 0.03, 0.04, 0, 0, 0, std::numbers::pi / 180;
  CameraCorrection camera{.name = "FRONT"};
  camera.extrinsics << 0.1, 0.2, 0.3, 0, 0, std::numbers::pi;
  camera.extrinsic_sigmas[1] = 0.01;
  camera.extrinsic_sigmas[5] = std::numbers::pi / 2;
  camera.offset_s = -0.012;
  result.camera_corrections = {camera};
  result.bundle.cameras = {{.observations = 9, .used = 8, .initial_px = 3, .aligned_px = 0.5}};
  result.bundle.ties_of_camera = {4};
  return result;
}

TEST(AlignSummary, TakesTheWorstFrame) {
  EXPECT_DOUBLE_EQ(worst_sigma(made_result()).translation_m, 0.05);
  EXPECT_DOUBLE_EQ(worst_sigma(made_result()).rotation_deg, 1);
}

TEST(AlignSummary, JsonHasUnitsAndNullsWhereNothingIsDetermined) {
  AlignResult result = made_result();
  const nlohmann::json json = alignment_to_json(result), &front = json.at("cameras").at("FRONT");
  EXPECT_EQ(front.at("translation_m"), (std::vector<double>{0.1, 0.2, 0.3}));
  EXPECT_EQ(front.at("translation_sigma_m"), nlohmann::json::parse("[null, 0.01, null]"));
  EXPECT_DOUBLE_EQ(front.at("rotation_deg").at(2), 180);
  EXPECT_DOUBLE_EQ(front.at("rotation_sigma_deg").at(2), 90);
  EXPECT_EQ(front.at("time_offset_s"), -0.012);
  EXPECT_TRUE(front.at("time_offset_sigma_s").is_null());
  EXPECT_TRUE(front.at("edge_score").at("initial").is_null());
  EXPECT_EQ(front.at("error_px").at("aligned"), 0.5);
  EXPECT_EQ(front.at("lidar_ties").at("points"), 4);
  EXPECT_TRUE(json.at("lidar").is_null());
  EXPECT_TRUE(json.at("ground_truth").is_null());

  result.bundle.lidar_points = 7;
  result.bundle.lidar_rms_m = 0.02;
  result.lidar_elevation_rad = std::numbers::pi / 180;
  result.initial_vs_ground_truth = TrajectoryRegistration{};
  result.aligned_vs_ground_truth = TrajectoryRegistration{.residual_m = 0.004};
  const nlohmann::json more = alignment_to_json(result);
  EXPECT_EQ(more.at("lidar").at("residual_m").at("aligned"), 0.02);
  EXPECT_DOUBLE_EQ(more.at("lidar").at("elevation_deg"), 1);
  EXPECT_TRUE(more.at("lidar").at("elevation_sigma_deg").is_null());
  EXPECT_EQ(more.at("ground_truth").at("aligned").at("residual_m"), 0.004);
}

}  // namespace
}  // namespace redrive
