// SPDX-License-Identifier: Apache-2.0
// LiDAR scans: rendered from a short run of the sample street, exported, scored, and read back.
#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/image/exr.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/lidar/ply.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr const char* kScanCamera = "F_MIDLONGRANGECAM_CL";

class Scan : public EndToEnd {
 protected:
  /// A short run on images and LiDAR of the frames 1001 and 1003.
  void train() const {
    const ProgramResult ended =
        redrive({"train", street_.string(), "--out", run_.string(), "--method", "splat", "--frames",
                 "1000:1003", "--holdout-every", "2", "--max-steps", "40", "--threads", "2",
                 "--truth-poses"});
    ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  }
  ProgramResult rendered(const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"render", "lidar", run_.string(), "--threads", "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return redrive(arguments);
  }

  const fs::path street_ = fs::path(REDRIVE_SAMPLES) / "street", run_ = folder_ / "run",
                 las_ = folder_ / "scan.las", velodyne_ = folder_ / "velodyne_points";
};

TEST_F(Scan, RendersScoresAndExports) {
  train();
  // The recorded revolution as it is recorded: body axes, times of the recording.
  const ProgramResult recorded =
      rendered({"--frame", "1001", "--out", las_.string(), "--points-in", "body"});
  ASSERT_EQ(recorded.exit_code, kExitOk) << recorded.err;
  EXPECT_THAT(recorded.out, AllOf(HasSubstr(las_.string()), HasSubstr(" lost, ")));
  const std::vector<LidarPoint> points = read_las(las_),
                                given = read_las(street_ / "dynamic/raw-revolutions" /
                                                 "frame_0001001.las");
  ASSERT_GT(points.size(), given.size() / 2);
  ASSERT_LE(points.size(), given.size());
  // Each has the direction of a recorded point of its time, seen from the sensor.
  const Eigen::Vector3f sensor(1.1574f, 0.0013f, 1.6823f);
  int near = 0;
  for (const LidarPoint& point : points) {
    const Eigen::Vector3f ray = point.in_body_m - sensor;
    float best = 10, range_m = 0;
    for (const LidarPoint& other : given)
      if (other.t_ns == point.t_ns)
        if (const float angle = (ray.normalized() - (other.in_body_m - sensor).normalized()).norm();
            angle < best) {
          best = angle;
          range_m = (other.in_body_m - sensor).norm();
        }
    ASSERT_LT(best, 1e-3f) << "0.1 mm at 0.5 m and more";
    near += std::abs(ray.norm() - range_m) < 0.1f * range_m;
  }
  EXPECT_GT(near, 0.6 * static_cast<double>(points.size())) << "of " << points.size();

  const auto before = contents(folder_);
  EXPECT_EQ(rendered({"--frame", "1001", "--out", las_.string()}).exit_code, kExitUsage);
  for (const std::vector<std::string>& wrong : std::vector<std::vector<std::string>>{
           {"--sensor", "64", "--frame", "1001", "--out", las_.string() + ".txt"},
           {"--sensor", "1:2:3", "--frame", "1001", "--out", "a.las"},
           {"--frame", "77", "--out", (folder_ / "a.las").string()},
           {"--out", (folder_ / "a.las").string()},
           {"--frame", "1001", "--out", velodyne_.string()},
           {"--sensor", "64", "--actors", "5", "--frame", "1001", "--out", "a.las"},
           {"--rate", "20", "--frame", "1001", "--out", "a.las"},
           {"--range", "5:2", "--frame", "1001", "--out", (folder_ / "a.pcd").string()},
           {"--lens", kScanCamera, "--mount", "0,0,2,0,0,0", "--frame", "1001", "--out",
            (folder_ / "a.pcd").string()},
           {"--frame", "1001", "--out", (folder_ / "a.png").string()}})
    EXPECT_EQ(rendered(wrong).exit_code, kExitUsage) << wrong[1];
  EXPECT_EQ(contents(folder_), before) << "nothing written";

  // A user-defined sensor, two metres above the road.
  const fs::path pcd = folder_ / "scan.pcd";
  const ProgramResult own =
      rendered({"--sensor", "4:-20:-5", "--azimuth-steps", "90", "--rate", "20", "--mount",
                "0,0,2,0,0,0", "--frame", "1001", "--out", pcd.string(), "--points-in", "world"});
  ASSERT_EQ(own.exit_code, kExitOk) << own.err;
  EXPECT_THAT(own.out, HasSubstr("of 360 rays"));
  EXPECT_THAT(read_file(pcd), HasSubstr("FIELDS x y z intensity ring time"));

  // A known sensor, whose rays are drawn, in the layout of nuScenes, and the recording's own.
  const fs::path sweep = folder_ / "sweep.pcd.bin", ply = folder_ / "scan.ply";
  const ProgramResult known = rendered({"--sensor", "vlp-16", "--azimuth-steps", "90", "--seed",
                                        "1", "--frame", "1001", "--out", sweep.string()});
  ASSERT_EQ(known.exit_code, kExitOk) << known.err;
  EXPECT_THAT(known.out, HasSubstr("of 1440 rays"));
  EXPECT_EQ(fs::file_size(sweep) % 20, 0u);
  const ProgramResult estimated =
      rendered({"--sensor", "estimated", "--frame", "1001", "--out", ply.string()});
  ASSERT_EQ(estimated.exit_code, kExitOk) << estimated.err;
  EXPECT_THAT(estimated.out, HasSubstr("steps a turn"));
  // After 40 steps few rays but the recorded ones meet a surface.
  EXPECT_GT(read_ply(ply).size(), points.size() / 3) << estimated.out;

  // All frames as KITTI has them.
  const ProgramResult all = rendered({"--out", velodyne_.string()});
  ASSERT_EQ(all.exit_code, kExitOk) << all.err;
  EXPECT_THAT(all.out, HasSubstr("4 revolutions"));
  const fs::path stamps = velodyne_ / "timestamps_start.txt";
  const auto times = kitti::parse_timestamps(read_file(stamps), stamps);
  ASSERT_EQ(times.size(), 1004u);
  EXPECT_FALSE(times[999]);
  EXPECT_TRUE(times[1000] && times[1003]);
  EXPECT_EQ(fs::file_size(velodyne_ / "data/0000001001.bin"), 16 * points.size());

  // Frames 1000 and 1002 are held out.
  const ProgramResult scored = redrive({"eval", run_.string(), "--json", "--threads", "2"});
  ASSERT_EQ(scored.exit_code, kExitOk) << scored.err;
  const nlohmann::json lidar = nlohmann::json::parse(scored.out).at("lidar");
  EXPECT_EQ(lidar.at("revolutions"), 2);
  EXPECT_GT(lidar.at("hit_rate"), 0.1);
  EXPECT_GE(lidar.at("hit_rate"), lidar.at("near_hit_rate"));
  EXPECT_GT(lidar.at("range_error_m"), 0);
  const ProgramResult table = redrive({"eval", run_.string(), "--threads", "2"});
  EXPECT_THAT(table.out, HasSubstr("LiDAR of 2 held-out frames, "));

  // The recorded returns of the run's frames, motion compensated.
  const fs::path cloud = folder_ / "cloud.las";
  const ProgramResult exported =
      redrive({"export", run_.string(), "--to", "las", cloud.string(), "--threads", "2"});
  ASSERT_EQ(exported.exit_code, kExitOk) << exported.err;
  EXPECT_GT(read_las(cloud).size(), 2 * given.size());
  EXPECT_THAT(exported.out, HasSubstr("poses of the run"));

  const fs::path depth = folder_ / "depth.exr";
  const ProgramResult image =
      redrive({"render", run_.string(), "--camera", kScanCamera, "--frame", "1001", "--threads",
               "2", "--out", (folder_ / "a.png").string(), "--depth", depth.string()});
  if (exr_obstacle()) {
    EXPECT_EQ(image.exit_code, kExitUsage);
    EXPECT_THAT(image.err, HasSubstr("tinyexr"));
    EXPECT_FALSE(fs::exists(folder_ / "a.png"));
  } else {
    EXPECT_EQ(image.exit_code, kExitOk) << image.err;
    EXPECT_TRUE(read_file(depth).starts_with("\x76\x2f\x31\x01"));
  }
}

TEST_F(Scan, NeedsALidar) {
  const fs::path run = trained("run", 2);
  const ProgramResult recorded = rendered({"--frame", "100", "--out", las_.string()});
  EXPECT_EQ(recorded.exit_code, kExitUsage);
  EXPECT_THAT(recorded.err, HasSubstr("the recording has no LiDAR"));
  const ProgramResult own =
      rendered({"--sensor", "-10,0", "--frame", "100", "--out", las_.string()});
  EXPECT_EQ(own.exit_code, kExitUsage);
  EXPECT_THAT(own.err, HasSubstr("needs --mount"));
  const ProgramResult mounted = rendered({"--sensor", "-10,0", "--azimuth-steps", "10", "--mount",
                                          "0,0,2,0,0,0", "--frame", "100", "--out", las_.string()});
  EXPECT_EQ(mounted.exit_code, kExitOk) << mounted.err;
  EXPECT_LE(read_las(las_).size(), 20u);
  const ProgramResult exported =
      redrive({"export", drive_.string(), "--to", "las", (folder_ / "a.las").string()});
  EXPECT_EQ(exported.exit_code, kExitBadInput);
  EXPECT_THAT(exported.err, HasSubstr("no LiDAR revolutions"));
}

}  // namespace
}  // namespace redrive::testing
