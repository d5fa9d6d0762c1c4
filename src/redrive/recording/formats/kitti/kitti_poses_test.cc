// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_poses.h"

#include <utility>

#include <numbers>

#include "redrive/recording/formats/kitti/kitti_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

std::string packet(const std::string& first_six) {
  std::string text = first_six;
  for (int i = 6; i < 30; ++i) text += " 1";
  return text;
}

TEST(KittiTimestamps, ReadsNanosecondsSince1970) {
  const auto times = kitti::parse_timestamps(
      "2011-09-26 13:10:51.175862102\n\n2011-09-26 13:10:51.2\n2011-09-27 00:00:00\n", "t.txt");
  ASSERT_EQ(times.size(), 4u);
  EXPECT_EQ(times[0], 1317042651175862102);  // date -u -d "2011-09-26 13:10:51" +%s
  EXPECT_FALSE(times[1]);
  EXPECT_EQ(times[2], 1317042651200000000);
  EXPECT_EQ(times[3], 1317081600000000000);
}

TEST(KittiTimestamps, RejectsInvalidValues) {
  const auto message = [](const std::string& text) {
    const std::string message =
        input_error([&] { kitti::parse_timestamps(text, "oxts/timestamps.txt"); });
    EXPECT_THAT(message, HasSubstr("oxts/timestamps.txt: ")) << text;
    return message;
  };
  EXPECT_THAT(message(""), HasSubstr("is empty"));
  EXPECT_THAT(message("2011-09-26\n"), HasSubstr("line 1, number of values = 1"));
  for (const std::string date : {"2011-02-29", "2011-13-01", "11-09-26", "2011/09/26", "nan"})
    EXPECT_THAT(message(date + " 13:10:51.1\n"), HasSubstr("line 1, date = " + date));
  for (const std::string time : {"24:00:00", "13:60:00", "13:10:61", "13:10", "13:10:51.",
                                 "13:10:51.1234567890", "13:10:5x", "-1:10:51"})
    EXPECT_THAT(message("2011-09-26 " + time + "\n"), HasSubstr("line 1, time = " + time));
  EXPECT_THAT(message("2011-09-26 13:10:51.2\n2011-09-26 13:10:51.2\n"),
              AllOf(HasSubstr("line 2, time"), HasSubstr("not after")));
}

TEST(KittiOxts, PlacesTheImuOnTheEllipsoid) {
  // On the equator, facing east, at the prime meridian and a quarter turn on.
  const Rigid3d east = kitti::parse_oxts(packet("0 0 100 0 0 0"), "0.txt");
  EXPECT_TRUE(east.translation().isApprox(Eigen::Vector3d(6378237, 0, 0), 1e-15));
  Eigen::Matrix3d expected;
  expected << 0, 0, 1, 1, 0, 0, 0, 1, 0;  // east, north, up
  EXPECT_TRUE(east.linear().isApprox(expected, 1e-15));
  const Rigid3d quarter = kitti::parse_oxts(packet("0 90 100 0 0 0"), "0.txt");
  EXPECT_LT((quarter.translation() - Eigen::Vector3d(0, 6378237, 0)).norm(), 1e-8);
  // The pole is at the semi-minor axis.
  const Rigid3d pole = kitti::parse_oxts(packet("90 0 0 0 0 0"), "0.txt");
  EXPECT_LT((pole.translation() - Eigen::Vector3d(0, 0, 6356752.314245)).norm(), 1e-5);
}

TEST(KittiOxts, RotatesByRollPitchAndYaw) {
  // On the equator ECEF is (up, east, north) of ENU (x, y, z).
  const auto in_enu = [](const std::string& angles, const Eigen::Vector3d& axis) {
    const Eigen::Vector3d ecef =
        kitti::parse_oxts(packet("0 0 0 " + angles), "0.txt").linear() * axis;
    return Eigen::Vector3d(ecef.y(), ecef.z(), ecef.x());
  };
  const double small = 0.1;
  const auto x = Eigen::Vector3d::UnitX(), y = Eigen::Vector3d::UnitY();
  // Yaw turns to the left, from east to north; pitch lowers the front; roll raises the left side.
  EXPECT_TRUE(in_enu("0 0 0.1", x).isApprox(Eigen::Vector3d(std::cos(small), std::sin(small), 0)));
  EXPECT_TRUE(in_enu("0 0.1 0", x).isApprox(Eigen::Vector3d(std::cos(small), 0, -std::sin(small))));
  EXPECT_TRUE(in_enu("0.1 0 0", y).isApprox(Eigen::Vector3d(0, std::cos(small), std::sin(small))));
  // Roll about the vehicle's axis after yaw: facing north, left is west.
  EXPECT_TRUE(in_enu("0.1 0 1.5707963267948966", y)
                  .isApprox(Eigen::Vector3d(-std::cos(small), 0, std::sin(small))));
}

TEST(KittiOxts, RejectsInvalidValues) {
  const auto message = [](const std::string& text) {
    const std::string message = input_error([&] { kitti::parse_oxts(text, "oxts/data/7.txt"); });
    EXPECT_THAT(message, HasSubstr("oxts/data/7.txt: ")) << text;
    return message;
  };
  const std::string whole = packet("49 8 110 0 0 1");
  EXPECT_THAT(message(whole.substr(0, whole.size() - 2)),
              AllOf(HasSubstr("number of values = 29"), HasSubstr("expected 30")));
  EXPECT_THAT(message(whole + " 1"), HasSubstr("number of values = 31"));
  EXPECT_THAT(message(""), HasSubstr("is empty"));
  EXPECT_THAT(message(whole + "\n" + whole), HasSubstr("number of lines = 2"));
  EXPECT_THAT(message(packet("91 8 110 0 0 1")), HasSubstr("latitude = 91"));
  EXPECT_THAT(message(packet("49 nan 110 0 0 1")), HasSubstr("longitude = nan"));
  EXPECT_THAT(message(packet("49 8 1e6 0 0 1")), HasSubstr("altitude = 1e6"));
  EXPECT_THAT(message(packet("49 8 110 90 0 1")), HasSubstr("roll = 90"));
  EXPECT_THAT(message(packet("49 8 110 0 x 1")), HasSubstr("pitch = x"));
  EXPECT_THAT(message(packet("49 8 110 0 0 180")), HasSubstr("yaw = 180"));
  EXPECT_THAT(message(whole.substr(0, whole.size() - 1) + "inf"), HasSubstr("value 30 = inf"));
}

TEST(KittiOdometry, ReadsTimesAndPoses) {
  EXPECT_THAT(kitti::parse_times("0.000000e+00\n1.036190e-01\n", "times.txt"),
              ::testing::ElementsAre(::testing::Optional(0), ::testing::Optional(103'619'000)));
  const auto poses = kitti::parse_poses("0 -1 0 3 1 0 0 4 0 0 1 5\n", "poses/04.txt");
  ASSERT_EQ(poses.size(), 1u);
  EXPECT_TRUE((*poses[0] * Eigen::Vector3d(1, 2, 3)).isApprox(Eigen::Vector3d(1, 5, 8), 1e-15));
}

TEST(KittiOdometry, RejectsInvalidValues) {
  const auto times = [](const std::string& text) {
    return input_error([&] { kitti::parse_times(text, "times.txt"); });
  };
  EXPECT_THAT(times(""), HasSubstr("times.txt: is empty"));
  EXPECT_THAT(times("0\n0\n"), HasSubstr("line 2, time = 0 s: is not after"));
  EXPECT_THAT(times("0\nnan\n"), HasSubstr("line 2, time = nan"));
  EXPECT_THAT(times("-1\n"), HasSubstr("line 1, time = -1"));
  EXPECT_THAT(times("0 1\n"), HasSubstr("line 1, number of values = 2"));
  EXPECT_THAT(times("0\n\n1\n"), HasSubstr("line 2, number of values = 0"));
  const auto poses = [](const std::string& text) {
    return input_error([&] { kitti::parse_poses(text, "poses/04.txt"); });
  };
  EXPECT_THAT(poses("\n"), HasSubstr("poses/04.txt: is empty"));
  EXPECT_THAT(poses("1 0 0 0 0 1 0 0 0 0 1\n"), HasSubstr("line 1, number of values = 11"));
  EXPECT_THAT(poses("1 0 0 0 0 1 0 nan 0 0 1 0\n"), HasSubstr("line 1, value 8 = nan"));
  EXPECT_THAT(poses("1 0 0 1e8 0 1 0 0 0 0 1 0\n"), HasSubstr("line 1, value 4 = 1e8"));
  EXPECT_THAT(poses("1 0 0 0 0 1 0 0 0 0 -1 0\n"),
              AllOf(HasSubstr("line 1 = "), HasSubstr("reflection")));
}

// A line that cannot be read costs its own frame.
TEST(KittiPoses, DamagedLinesAreLeftOutAndNamed) {
  std::vector<DamagedRecord> records;
  const DamagedList damaged{"poses", &records};
  const auto there = [](const auto& values) {
    std::vector<bool> has;
    for (const auto& value : values) has.push_back(value.has_value());
    return has;
  };
  const auto named = [&] {
    std::vector<std::int64_t> ids;
    for (const DamagedRecord& record : std::exchange(records, {})) ids.push_back(record.frame_id);
    return ids;
  };
  using Flags = std::vector<bool>;
  using Ids = std::vector<std::int64_t>;
  EXPECT_EQ(there(kitti::parse_times("0\n0.1\nx\n0.3\n", "t", &damaged)), (Flags{1, 1, 0, 1}));
  EXPECT_EQ(named(), (Ids{2}));
  EXPECT_EQ(there(kitti::parse_times("0\n0.1\n9\n0.3\n0.4\n", "t", &damaged)),
            (Flags{1, 1, 0, 1, 1}));
  EXPECT_EQ(named(), (Ids{2}));
  EXPECT_EQ(there(kitti::parse_times("0\n0.1\n0.05\n0.3\n", "t", &damaged)), (Flags{1, 1, 0, 1}));
  EXPECT_EQ(named(), (Ids{2}));
  const std::string time = "2011-09-26 13:10:5";
  EXPECT_EQ(there(kitti::parse_timestamps(
                time + "1.1\n\n" + time + "1.3\n2011-09-26 #\n" + time + "0.5\n" + time + "1.9\n",
                "t", &damaged)),
            (Flags{1, 0, 1, 0, 0, 1}));
  EXPECT_EQ(named(), (Ids{3, 4}));  // an empty line is none that is damaged
  const std::string pose = "1 0 0 0 0 1 0 0 0 0 1 0\n", nan = "1 0 0 nan 0 1 0 0 0 0 1 0\n",
                    scaled = "2 0 0 0 0 1 0 0 0 0 1 0\n";
  EXPECT_EQ(there(kitti::parse_poses(pose + nan + pose + scaled, "p", &damaged)),
            (Flags{1, 0, 1, 0}));
  EXPECT_EQ(named(), (Ids{1, 3}));
  const auto frames =
      kitti::parse_frame_poses("3 " + pose + "4 " + nan + "7 " + pose, "p", &damaged);
  EXPECT_EQ(frames.size(), 2u);
  EXPECT_EQ(named(), (Ids{4}));
}

}  // namespace
}  // namespace redrive
