// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/edit_actors.h"

#include <numbers>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/edit/actor_body.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

using Eigen::Vector3d;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// Two cars that drive along x at 10 m/s in lanes 4 m apart, 3 and 17, for 2 s.
Scene two_cars() {
  Scene scene;
  scene.rig.resize(1);
  for (const std::int64_t id : {3, 17}) {
    MovingObject car{.id = id, .type = "CAR", .size_m = {4, 2, 1.5}, .keys = {}};
    for (int i = 0; i <= 20; ++i) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() = Vector3d(i, id == 3 ? 0 : 4, 0);
      car.keys.push_back({100'000'000ll * i, pose, {10, 0, 0}});
    }
    scene.actors.push_back(car);
  }
  for (int i = 0; i <= 20; ++i) scene.add_frame({i, 100'000'000ll * i, Rigid3d::Identity()});
  return scene;
}

Scene edited(const std::string& text) {
  Scene scene = two_cars();
  edit_actors(parse_traffic_edit(text, "edit.json"), &scene);
  return scene;
}

std::string refusal_of(const std::string& text) {
  try {
    edited(text);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

Vector3d position(const MovingObject& actor, double t_s) {
  return actor.world_from_box(std::llround(1e9 * t_s))->translation();
}

TEST(EditActors, MovesTurnsAndRecolours) {
  const Scene scene =
      edited(R"({"actors": {"17": {"shift_m": [2, 1, 0], "turn_deg": 90, "gain": [1, 0.5, 2]}}})");
  ASSERT_EQ(scene.actors.size(), 2u);
  EXPECT_LT((position(scene.actors[0], 1) - Vector3d(10, 0, 0)).norm(), 1e-9);
  EXPECT_LT((position(scene.actors[1], 1) - Vector3d(12, 5, 0)).norm(), 1e-9);
  EXPECT_NEAR(scene.actors[1].world_from_box(0)->linear()(1, 0), 1, 1e-9);
  EXPECT_THAT(scene.actors[1].gain, ElementsAre(1, 0.5, 2));
}

TEST(EditActors, RemovesHidesAndCopies) {
  const Scene scene = edited(R"({"actors": {"3": {"remove": true}, "17": {"hide_s": [0.5, 1]}},
                                 "copies": [{"of": 3, "id": 4, "shift_m": [-6, 0, 0]}]})");
  ASSERT_EQ(scene.actors.size(), 2u);
  EXPECT_EQ(scene.actors[0].id, 17);
  EXPECT_FALSE(scene.actors[0].world_from_box(700'000'000));
  EXPECT_TRUE(scene.actors[0].world_from_box(1'100'000'000));
  EXPECT_EQ(scene.actors[1].id, 4);
  EXPECT_EQ(scene.actors[1].body, 3);
  EXPECT_LT((position(scene.actors[1], 1) - Vector3d(4, 0, 0)).norm(), 1e-9);
}

TEST(EditActors, DrivesAtAnotherSpeedAndOnAnotherTrack) {
  const MovingObject slow = edited(R"({"actors": {"3": {"speed": 0.5}}})").actors[0];
  EXPECT_LT((position(slow, 1) - Vector3d(5, 0, 0)).norm(), 1e-6);
  EXPECT_LT((position(slow, 2) - Vector3d(10, 0, 0)).norm(), 1e-6);
  const MovingObject fast = edited(R"({"actors": {"3": {"speed": 2}}})").actors[0];
  EXPECT_LT((position(fast, 0.75) - Vector3d(15, 0, 0)).norm(), 1e-6);
  EXPECT_FALSE(fast.world_from_box(1'500'000'000)) << "its track has ended";
  const MovingObject still = edited(R"({"actors": {"3": {"speed": 0}}})").actors[0];
  EXPECT_LT((position(still, 2) - Vector3d(0, 0, 0)).norm(), 1e-9);
  const MovingObject own = edited(R"({"actors": {"3": {"track": [
      {"time_s": 0.5, "position_m": [1, 2, 3]},
      {"time_s": 1.5, "position_m": [1, 12, 3], "yaw_deg": 90}]}}})")
                               .actors[0];
  EXPECT_LT((position(own, 1) - Vector3d(1, 7, 3)).norm(), 1e-6);
  EXPECT_NEAR(own.world_from_box(1'000'000'000)->linear()(0, 0), std::sqrt(0.5), 1e-6);
  EXPECT_FALSE(own.world_from_box(300'000'000));
}

TEST(EditActors, MovesAlongTheRoadWhicheverWayTheObjectFaces) {
  Scene scene = two_cars();
  for (MovingObject::Key& key : scene.actors[1].keys)  // it comes towards us
    key.world_from_box.linear() = Eigen::AngleAxisd(std::numbers::pi, Vector3d::UnitZ()).matrix();
  for (FramePose& frame : scene.trajectory) {  // the road turns to the left behind x = 10
    frame.global_from_body.translation().x() = static_cast<double>(frame.id);
    if (frame.id > 10)
      frame.global_from_body.linear() =
          Eigen::AngleAxisd(std::numbers::pi / 2, Vector3d::UnitZ()).matrix();
  }
  edit_actors(parse_traffic_edit(
                  R"({"actors": {"17": {"shift_road_m": [0, 1, 0.5], "shift_m": [0, 2, 0]}}})",
                  "edit.json"),
              &scene);
  const MovingObject& car = scene.actors[1];
  EXPECT_LT((position(car, 0.5) - Vector3d(5, 4 + 1 - 2, 0.5)).norm(), 1e-9);
  EXPECT_LT((position(car, 1.5) - Vector3d(15 - 1, 4 - 2, 0.5)).norm(), 1e-9);
}

TEST(EditActors, ATrackOfItsOwnHasPitchAndRoll) {
  const MovingObject car = edited(R"({"actors": {"3": {"track": [
      {"time_s": 0, "position_m": [0, 0, 0], "pitch_deg": 30},
      {"time_s": 1, "position_m": [1, 0, 0], "roll_deg": 90, "yaw_deg": 90}]}}})")
                               .actors[0];
  EXPECT_LT((car.world_from_box(0)->linear().col(0) - Vector3d(std::sqrt(0.75), 0, 0.5)).norm(),
            1e-9);
  const Eigen::Matrix3d rolled = car.world_from_box(1'000'000'000)->linear();
  EXPECT_LT((rolled.col(0) - Vector3d(0, 1, 0)).norm(), 1e-9);
  EXPECT_LT((rolled.col(1) - Vector3d(0, 0, 1)).norm(), 1e-9) << "its left side is up";
}

TEST(EditActors, AnotherBodyStandsWhereTheOwnOneStood) {
  Scene scene = two_cars();
  scene.actors[1].size_m = {8, 2.5, 3.5};
  edit_actors(parse_traffic_edit(R"({"actors": {"3": {"body": 17}}})", "edit.json"), &scene);
  EXPECT_EQ(scene.actors[0].body, 17);
  EXPECT_EQ(scene.actors[0].size_m, Vector3d(8, 2.5, 3.5));
  EXPECT_LT((position(scene.actors[0], 1) - Vector3d(10, 0, 1)).norm(), 1e-9) << "2 m higher";
}

/// A folder with edit.json and van.ply, the body of a van of one Gaussian.
struct BodyFolder : TemporaryFolder {
  BodyFolder() {
    std::string van = "ply\nformat binary_little_endian 1.0\n";
    for (const std::string& comment : body_comments("VAN", {6, 2, 2.5}))
      van += "comment " + comment + "\n";
    van += "element vertex 1\n";
    for (const char* name : {"x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0",
                             "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"})
      van += std::string("property float ") + name + "\n";
    van += "end_header\n";
    for (int i = 0; i < 14; ++i) add_bytes(i == 10 ? 1.0f : 0.0f, &van);
    write("van.ply", van);
  }
  TrafficEdit edit(const std::string& text) const {
    return parse_traffic_edit(text, path / "edit.json");
  }
};

TEST(EditActors, ShowsAndAddsBodiesOfFiles) {
  const BodyFolder folder;
  Scene scene = two_cars();
  const std::vector<std::string> remarks =
      edit_actors(folder.edit(R"({"actors": {"3": {"body": {"file": "van.ply"}}},
                      "copies": [{"of": 17, "id": 18, "body": {"file": "van.ply"},
                                  "shift_m": [-20, 0, 0]}],
                      "added": [{"id": 50, "body": {"file": "van.ply"}, "track": [
                                  {"time_s": 0, "position_m": [0, -9, 1]},
                                  {"time_s": 2, "position_m": [8, -9, 1]}]}]})"),
                  &scene);
  EXPECT_THAT(remarks, ElementsAre());
  ASSERT_EQ(scene.actors.size(), 4u);
  for (const std::size_t i : {0, 2, 3}) {
    ASSERT_TRUE(scene.actors[i].imported) << i;
    EXPECT_EQ(scene.actors[i].imported->n, 1u);
    EXPECT_EQ(scene.actors[i].size_m, Vector3d(6, 2, 2.5));
  }
  EXPECT_FALSE(scene.actors[1].imported);
  EXPECT_NEAR(position(scene.actors[0], 1).z(), 0.5, 1e-9) << "a van is 1 m higher than a car";
  EXPECT_EQ(scene.actors[3].id, 50);
  EXPECT_LT((position(scene.actors[3], 1) - Vector3d(4, -9, 1)).norm(), 1e-6);

  // A second edit of the same objects.
  edit_actors(folder.edit(R"({"actors": {"17": {"body": 3}, "3": {"remove": true}}})"), &scene);
  EXPECT_TRUE(scene.actors[0].imported);
}

TEST(EditActors, ABodyThatCannotBeReadChangesNothing) {
  const BodyFolder folder;
  Scene scene = two_cars();
  folder.write("cut.ply", "ply\nformat");
  for (const char* text :
       {R"({"actors": {"3": {"remove": true}, "17": {"body": {"file": "cut.ply"}}}})",
        R"({"actors": {"3": {"remove": true}, "17": {"body": {"file": "none.ply"}}}})"}) {
    EXPECT_THROW(edit_actors(folder.edit(text), &scene), std::runtime_error) << text;
    EXPECT_EQ(scene.actors.size(), 2u) << text;
  }
}

TEST(EditActors, RemarksOnObjectsAtNoFrame) {
  Scene scene = two_cars();
  EXPECT_THAT(
      edit_actors(parse_traffic_edit(R"({"actors": {"3": {"hide_s": [0, 5]}}})", "e"), &scene),
      ElementsAre("object 3 is at no frame of the drive"));
}

TEST(EditActors, RemarksOnObjectsThatOverlap) {
  Scene scene = two_cars();
  EXPECT_THAT(edit_actors(parse_traffic_edit(R"({"actors": {"3": {"shift_m": [1, 2.5, 0]}}})", "e"),
                          &scene),
              ElementsAre("objects 3 and 17 overlap"));
  scene = two_cars();
  EXPECT_THAT(
      edit_actors(parse_traffic_edit(R"({"actors": {"3": {"shift_m": [9, 1, 0]}}})", "e"), &scene),
      ElementsAre());
}

TEST(EditActors, RemarksOnOverlapsAmongMany) {
  // A row of cars 6 m apart; every tenth one goes 5 m on, into the next one.
  Scene scene = two_cars();
  const MovingObject car = scene.actors[0];
  scene.actors.clear();
  std::string edit;
  for (int id = 1; id <= 300; ++id) {
    scene.actors.push_back(car);
    scene.actors.back().id = id;
    for (MovingObject::Key& key : scene.actors.back().keys)
      key.world_from_box.translation().x() += 6 * id;
    if (id % 10 == 0 && id < 300)
      edit += (edit.empty() ? "\"" : ", \"") + std::to_string(id) + R"(": {"shift_m": [5, 0, 0]})";
  }
  const std::vector<std::string> remarks =
      edit_actors(parse_traffic_edit("{\"actors\": {" + edit + "}}", "e"), &scene);
  ASSERT_EQ(remarks.size(), 29u);
  EXPECT_EQ(remarks[0], "objects 10 and 11 overlap");
  EXPECT_EQ(remarks[28], "objects 290 and 291 overlap");
}

TEST(EditActors, NamesWhatTheDriveDoesNotHave) {
  for (const auto& [text, field] : std::vector<std::pair<std::string, std::string>>{
           {R"({"actors": {"5": {}}})", "actors.5"},
           {R"({"actors": {"3": {"body": 8}}})", "actors.3.body"},
           {R"({"actors": {"3": {"hide_s": [3, 4]}}})", "actors.3.hide_s[0]"},
           {R"({"copies": [{"of": 5, "id": 6}]})", "copies[0].of"},
           {R"({"copies": [{"of": 3, "id": 17}]})", "copies[0].id"},
           {R"({"copies": [{"of": 3, "id": 4, "hide_s": [3, 4]}]})", "copies[0].hide_s[0]"},
           {R"({"actors": {"3": {"track": [{"time_s": 3, "position_m": [0, 0, 0]},
                                           {"time_s": 4, "position_m": [0, 0, 0]}]}}})",
            "actors.3.track[0].time_s"}}) {
    const std::string message = refusal_of(text);
    EXPECT_THAT(message, HasSubstr("edit.json")) << text;
    EXPECT_THAT(message, HasSubstr(field)) << text;
  }
  EXPECT_THAT(refusal_of(R"({"actors": {"5": {}}})"), HasSubstr("3, 17"));
}

TEST(SelectActors, KeepsSomeOrRefusesThem) {
  Scene scene = two_cars();
  select_actors("all", &scene);
  EXPECT_EQ(scene.actors.size(), 2u);
  select_actors("17", &scene);
  ASSERT_EQ(scene.actors.size(), 1u);
  EXPECT_EQ(scene.actors[0].id, 17);
  for (const char* wrong : {"3", "17,", "x", ""})
    EXPECT_THROW(select_actors(wrong, &scene), UsageError) << wrong;
  select_actors("none", &scene);
  EXPECT_TRUE(scene.actors.empty());
}

}  // namespace
}  // namespace redrive
