// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/road_map.h"

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <sstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <pugixml.hpp>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"

namespace redrive {
namespace {

using Eigen::Vector3d;
using ::testing::HasSubstr;

constexpr double kSlope = 0.05, kRoll_rad = 0.03;

/// A pose on a plane that rises along x and to the left, after `along` metres of a bend.
Rigid3d pose_on_bend(double along, double radius_m) {
  const double turn = along / radius_m;
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = Eigen::AngleAxisd(turn, Vector3d::UnitZ()).toRotationMatrix() *
                  Eigen::AngleAxisd(kRoll_rad, Vector3d::UnitX()).toRotationMatrix();
  pose.translation() << radius_m * std::sin(turn), radius_m * (1 - std::cos(turn)),
      100 + kSlope * along;
  return pose;
}

RoadMapInput bend(double from_m, double to_m, double step_m) {
  RoadMapInput input;
  input.name = "a <bend>";
  for (double s = from_m; s <= to_m; s += step_m) input.driven.push_back(pose_on_bend(s, 60));
  return input;
}

class Map {
 public:
  explicit Map(const RoadMap& from) {
    EXPECT_TRUE(document_.load_string(from.xml.c_str()));
    root_ = document_.child("OpenDRIVE");
  }
  pugi::xml_node root() const { return root_; }
  pugi::xml_node road(int index = 0) const {
    pugi::xml_node road = root_.child("road");
    for (; index > 0; --index) road = road.next_sibling("road");
    return road;
  }
  /// The value of a profile at a place of the first road.
  double profile(const char* profile, const char* entry, double s) const {
    double value = NAN;
    for (const pugi::xml_node node : road().child(profile).children(entry)) {
      const double ds = s - node.attribute("s").as_double();
      if (ds < 0) break;
      const auto c = [&](const char* name) { return node.attribute(name).as_double(); };
      value = c("a") + ds * (c("b") + ds * (c("c") + ds * c("d")));
    }
    return value;
  }

 private:
  pugi::xml_document document_;
  pugi::xml_node root_;
};

TEST(RoadMap, IsTheDrivenWay) {
  const RoadMap made = make_road_map(bend(0, 80, 1));
  EXPECT_EQ(made.roads, 1);
  EXPECT_NEAR(made.length_m, 80, 0.01);
  EXPECT_LE(made.deviation_m, 0.05);
  const Map map(made);
  EXPECT_EQ(map.root().child("header").attribute("revMajor").as_int(), 1);
  EXPECT_EQ(map.root().child("header").attribute("revMinor").as_int(), 7);
  EXPECT_STREQ(map.root().child("header").attribute("name").as_string(), "a <bend>");
  EXPECT_FALSE(map.root().child("header").child("geoReference"));
  double along = 0;
  for (const pugi::xml_node geometry : map.road().child("planView").children("geometry")) {
    EXPECT_NEAR(geometry.attribute("s").as_double(), along, 1e-6);
    along += geometry.attribute("length").as_double();
    EXPECT_EQ(std::distance(geometry.begin(), geometry.end()), 1);
    EXPECT_NEAR(geometry.child("arc").attribute("curvature").as_double(1. / 60), 1. / 60, 1e-4);
  }
  EXPECT_NEAR(map.road().attribute("length").as_double(), along, 1e-6);
  for (const double s : {0.0, 20.0, 61.0}) {
    EXPECT_NEAR(map.profile("elevationProfile", "elevation", s), 100 + kSlope * s, 0.06);
    EXPECT_NEAR(map.profile("lateralProfile", "superelevation", s), kRoll_rad, 1e-3);
  }
  const pugi::xml_node lanes = map.road().child("lanes");
  const pugi::xml_node lane = lanes.child("laneSection").child("right").child("lane");
  EXPECT_STREQ(lane.attribute("type").as_string(), "driving");
  EXPECT_EQ(lane.child("width").attribute("a").as_double(), kAssumedLane_m);
  EXPECT_EQ(lanes.child("laneOffset").attribute("a").as_double(), kAssumedLane_m / 2);
  EXPECT_STREQ(lane.child("userData").attribute("value").as_string(), "assumed");
}

/// A bend on the level with ground `below_m` below the poses, which rises to the left; a kerb.
RoadMapInput bend_on_ground(double below_m, double rise) {
  RoadMapInput input;
  for (double s = 0; s <= 60; s += 1) {
    input.driven.push_back(pose_on_bend(s, 60));
    input.driven.back().translation().z() = 100;
  }
  for (double s = 0; s <= 60; s += 0.25)
    for (double t = -3; t <= 3; t += 0.25) {
      const double turn = s / 60;
      input.ground.emplace_back((60 - t) * std::sin(turn), 60 - (60 - t) * std::cos(turn),
                                100 - below_m + rise * t + (t > 1.7 ? 0.3 : 0));
    }
  return input;
}

TEST(RoadMap, TakesHeightsFromTheGroundWhereItAgrees) {
  // below the poses, rise, and what the map has
  for (const auto& [below_m, rise, height_m, roll] :
       {std::array{0.05, 0.06, 99.95, 0.06}, std::array{0.3, 0.06, 100.0, kRoll_rad},
        std::array{0.05, 0.2, 100.0, kRoll_rad}}) {
    const Map map(make_road_map(bend_on_ground(below_m, rise)));
    for (const double s : {10.0, 33.0, 50.0}) {
      EXPECT_NEAR(map.profile("elevationProfile", "elevation", s), height_m, 0.01);
      EXPECT_NEAR(map.profile("lateralProfile", "superelevation", s), roll, 0.01);
    }
  }
}

/// A place beside the bend.
Vector3d beside_bend(double along, double across) {
  const double turn = along / 60;
  return {(60 - across) * std::sin(turn), 60 - (60 - across) * std::cos(turn),
          100 + kSlope * along + kRoll_rad * across};
}

/// A bend with markings at 1.5 m, -1.7 m and 4.6 m, and kerbs at 5 m and -2.1 m.
RoadMapInput marked_bend() {
  RoadMapInput input = bend(0, 60, 1);
  for (double s = 0; s <= 60; s += 0.4)
    for (double t = -6; t <= 6; t += 0.05) {
      const double edge = std::min({std::abs(t - 1.5), std::abs(t + 1.7), std::abs(t - 4.6)});
      const Vector3d at = beside_bend(s, t) + Vector3d(0, 0, t > 5 || t < -2.1 ? 0.12 : 0);
      input.returns.push_back({at, edge < 0.08 ? 0.5 : 0.1});
      input.returns.push_back({at + Vector3d(0, 0, 1), t > 0 ? 0.9 : 0.0});  // no ground
    }
  return input;
}

TEST(RoadMap, LaneToTheLeftGoesAsItsTrafficDoes) {
  const auto ids = [](double vehicle_along, RoadMap* made) {
    RoadMapInput input = marked_bend();
    const Vector3d at = beside_bend(20, 3), next = beside_bend(21, 3);
    if (vehicle_along != 0)
      input.vehicles.push_back({1, at.head<2>(), vehicle_along * (next - at).head<2>()});
    // others, where no lane is
    input.vehicles.push_back({2, beside_bend(20, 7).head<2>(), (at - next).head<2>()});
    *made = make_road_map(input);
    const Map map(*made);
    const pugi::xml_node section = map.road().child("lanes").child("laneSection");
    std::string text;
    for (const char* side : {"left", "right"})
      for (const pugi::xml_node lane : section.child(side).children("lane")) {
        text += std::string(lane.attribute("id").as_string()) + ":";
        for (const pugi::xml_node note : lane.children("userData"))
          text += std::string(note.attribute("value").as_string()) + ",";
        text += " ";
      }
    return text;
  };
  RoadMap made;
  EXPECT_EQ(ids(0, &made), "1:between markings,assumed, -1:between markings,true, ");
  EXPECT_EQ(made.left, 1);
  EXPECT_EQ(made.right, 0) << "a kerb";
  EXPECT_EQ(ids(-5, &made), "1:between markings,as traffic, -1:between markings,true, ");
  EXPECT_EQ(ids(8, &made), "-1:between markings,as traffic, -2:between markings,true, ");
  EXPECT_NEAR(Map(made).road().child("lanes").child("laneOffset").attribute("a").as_double(), 4.6,
              0.06);
}

TEST(RoadMap, LaneLiesBetweenMarkings) {
  const RoadMap made = make_road_map(marked_bend());
  EXPECT_EQ(made.measured, 1);
  const Map map(made);
  const pugi::xml_node lanes = map.road().child("lanes");
  const pugi::xml_node lane = lanes.child("laneSection").child("right").child("lane");
  EXPECT_NEAR(lanes.child("laneOffset").attribute("a").as_double(), 1.5, 0.06);
  EXPECT_NEAR(lane.child("width").attribute("a").as_double(), 3.2, 0.1);
  EXPECT_STREQ(lane.child("userData").attribute("value").as_string(), "between markings");
}

// SUMO makes a network of it: its lanes lie where they were driven.
TEST(RoadMap, NetconvertTakesIt) {
  if (std::system("command -v netconvert >/dev/null") != 0)
    GTEST_SKIP() << "there is no netconvert";
  const TemporaryFolder folder;
  folder.write("map.xodr", make_road_map(marked_bend()).xml);
  const std::string map_file = (folder.path / "map.xodr").string(),
                    net_file = (folder.path / "net.xml").string();
  ASSERT_EQ(std::system(("SUMO_HOME=/usr/share/sumo netconvert --offset.disable-normalization "
                         "--opendrive-files " +
                         map_file + " -o " + net_file + " >" + net_file + ".log 2>&1")
                            .c_str()),
            0)
      << read_file(net_file + ".log");
  pugi::xml_document net;
  ASSERT_TRUE(net.load_file(net_file.c_str()));
  const auto lane = [&](const char* edge) {
    return net.child("net").find_child_by_attribute("edge", "id", edge).child("lane");
  };
  EXPECT_NEAR(lane("1").attribute("width").as_double(), 3.1, 0.1) << "the one that comes";
  const pugi::xml_node driven = lane("-1");
  EXPECT_NEAR(driven.attribute("width").as_double(), 3.2, 0.1);
  EXPECT_NEAR(driven.attribute("length").as_double(), 60, 1);
  std::istringstream shape(driven.attribute("shape").as_string());
  int points = 0;
  for (std::string point; shape >> point; ++points) {
    Vector3d at = Vector3d::Zero();
    ASSERT_EQ(std::sscanf(point.c_str(), "%lf,%lf,%lf", &at.x(), &at.y(), &at.z()), 3) << point;
    double least_m = 1e9;
    for (double s = -1; s <= 61; s += 0.01)  // the way is 0.1 m to the left of the lane's middle
      least_m = std::min(least_m, (beside_bend(s, -0.1) - at).norm());
    // Half of an edge's 6 cm, and 5 cm of the fit.
    EXPECT_LT(least_m, 0.08) << point;
  }
  EXPECT_GT(points, 10);
}

TEST(RoadMap, LeavesOutStandstillAndReversing) {
  RoadMapInput input = bend(0, 40, 1);
  for (int i = 0; i < 100; ++i) {  // it stands
    input.driven.push_back(pose_on_bend(40, 60));
    input.driven.back().translation() += Vector3d(0.03 * std::sin(i), 0.03 * std::cos(3 * i), 0);
  }
  for (double s = 39; s >= 30; s -= 1) input.driven.push_back(pose_on_bend(s, 60));
  for (double s = 31; s <= 70; s += 1) input.driven.push_back(pose_on_bend(s, 60));
  const RoadMap made = make_road_map(input);
  EXPECT_EQ(made.roads, 2);
  EXPECT_NEAR(made.length_m, 80, 0.3);
  EXPECT_NEAR(made.reversed_m, 10, 0.5);
  EXPECT_LE(made.deviation_m, 0.05);
  const Map map(made);
  EXPECT_STREQ(map.road(1).attribute("id").as_string(), "2");
  EXPECT_TRUE(make_road_map(bend(0, 4, 1)).xml.empty()) << "shorter than a road";
  EXPECT_TRUE(make_road_map({}).xml.empty());
}

TEST(RoadMap, SaysWhereOnTheEarthItLies) {
  RoadMapInput input = bend(0, 40, 1);
  input.origin = Geodetic{0.8, -0.2, 0};
  const Map map(make_road_map(input));
  const std::string place = map.root().child("header").child("geoReference").text().get();
  EXPECT_THAT(place, HasSubstr("+lat_0=45.836623610466 "));
  EXPECT_THAT(place, HasSubstr("+lon_0=-11.459155902616 "));
  EXPECT_THAT(place, HasSubstr("+=alt_0=0 "));
}

}  // namespace
}  // namespace redrive
