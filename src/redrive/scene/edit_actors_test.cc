// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/edit_actors.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"

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
    MovingObject car{.id = id, .type = "CAR", .deforms = false, .size_m = {4, 2, 1.5}, .keys = {}};
    for (int i = 0; i <= 20; ++i) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() = Vector3d(i, id == 3 ? 0 : 4, 0);
      car.keys.push_back({100'000'000ll * i, pose, {10, 0, 0}});
    }
    scene.actors.push_back(car);
  }
  for (int i = 0; i <= 20; ++i) scene.frames.push_back({i, 100'000'000ll * i, Rigid3d::Identity()});
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

TEST(EditActors, NamesWhatTheDriveDoesNotHave) {
  for (const auto& [text, field] : std::vector<std::pair<std::string, std::string>>{
           {R"({"actors": {"5": {}}})", "actors.5"},
           {R"({"actors": {"3": {"body": 8}}})", "actors.3.body"},
           {R"({"actors": {"3": {"hide_s": [3, 4]}}})", "actors.3.hide_s[0]"},
           {R"({"copies": [{"of": 5, "id": 6}]})", "copies[0].of"},
           {R"({"copies": [{"of": 3, "id": 17}]})", "copies[0].id"}}) {
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
