// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/traffic_edit.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;

TEST(TrafficEdit, ReadsChangesAndCopies) {
  const TrafficEdit edit = parse_traffic_edit(R"({
    "actors": {"7": {"shift_m": [2, -0.5, 0], "turn_deg": 20, "speed": 0.5},
               "-3": {"remove": true},
               "9": {"hide_s": [0.5, 2], "gain": [1, 0.5, 0], "body": 7,
                     "track": [{"time_s": 0, "position_m": [1, 2, 3], "yaw_deg": 90},
                               {"time_s": 1, "position_m": [4, 5, 6]}]}},
    "copies": [{"of": 7, "id": 100, "shift_m": [0, 3, 0]}]})",
                                              "edit.json");
  EXPECT_EQ(edit.actors.size(), 3u);
  EXPECT_EQ(edit.actors.at(7).shift_m[1], -0.5);
  EXPECT_EQ(edit.actors.at(7).turn_deg, 20);
  EXPECT_EQ(edit.actors.at(7).speed, 0.5);
  EXPECT_FALSE(edit.actors.at(7).remove);
  EXPECT_TRUE(edit.actors.at(-3).remove);
  const ActorChange& changed = edit.actors.at(9);
  EXPECT_EQ((*changed.hide_s)[1], 2);
  EXPECT_EQ(changed.gain[1], 0.5);
  EXPECT_EQ(changed.body, 7);
  ASSERT_EQ(changed.track.size(), 2u);
  EXPECT_EQ(changed.track[0].yaw_deg, 90);
  EXPECT_EQ(changed.track[1].position_m[2], 6);
  ASSERT_EQ(edit.copies.size(), 1u);
  EXPECT_EQ(edit.copies[0].of, 7);
  EXPECT_EQ(edit.copies[0].id, 100);
  EXPECT_EQ(edit.copies[0].change.shift_m[1], 3);
  EXPECT_TRUE(parse_traffic_edit("{}", "edit.json").actors.empty());
}

TEST(TrafficEdit, ReadsBodiesOfFilesAndWhatIsAdded) {
  const TrafficEdit edit = parse_traffic_edit(R"({
    "actors": {"7": {"body": {"file": "cars/van.ply"}, "shift_road_m": [0, 3, 0]}},
    "added": [{"id": 50, "body": {"file": "van.ply"},
               "track": [{"time_s": 0, "position_m": [1, 2, 3], "pitch_deg": 2, "roll_deg": -1},
                         {"time_s": 1, "position_m": [4, 5, 6]}]}]})",
                                              "edit.json");
  EXPECT_EQ(edit.actors.at(7).body_file, "cars/van.ply");
  EXPECT_FALSE(edit.actors.at(7).body);
  EXPECT_EQ(edit.actors.at(7).shift_road_m[1], 3);
  ASSERT_EQ(edit.added.size(), 1u);
  EXPECT_EQ(edit.added[0].id, 50);
  EXPECT_EQ(edit.added[0].change.body_file, "van.ply");
  EXPECT_EQ(edit.added[0].change.track[0].pitch_deg, 2);
  EXPECT_EQ(edit.added[0].change.track[0].roll_deg, -1);
}

TEST(TrafficEdit, NamesFileFieldAndValueOfWhatIsWrong) {
  const auto track = [](double from, double to) {
    return json{{"track",
                 {{{"time_s", from}, {"position_m", {0, 0, 0}}},
                  {{"time_s", to}, {"position_m", {0, 0, 0}}}}}};
  };
  for (const auto& [change, field] : std::vector<std::pair<json, std::string>>{
           {{{"remove", 1}}, "actors.7.remove"},
           {{{"shift_m", {1, 2}}}, "actors.7.shift_m"},
           {{{"shift_m", {1, 2, 1e5}}}, "actors.7.shift_m[2]"},
           {{{"turn_deg", 400}}, "actors.7.turn_deg"},
           {{{"speed", -1}}, "actors.7.speed"},
           {{{"speed", "fast"}}, "actors.7.speed"},
           {{{"hide_s", {2, 1}}}, "actors.7.hide_s"},
           {{{"gain", 2}}, "actors.7.gain"},
           {{{"body", 1.5}}, "actors.7.body"},
           {{{"body", {{"file", 7}}}}, "actors.7.body.file"},
           {{{"body", {{"file", ""}}}}, "actors.7.body.file"},
           {{{"body", {{"file", std::string("a\0b", 3)}}}}, "actors.7.body.file"},
           {{{"body", {{"run", "a"}}}}, "actors.7.body.run"},
           {{{"body", json::object()}}, "actors.7.body.file"},
           {{{"shift_road_m", {1, 2}}}, "actors.7.shift_road_m"},
           {{{"shift", {1, 2, 3}}}, "actors.7.shift"},
           {{{"of", 3}}, "actors.7.of"},
           {track(1, 1), "actors.7.track[1].time_s"},
           {track(-1, 1), "actors.7.track[0].time_s"},
           {{{"track", json::array()}}, "actors.7.track"},
           {json(3), "actors.7"}}) {
    const std::string message = testing::input_error([&, &change = change] {
      parse_traffic_edit(json{{"actors", {{"7", change}}}}.dump(), "edit.json");
    });
    EXPECT_THAT(message, HasSubstr("edit.json")) << change;
    EXPECT_THAT(message, HasSubstr(field)) << change;
  }
  for (const char* text :
       {"[]", "{", R"({"actors": {"x": {}}})", R"({"actors": {"07": {}}})", R"({"cars": {}})",
        R"({"copies": [{"of": 1}]})", R"({"copies": {}})", R"({"added": [{"id": 1}]})",
        R"({"added": {}})", R"({"added": [{"id": 1, "body": {"file": "a.ply"}}]})"})
    EXPECT_THAT(testing::input_error([&] { parse_traffic_edit(text, "edit.json"); }),
                HasSubstr("edit.json"))
        << text;
}

}  // namespace
}  // namespace redrive
