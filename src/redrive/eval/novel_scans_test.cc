// SPDX-License-Identifier: Apache-2.0
// Scans of places where the car never was, of a model whose depth is a formula.
#include "redrive/eval/novel_scans.h"

#include <filesystem>

#include <gmock/gmock.h>

#include "redrive/eval/evaluate.h"
#include "redrive/eval/standing_lidar_testing.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;

constexpr double kWall_m = 20;  // ahead of the frames, in the world

std::vector<Eigen::Vector3d> points_ahead() {
  std::vector<Eigen::Vector3d> points;
  for (int i = 0; i < 10; ++i) points.emplace_back(kWall_m, 0.1 * i, 0);
  return points;
}

class NovelScansTest : public StandingLidarTest {
 protected:
  NovelScansTest() : StandingLidarTest(points_ahead()) {
    std::filesystem::create_directories(lidar_);
    run_.recording.novel = {{"ahead", lidar_.parent_path() / "poses.json"}};
  }
  void write_poses(const std::string& pose) {
    write_file(
        lidar_.parent_path() / "poses.json",
        R"({"images": [{"file": "a.jpg", "camera": "FRONT", "frame_id": 11, )" + pose + "}]}");
  }
  /// Writes a scan from 5 m ahead, the last three points a hundredth too far.
  void write_scan(const std::string& name) {
    std::vector<LidarRecord> scan;
    for (int i = 0; i < 10; ++i)
      scan.push_back({(i < 7 ? 1 : 1.01) * Eigen::Vector3d(kWall_m - 5, 0.1 * i, 0),
                      run_.recording.frames[1].t_ns});
    write_file(lidar_ / name, make_las(scan));
  }
  std::map<std::string, LidarScore> score() {
    PaintBackend wall([](const auto&, const auto&) { return std::array<float, 3>{}; },
                      [](const auto& origin, const auto& direction) {
                        return (float{kWall_m} - origin[0]) / direction[0];
                      });
    evaluation_ = evaluate(run_, wall);
    return evaluation_.novel_lidar;
  }

  const std::filesystem::path lidar_ = folder_.path / "novel" / "ahead" / "lidar";
  Evaluation evaluation_;
};

TEST_F(NovelScansTest, AreScoredFromTheShiftedPose) {
  write_poses(R"("shift_body_m": [5, 0, 0])");
  write_scan("frame_11.las");
  const auto found = score();
  ASSERT_TRUE(found.contains("ahead"));
  const LidarScore& ahead = found.at("ahead");
  EXPECT_EQ(ahead.revolutions, 1);
  EXPECT_EQ(ahead.returns, 10);
  EXPECT_NEAR(ahead.range_error_m, 0, 1e-3);
  EXPECT_NEAR(ahead.mean_range_error_m, 0.3 * 0.15, 1e-3);
  EXPECT_EQ(ahead.near_hit_rate, 1);
}

// Ground truth 3 m behind the run's own poses: the alignment moves it back.
TEST_F(NovelScansTest, AreScoredFromTheTruePose) {
  Recording& recording = run_.recording;
  recording.ground_truth_frames = recording.frames;
  for (FramePose& frame : recording.ground_truth_frames)
    frame.global_from_body.translate(Eigen::Vector3d(-3, 0, 0));
  const Rigid3d pose =
      recording.ground_truth_frames[1].global_from_body * Eigen::Translation3d(5, 0, 0);
  std::string rows;
  for (int r = 0; r < 4; ++r) {
    rows += r > 0 ? ", [" : "[";
    for (int c = 0; c < 4; ++c) {
      char number[40];
      std::snprintf(number, sizeof number, "%s%.17g", c > 0 ? ", " : "", pose.matrix()(r, c));
      rows += number;
    }
    rows += "]";
  }
  write_poses("\"RT_ECEF_body\": [" + rows + "]");
  write_scan("frame_11.las");
  const auto found = score();
  ASSERT_TRUE(found.contains("ahead"));
  EXPECT_NEAR(found.at("ahead").range_error_m, 0, 1e-3);
}

TEST_F(NovelScansTest, FilesThatAreNoneOfThemAreNamed) {
  write_poses(R"("shift_body_m": [5, 0, 0])");
  write_scan("frame_11.las");
  write_file(lidar_ / "notes.txt", "");
  EXPECT_EQ(score().size(), 1u);
  ASSERT_EQ(evaluation_.damaged.size(), 1u);
  EXPECT_THAT(evaluation_.damaged[0].what, HasSubstr("notes.txt"));
}

TEST_F(NovelScansTest, NeedAPoseAndPoints) {
  write_poses(R"("shift_body_m": [5, 0, 0])");
  EXPECT_TRUE(score().empty()) << "no scan";
  write_scan("frame_12.las");
  EXPECT_THAT(testing::input_error([&] { score(); }),
              AllOf(HasSubstr("poses.json"), HasSubstr("must have a view of frame 12")));
  std::filesystem::remove(lidar_ / "frame_12.las");
  write_file(lidar_ / "frame_11.las", "LASF");
  EXPECT_THAT(testing::input_error([&] { score(); }),
              AllOf(HasSubstr("frame_11.las"), HasSubstr("truncated")));
}

}  // namespace
}  // namespace redrive
