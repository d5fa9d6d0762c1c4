// SPDX-License-Identifier: Apache-2.0
// Scores of a model whose depth is a formula, against recorded points of a wall.
#include "redrive/eval/lidar_score.h"

#include <cmath>

#include <gtest/gtest.h>

#include "redrive/eval/standing_lidar_testing.h"
#include "redrive/render/made_field_testing.h"

namespace redrive {
namespace {

TEST(ChamferDistance, IsTheMeanOfBothDirections) {
  const std::vector<Eigen::Vector3f> a = {{0, 0, 0}, {4, 0, 0}}, b = {{1, 0, 0}};
  EXPECT_DOUBLE_EQ(chamfer_distance(a, a), 0);
  EXPECT_DOUBLE_EQ(chamfer_distance(a, b), ((1 + 3) / 2.0 + 1) / 2);
  EXPECT_DOUBLE_EQ(chamfer_distance(b, a), chamfer_distance(a, b));
}

std::array<float, 3> black(const std::array<float, 3>&, const std::array<float, 3>&) { return {}; }

/// 10 points on a wall 20 m ahead.
std::vector<Eigen::Vector3d> points_of_a_wall() {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 10; ++i) points.emplace_back(20, 0.1 * i, 0);
  return points;
}

class LidarScoreTest : public StandingLidarTest {
 protected:
  LidarScoreTest() : StandingLidarTest(points_of_a_wall()) {}
  /// `of`: the ray to point i of the wall, and beyond.
  void use_field(const std::function<MadeField::Ray(int i)>& of) {
    auto field = std::make_unique<MadeField>();
    field->has_signals = true;
    field->formula = [of](const auto&, const auto& direction) {
      return of(static_cast<int>(std::lround(10 * 20 * direction.y() / direction.x())));
    };
    run_.field_of_blocks = std::move(field);
  }
  std::optional<LidarScore> score_made() { return score(nothing_); }
  std::optional<LidarScore> score(PaintBackend& backend) {
    const MovingObjects none({}, run_.recording.frames, run_.scene.global_from_world);
    return score_lidar(run_, backend, held_out_revolutions(run_), none);
  }

  PaintBackend nothing_{black};
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
  EXPECT_NEAR(found->mean_range_error_m, (5 * 0.1 + 2 * 1) / 8, 1e-5);
  std::vector<Eigen::Vector3f> recorded, rendered;
  for (int i = 0; i < 10; ++i) {
    recorded.emplace_back(20, 0.1f * static_cast<float>(i), 0);
    if (i < 8) rendered.push_back(recorded.back() + too_far_m(i) * recorded.back().normalized());
  }
  EXPECT_NEAR(found->chamfer_m, chamfer_distance(recorded, rendered), 1e-5);
}

// A sensor that reports the strongest and the last return sees a second wall through the first.
TEST_F(LidarScoreTest, ARayWithTwoReturnsCountsOnce) {
  std::vector<LidarRecord> points;
  for (int i = 0; i < 10; ++i)
    for (const double range_m : {40.0, 20.0})
      points.push_back({{range_m, 0.1 * i * range_m / 20, 0}});
  write_scans(points);
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

TEST_F(LidarScoreTest, IntensitiesAreOfTheStrongerReturnOfARay) {
  std::vector<LidarRecord> points;
  for (int i = 0; i < 10; ++i) {
    const Eigen::Vector3d near(20, 0.1 * i, 0);
    const float weak = 0.1f, strong = i < 5 ? 0.5f : 1.0f;  // in both orders
    points.push_back({near, 0, i % 2 ? weak : strong});
    points.push_back({2 * near, 0, i % 2 ? strong : weak});
  }
  write_scans(points);
  use_field([](int) { return MadeField::Ray{20, 0, 0.8f}; });
  const auto found = score_made();
  ASSERT_TRUE(found && found->intensity_rmse);
  EXPECT_NEAR(*found->intensity_rmse, std::sqrt((0.3 * 0.3 + 0.2 * 0.2) / 2), 1e-4);
  EXPECT_FALSE(found->lost) << "the beams of the sensor are unknown";
}

TEST_F(LidarScoreTest, IntensitiesAreOfRenderedReturns) {
  std::vector<LidarRecord> points;
  for (const Eigen::Vector3d& point : points_of_a_wall()) points.push_back({point, 0, 1.0f});
  write_scans(points);
  // Errors of 0.5 and 0.1; rays that the field loses have none.
  use_field([](int i) { return MadeField::Ray{20, i < 6 ? 0.25f : 0.75f, i < 3 ? 0.5f : 0.9f}; });
  const auto found = score_made();
  ASSERT_TRUE(found && found->intensity_rmse);
  EXPECT_NEAR(*found->intensity_rmse, std::sqrt((0.5 * 0.5 + 0.1 * 0.1) / 2), 1e-4);
  EXPECT_NEAR(found->hit_rate, 0.6, 1e-12);
}

// Four returns, two of which the field has, and four lost rays, three of which it loses: right are
// 5 of 8. Of the lost: 3 found, 1 missed, 2 wrong.
TEST_F(LidarScoreTest, AccuracyAndF1OfLostRaysFollowFromTheCounts) {
  LidarReturns scan;
  scan.n = 4;
  scan.direction.resize(12);
  for (int i = 0; i < 8; ++i) {
    const Eigen::Vector3f direction = Eigen::Vector3f(20, 0.1f * float(i), 0).normalized();
    if (i >= 4) {
      scan.lost.push_back({direction, run_.recording.frames[0].t_ns});
      continue;
    }
    for (int k = 0; k < 3; ++k) scan.direction[4 * k + i] = direction[k];
    scan.range_m.push_back(20);
    scan.t_ns.push_back(run_.recording.frames[0].t_ns);
    scan.intensity.push_back(255);
  }
  use_field([](int i) {
    const bool lost = i < 2 || i > 4;
    return MadeField::Ray{20, lost ? 0.6f : 0.4f, 1};
  });
  const MovingObjects none;
  LidarScores scores(run_, nothing_, none);
  EXPECT_FALSE(scores.score()) << "nothing is scored";
  scores.add(scan, [](std::int64_t) { return Rigid3d::Identity(); });
  const auto found = scores.score();
  ASSERT_TRUE(found && found->lost);
  EXPECT_EQ(found->lost->rays, 8);
  EXPECT_NEAR(found->lost->accuracy, 5.0 / 8, 1e-12);
  EXPECT_NEAR(found->lost->f1, 2 * 3.0 / (2 * 3 + 1 + 2), 1e-12);
}

// Returns on objects that the run does not draw are not scored.
TEST_F(LidarScoreTest, LeavesOutObjectsWhereTheyAre) {
  LidarReturns scan;
  scan.n = 2;
  scan.direction = {1, 1, 0, 0, 0, 0};
  scan.direction[2 + 1] = 0.1f;
  scan.range_m = {20, 20};
  scan.t_ns.assign(2, run_.recording.frames[0].t_ns);
  scan.intensity = {0, 0};
  MovingObject object;
  object.size_m = {1, 1, 1};
  object.keys = {{scan.t_ns[0], Rigid3d(Eigen::Translation3d(20, 0, 0)), Eigen::Vector3d::Zero()}};
  use_field([](int) { return MadeField::Ray{20}; });
  const MovingObjects left_out(std::vector{object});
  LidarScores scores(run_, nothing_, left_out);
  scores.add(scan, [](std::int64_t) { return Rigid3d::Identity(); });
  ASSERT_TRUE(scores.score());
  EXPECT_EQ(scores.score()->returns, 1);
}

TEST_F(LidarScoreTest, HasNoRangeErrorWithoutAReturn) {
  PaintBackend backend(black, [](const auto&, const auto&) { return 0.0f; });
  const auto found = score(backend);
  ASSERT_TRUE(found);
  EXPECT_EQ(found->hit_rate, 0);
  EXPECT_TRUE(std::isnan(found->range_error_m));
  EXPECT_TRUE(std::isnan(found->chamfer_m));
}

TEST_F(LidarScoreTest, EachOfSeveralLidarsHasARow) {
  Recording& recording = run_.recording;
  recording.lidars.push_back({"second", Rigid3d(Eigen::Translation3d(0, 0, 0.5))});
  const std::vector<FrameFile> files = recording.lidar_files;
  for (const FrameFile& file : files)
    recording.lidar_files.push_back({file.frame_id, file.path, 1});
  EXPECT_EQ(held_out_revolutions(run_), std::vector<std::int64_t>{12});
  // What is rendered is the wall for rays of the first one, which are level.
  PaintBackend backend(black, [&](const auto&, const auto& direction) {
    return std::abs(direction[2]) < 1e-6f ? 20 / direction[0] : 0;
  });
  const MovingObjects none({}, recording.frames, run_.scene.global_from_world);
  std::map<std::string, LidarScore> each;
  const auto all = score_lidar(run_, backend, held_out_revolutions(run_), none, nullptr, &each);
  ASSERT_TRUE(all);
  EXPECT_EQ(all->returns, 20);
  EXPECT_EQ(all->revolutions, 2);
  EXPECT_NEAR(all->hit_rate, 0.5, 1e-12);
  ASSERT_EQ(each.size(), 2u);
  EXPECT_NEAR(each.at("lidar").near_hit_rate, 1, 1e-12);
  EXPECT_NEAR(each.at("second").hit_rate, 0, 1e-12);
  EXPECT_EQ(each.at("second").returns, 10);
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
