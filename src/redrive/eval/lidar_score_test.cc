// SPDX-License-Identifier: Apache-2.0
// Scores of a model whose depth is a formula, against recorded points of a wall.
#include "redrive/eval/lidar_score.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/methods/nerf/nerf_model.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/render/paint_backend_testing.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

TEST(ChamferDistance, IsTheMeanOfBothDirections) {
  const std::vector<Eigen::Vector3f> a = {{0, 0, 0}, {4, 0, 0}}, b = {{1, 0, 0}};
  EXPECT_DOUBLE_EQ(chamfer_distance(a, a), 0);
  EXPECT_DOUBLE_EQ(chamfer_distance(a, b), ((1 + 3) / 2.0 + 1) / 2);
  EXPECT_DOUBLE_EQ(chamfer_distance(b, a), chamfer_distance(a, b));
}

std::array<float, 3> black(const std::array<float, 3>&, const std::array<float, 3>&) { return {}; }

/// Revolutions of 10 points on a wall 20 m ahead of the standing sensor, of every frame. Frame 12
/// is held out.
class LidarScoreTest : public ::testing::Test {
 protected:
  LidarScoreTest() {
    auto model = std::make_unique<NerfModel>();
    model->config.width = 32;
    model->samples = 4;
    model->parameters = Buffer<float>(nerf_parameter_count(model->config));
    run_.state.model = std::move(model);
    run_.recording = make_test_recording(folder_.path, 4);
    Recording& recording = run_.recording;
    recording.reader = aimotive::make_reader();
    recording.body_from_lidar = Rigid3d::Identity();
    for (FramePose& frame : recording.frames)
      frame.global_from_body = recording.frames[0].global_from_body;
    for (const FramePose& frame : recording.frames) {
      std::vector<LidarRecord> points;
      for (int i = 0; i < 10; ++i) points.push_back({{20, 0.1 * i, 0}, frame.t_ns});
      const std::string name = "frame_" + std::to_string(frame.id) + ".las";
      folder_.write(name, make_las(points));
      recording.lidar_files.push_back({frame.id, folder_.path / name});
    }
    run_.scene = make_scene(recording, {});
    for (View& view : run_.scene.views) view.held_out = view.frame == 2;
  }
  std::optional<LidarScore> score(PaintBackend& backend) {
    const MovingObjects none({}, run_.recording.frames, run_.scene.global_from_world);
    return score_lidar(run_, backend, held_out_revolutions(run_), none);
  }

  TemporaryFolder folder_;
  redrive::Run run_;
};

TEST_F(LidarScoreTest, FollowsFromTheRanges) {
  // The first return is exact, the next five are 0.1 m too far, two 1 m, two have none.
  const auto too_far_m = [](long i) { return i == 0 ? 0.0f : i < 6 ? 0.1f : 1.0f; };
  PaintBackend backend(black, [&](const auto&, const auto& direction) {
    const long i = std::lround(10 * 20 * direction[1] / direction[0]);
    return i < 8 ? 20 / direction[0] + too_far_m(i) : 0;
  });
  const auto found = score(backend);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->revolutions, 1);
  EXPECT_EQ(found->returns, 10);
  EXPECT_NEAR(found->hit_rate, 0.8, 1e-12);
  EXPECT_NEAR(found->near_hit_rate, 0.6, 1e-12);
  EXPECT_NEAR(found->range_error_m, 0.1, 1e-5);
  std::vector<Eigen::Vector3f> recorded, rendered;
  for (int i = 0; i < 10; ++i) {
    recorded.emplace_back(20, 0.1f * static_cast<float>(i), 0);
    if (i < 8) rendered.push_back(recorded.back() + too_far_m(i) * recorded.back().normalized());
  }
  EXPECT_NEAR(found->chamfer_m, chamfer_distance(recorded, rendered), 1e-5);
}

// A sensor that reports the strongest and the last return sees a second wall through the first.
TEST_F(LidarScoreTest, ARayWithTwoReturnsCountsOnce) {
  for (const FrameFile& file : run_.recording.lidar_files) {
    const std::int64_t t_ns = run_.recording.frames[file.frame_id - 10].t_ns;
    std::vector<LidarRecord> points;
    for (int i = 0; i < 10; ++i)
      for (const double range_m : {40.0, 20.0})
        points.push_back({{range_m, 0.1 * i * range_m / 20, 0}, t_ns});
    write_file(file.path, make_las(points));
  }
  PaintBackend backend(black, [&](const auto&, const auto& direction) {
    const long i = std::lround(10 * 20 * direction[1] / direction[0]);
    return (i < 6 ? 20 : 40) / direction[0];
  });
  const auto found = score(backend);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->returns, 10);
  EXPECT_EQ(found->near_hit_rate, 1);
  EXPECT_NEAR(found->range_error_m, 0, 1e-2);
}

TEST_F(LidarScoreTest, HasNoRangeErrorWithoutAReturn) {
  PaintBackend backend(black, [](const auto&, const auto&) { return 0.0f; });
  const auto found = score(backend);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->hit_rate, 0);
  EXPECT_TRUE(std::isnan(found->range_error_m));
  EXPECT_TRUE(std::isnan(found->chamfer_m));
}

TEST_F(LidarScoreTest, OnlyRevolutionsThatDidNotTrainAreScored) {
  EXPECT_EQ(held_out_revolutions(run_), std::vector<std::int64_t>{12});
  std::vector<FrameFile>& files = run_.recording.lidar_files;
  files.insert(files.begin() + 2, files[2]);
  EXPECT_EQ(held_out_revolutions(run_), std::vector<std::int64_t>{12}) << "two of the frame";
  for (View& view : run_.scene.views) view.held_out = false;
  EXPECT_TRUE(held_out_revolutions(run_).empty());
}

}  // namespace
}  // namespace redrive
