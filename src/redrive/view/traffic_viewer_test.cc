// SPDX-License-Identifier: Apache-2.0
// Moving objects in the viewer over loopback: picked, edited, dragged.
#include <set>

#include "redrive/base/error.h"
#include "redrive/view/viewer_testing.h"

namespace redrive::view {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

/// Cubes of 1 m on the axis of FRONT at frame 10, 7 before the surface and 8 behind it, that drive
/// 1 m in a second. `first`: id of the one before the surface.
std::vector<MovingObject> cubes(std::int64_t first = 7) {
  std::vector<MovingObject> cubes;
  for (const double ahead_m : {2.0, 6.0}) {
    MovingObject cube{
        .id = cubes.empty() ? first : 8, .type = "CAR", .size_m = {1, 1, 1}, .keys = {}};
    for (int i = 0; i <= 10; ++i) {
      Rigid3d pose = Rigid3d::Identity();
      pose.translation() = Eigen::Vector3d(2 + ahead_m + 0.1 * i, 0.1, 1.2);
      cube.keys.push_back({1'000'000'000 + 100'000'000ll * i, pose, {1, 0, 0}});
    }
    cubes.push_back(cube);
  }
  return cubes;
}

class TrafficViewerTest : public ViewerTest {
 protected:
  explicit TrafficViewerTest(const FirstEdit& edit = {}, std::int64_t first = 7)
      : ViewerTest(true, cubes(first), edit) {}

  static nlohmann::json edited(LoopbackClient& client, int id, const std::string& text) {
    client.send_message(
        nlohmann::json{{"type", "edit"}, {"id", id}, {"file", "my.json"}, {"text", text}}.dump());
    return wait_for(client, "edited", [id](const auto& header) { return header["id"] == id; })
        .header;
  }
  /// Returns the object in the middle of the image of frame 10.
  static nlohmann::json object_in_the_middle(LoopbackClient& client, int id) {
    client.send_message(view(id, "FRONT", 10).dump());
    full_image(client, id);
    client.send_message(nlohmann::json{{"type", "pick"}, {"id", id}, {"at", {0.5, 0.5}}}.dump());
    return wait_for(client, "picked").header["object"];
  }
};

TEST_F(TrafficViewerTest, PicksTheObjectThatNoSurfaceHides) {
  const auto client = connect();
  const nlohmann::json hello = next(*client).header;
  ASSERT_EQ(hello["objects"].size(), 2u);
  EXPECT_EQ(hello["objects"][0]["id"], 7);
  EXPECT_TRUE(hello["edit"].is_null());
  EXPECT_EQ(object_in_the_middle(*client, 1), 7);
  EXPECT_TRUE(
      edited(*client, 1, R"({"actors": {"7": {"shift_m": [0, 3, 0]}}})")["remarks"].empty());
  EXPECT_TRUE(object_in_the_middle(*client, 2).is_null()) << "the surface hides the other one";
  EXPECT_EQ(edited(*client, 2, R"({"actors": {"7": {"shift_m": [4, 0, 0]}}})")["remarks"],
            std::vector<std::string>{"objects 7 and 8 overlap"});
}

TEST_F(TrafficViewerTest, EditsForOnePageAndSaysWhatIsWrong) {
  const auto one = connect(), two = connect();
  EXPECT_EQ(edited(*one, 1, R"({"actors": {"7": {"remove": true}}})").value("error", ""), "");
  EXPECT_TRUE(object_in_the_middle(*one, 1).is_null());
  EXPECT_EQ(object_in_the_middle(*two, 1), 7);
  EXPECT_THAT(edited(*one, 2, R"({"actors": {"7": {"speed": 1000}}})").value("error", ""),
              AllOf(HasSubstr("my.json"), HasSubstr("actors.7.speed")));
  EXPECT_THAT(edited(*one, 3, R"({"actors": {"9": {}}})").value("error", ""),
              HasSubstr("actors.9"));
  EXPECT_THAT(edited(*one, 4, "{").value("error", ""), HasSubstr("my.json"));
  EXPECT_THAT(
      edited(*one, 6, R"({"actors": {"7": {"body": {"file": "/etc/passwd"}}}})").value("error", ""),
      HasSubstr("actors.7.body.file"));
  EXPECT_TRUE(object_in_the_middle(*one, 2).is_null()) << "the last one that was right holds";
  EXPECT_EQ(edited(*one, 5, "{}").value("error", ""), "");
  EXPECT_EQ(object_in_the_middle(*one, 3), 7);
}

TEST_F(TrafficViewerTest, DrawsTheSelectedObjectAndDragsIt) {
  const auto client = connect();
  nlohmann::json request = view(1, "FRONT", 10);
  request["object"] = 7;
  client->send_message(request.dump());
  std::set<std::string> kinds;
  const nlohmann::json header = full_image(*client, 1).header;
  for (const nlohmann::json& line : header["lines"]) kinds.insert(line["kind"]);
  EXPECT_EQ(kinds, (std::set<std::string>{"object", "handle"}));
  nlohmann::json drag = {
      {"type", "drag"},     {"id", 1},          {"object", 7},          {"turns", false},
      {"from", {0.5, 0.6}}, {"to", {0.5, 0.6}}, {"shift_m", {0, 0, 0}}, {"turn_deg", 0}};
  client->send_message(drag.dump());
  const nlohmann::json stays = wait_for(*client, "dragged").header;
  for (const nlohmann::json& moved : stays["shift_m"]) EXPECT_NEAR(moved.get<double>(), 0, 1e-6);
  drag["to"] = {0.4, 0.6};
  client->send_message(drag.dump());
  EXPECT_GT(wait_for(*client, "dragged").header["shift_m"][1].get<double>(), 0.1);
  drag["object"] = 9;
  client->send_message(drag.dump());
  EXPECT_FALSE(wait_for(*client, "dragged").header.contains("shift_m"));
}

/// An object that was found has an id below 0.
class FoundViewerTest : public TrafficViewerTest {
 protected:
  FoundViewerTest() : TrafficViewerTest({}, -1) {}
};

TEST_F(FoundViewerTest, PicksDragsAndEditsIt) {
  const auto client = connect();
  EXPECT_EQ(next(*client).header["objects"][0]["id"], -1);
  EXPECT_EQ(object_in_the_middle(*client, 1), -1);
  nlohmann::json request = view(2, "FRONT", 10);
  request["object"] = -1;
  client->send_message(request.dump());
  EXPECT_FALSE(full_image(*client, 2).header["lines"].empty());
  client->send_message(nlohmann::json{
      {"type", "drag"},
      {"id", 1},
      {"object", -1},
      {"turns", false},
      {"from", {0.5, 0.6}},
      {"to", {0.4, 0.6}},
      {"shift_m", {0, 0, 0}},
      {"turn_deg", 0}}.dump());
  EXPECT_GT(wait_for(*client, "dragged").header["shift_m"][1].get<double>(), 0.1);
  const nlohmann::json removed = edited(*client, 1, R"({"actors": {"-1": {"remove": true}}})");
  EXPECT_EQ(removed.value("error", ""), "");
  EXPECT_TRUE(object_in_the_middle(*client, 3).is_null());
  const nlohmann::json copied = edited(
      *client, 2, R"({"actors": {"-1": {"remove": true}}, "copies": [{"of": -1, "id": 9}]})");
  EXPECT_EQ(copied.value("error", ""), "");
  EXPECT_EQ(object_in_the_middle(*client, 4), 9);
}

/// Pages that begin with an edit.
class FirstEditViewerTest : public TrafficViewerTest {
 protected:
  FirstEditViewerTest()
      : TrafficViewerTest(
            {R"({"actors": {"7": {"remove": true}}})", "mine.json", "mine.json", {}}) {}
};

TEST_F(FirstEditViewerTest, BeginsWithIt) {
  const auto client = connect();
  const nlohmann::json hello = next(*client).header;
  EXPECT_EQ(hello["edit"]["file"], "mine.json");
  EXPECT_THAT(hello["edit"]["text"].get<std::string>(), HasSubstr("remove"));
  EXPECT_TRUE(object_in_the_middle(*client, 1).is_null());
  edited(*client, 1, "{}");
  EXPECT_EQ(object_in_the_middle(*client, 2), 7);
}

TEST_F(TrafficViewerTest, RefusesToBeginWithWhatTheModelCannotDraw) {
  const FirstEdit edit{R"({"added": [{"id": 9, "body": {"file": "van.ply"}, "track": [
                           {"time_s": 0, "position_m": [0, 0, 0]},
                           {"time_s": 1, "position_m": [1, 0, 0]}]}]})",
                       "mine.json",
                       "mine.json",
                       {}};
  EXPECT_THROW(
      Viewer(std::shared_ptr<const redrive::Run>(&run_, [](auto*) {}), backend_, nullptr, edit),
      InputError);
}

}  // namespace
}  // namespace redrive::view
