// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/messages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "redrive/base/error.h"

namespace redrive::view {
namespace {

nlohmann::json view_message() {
  return {{"type", "view"},          {"id", 7},
          {"camera", "F"},           {"frame", 1028},
          {"shift_m", {0.5, -1, 2}}, {"yaw_deg", -15},
          {"pitch_deg", 3.5},        {"layer", "depth"},
          {"exposure", "none"},      {"overlays", {"lidar", "boxes"}},
          {"reference", true},       {"novel", nullptr}};
}

TEST(Messages, ReadsAView) {
  const auto view = std::get<ViewRequest>(parse_client_message(view_message().dump()));
  EXPECT_EQ(view.id, 7u);
  EXPECT_EQ(view.camera, "F");
  EXPECT_EQ(view.frame, 1028);
  EXPECT_EQ(view.shift_m, (std::array<double, 3>{0.5, -1, 2}));
  EXPECT_EQ(view.yaw_deg, -15);
  EXPECT_EQ(view.pitch_deg, 3.5);
  EXPECT_EQ(view.layer, Layer::kDepth);
  EXPECT_EQ(view.exposure, "none");
  EXPECT_TRUE(view.overlays.lidar && view.overlays.boxes && view.reference);
  EXPECT_FALSE(view.overlays.trajectory || view.overlays.frusta || view.novel.has_value());
  EXPECT_FALSE(view.is_driven());
}

TEST(Messages, ReadsANovelView) {
  nlohmann::json json = view_message();
  json["novel"] = {{"set", "left_1"}, {"index", 3}};
  const auto view = std::get<ViewRequest>(parse_client_message(json.dump()));
  EXPECT_EQ(view.novel, (NovelView{"left_1", 3}));
}

TEST(Messages, ReadsAMount) {
  nlohmann::json json = view_message();
  json["mount"] = {{"at", "1.5,0,1.6,0,-5,0"}, {"lens", "pinhole:90:1280x704"}};
  const auto view = std::get<ViewRequest>(parse_client_message(json.dump()));
  ASSERT_TRUE(view.mount);
  EXPECT_EQ(view.mount->mount.position_m.z(), 1.6);
  EXPECT_EQ(view.mount->lens.width, 1280);
  EXPECT_FALSE(view.is_driven());
}

TEST(Messages, ReadsLayersAndOverlays) {
  nlohmann::json json = view_message();
  json["layer"] = "normals";
  json["overlays"] = {"cloud", "masks"};
  const auto view = std::get<ViewRequest>(parse_client_message(json.dump()));
  EXPECT_EQ(view.layer, Layer::kNormals);
  EXPECT_TRUE(view.overlays.cloud && view.overlays.masks);
  EXPECT_FALSE(view.overlays.lidar || view.overlays.boxes);
}

TEST(Messages, ReadsARenderedScan) {
  nlohmann::json json = view_message();
  const auto scan = [&](const char* sensor, const char* colour) {
    json["scan"] = {{"sensor", sensor}, {"colour", colour}};
    return *std::get<ViewRequest>(parse_client_message(json.dump())).scan;
  };
  using Colour = ScanRequest::Colour;
  EXPECT_EQ(scan("recorded", "error"), (ScanRequest{"recorded", Colour::kError}));
  EXPECT_EQ(scan("vlp-16", "intensity"), (ScanRequest{"vlp-16", Colour::kIntensity}));
  EXPECT_EQ(scan("64:-24.8:2", "range"), (ScanRequest{"64:-24.8:2", Colour::kRange}));
  EXPECT_THROW(scan("vlp-17", "range"), InputError);
  EXPECT_THROW(scan("256:-10:10", "range"), InputError);
  EXPECT_THROW(scan("recorded", "red"), InputError);
  EXPECT_THROW(scan("estimated", "error"), InputError);
}

TEST(Messages, ReadsShownAndPick) {
  EXPECT_EQ(std::get<Shown>(parse_client_message(R"({"type": "shown", "sequence": 9})")).sequence,
            9u);
  EXPECT_TRUE(
      std::get<TrainCommand>(parse_client_message(R"({"type": "train", "paused": true})")).paused);
  const auto pick =
      std::get<Pick>(parse_client_message(R"({"type": "pick", "id": 2, "at": [0.25, 1]})"));
  EXPECT_EQ(pick.id, 2u);
  EXPECT_EQ(pick.u, 0.25);
  EXPECT_EQ(pick.v, 1);
}

nlohmann::json path_message() {
  return {{"type", "path"},
          {"fps", 24},
          {"keyframes", {{{"time_s", 0}, {"camera", "F"}, {"frame_id", 7}, {"yaw_deg", 5}}}},
          {"save", {{"name", "left_turn-2"}, {"overwrite", false}}}};
}

TEST(Messages, ReadsPaths) {
  nlohmann::json json = path_message();
  const auto saved = std::get<PathMessage>(parse_client_message(json.dump()));
  EXPECT_EQ(saved.fps, 24);
  ASSERT_EQ(saved.keyframes.size(), 1u);
  EXPECT_EQ(saved.keyframes[0].yaw_deg, 5);
  ASSERT_TRUE(saved.save);
  EXPECT_EQ(saved.save->name, "left_turn-2");
  EXPECT_FALSE(saved.save->overwrite);
  json["save"] = nullptr;
  EXPECT_FALSE(std::get<PathMessage>(parse_client_message(json.dump())).save);
  const auto load =
      std::get<LoadPath>(parse_client_message(R"({"type": "load_path", "name": "a"})"));
  EXPECT_EQ(load.name, "a");
  json = view_message();
  json["path_s"] = 1.5;
  EXPECT_EQ(std::get<ViewRequest>(parse_client_message(json.dump())).path_s, 1.5);
}

TEST(Messages, RefusesOtherPaths) {
  for (const std::string name : {"", ".", "..", "../a", "a/b", "a\\b", "a.json", "a b", "\xc3\xa4"})
    EXPECT_FALSE(valid_path_name(name)) << name;
  EXPECT_FALSE(valid_path_name(std::string(65, 'a')));
  EXPECT_TRUE(valid_path_name(std::string(64, 'a')));
  const auto refuses = [](const char* at, const nlohmann::json& value) {
    nlohmann::json json = path_message();
    json[nlohmann::json::json_pointer(at)] = value;
    EXPECT_THROW(parse_client_message(json.dump()), InputError) << json;
  };
  refuses("/fps", 0);
  refuses("/keyframes", nlohmann::json::array());
  refuses("/keyframes",
          nlohmann::json(std::vector<nlohmann::json>(257, path_message()["keyframes"][0])));
  refuses("/keyframes/0/yaw_deg", "left");
  refuses("/save/name", "../../config");
  refuses("/save/overwrite", 1);
  refuses("/save", true);
}

TEST(Messages, ReadsEditsAndDrags) {
  const auto edit = std::get<EditMessage>(parse_client_message(
      R"({"type": "edit", "id": 4, "file": "EDIT.json", "text": "{\"actors\": 1"})"));
  EXPECT_EQ(edit.id, 4u);
  EXPECT_EQ(edit.file, "EDIT.json");
  EXPECT_EQ(edit.text, R"({"actors": 1)") << "is parsed where its errors can be answered";
  nlohmann::json json = {{"type", "drag"},       {"id", 5},          {"object", 7},
                         {"turns", true},        {"from", {0.5, 0}}, {"to", {0, 1}},
                         {"shift_m", {1, 2, 3}}, {"turn_deg", -20.5}};
  const auto drag = std::get<DragMessage>(parse_client_message(json.dump()));
  EXPECT_EQ(drag.object, 7);
  EXPECT_TRUE(drag.turns);
  EXPECT_EQ(drag.from, (std::array<double, 2>{0.5, 0}));
  EXPECT_EQ(drag.to, (std::array<double, 2>{0, 1}));
  EXPECT_EQ(drag.shift_m, (std::array<double, 3>{1, 2, 3}));
  EXPECT_EQ(drag.turn_deg, -20.5);
  for (const auto& [key, value] :
       std::vector<std::pair<std::string, nlohmann::json>>{{"object", "7"},
                                                           {"turns", 1},
                                                           {"from", {0.5, 1.5}},
                                                           {"to", {0.5}},
                                                           {"shift_m", {0, 0, 1e5}},
                                                           {"turn_deg", 400},
                                                           {"id", -1}}) {
    nlohmann::json wrong = json;
    wrong[key] = value;
    EXPECT_THROW(parse_client_message(wrong.dump()), InputError) << wrong;
    wrong.erase(key);
    EXPECT_THROW(parse_client_message(wrong.dump()), InputError) << "without " << key;
  }
  EXPECT_THROW(parse_client_message(R"({"type": "edit", "id": 4, "file": "a", "text": {}})"),
               InputError);
  EXPECT_THROW(parse_client_message(nlohmann::json{
                   {"type", "edit"}, {"id", 4}, {"file", std::string(257, 'a')}, {"text", "{}"}}
                                        .dump()),
               InputError);
  json = view_message();
  json["object"] = 7;
  EXPECT_EQ(std::get<ViewRequest>(parse_client_message(json.dump())).object, 7);
  json["object"] = nullptr;
  EXPECT_FALSE(std::get<ViewRequest>(parse_client_message(json.dump())).object);
}

TEST(Messages, RefusesEverythingElse) {
  for (const char* text :
       {"", "{", "[]", "null", "7", R"({"type": 1})", R"({"type": "run"})", R"({"type": "shown"})",
        R"({"type": "shown", "sequence": -1})", R"({"type": "pick", "id": 1, "at": [0.5]})",
        R"({"type": "pick", "id": 1, "at": [0.5, 1.5]})",
        R"({"type": "pick", "id": 1, "at": [1e999, 0]})", R"({"type": "train"})",
        R"({"type": "train", "paused": 1})"})
    EXPECT_THROW(parse_client_message(text), InputError) << text;
  const auto refuses = [](const char* key, const nlohmann::json& value) {
    nlohmann::json json = view_message();
    json[key] = value;
    EXPECT_THROW(parse_client_message(json.dump()), InputError) << json;
    json.erase(key);
    if (key != std::string_view("novel") && key != std::string_view("mount") &&
        key != std::string_view("object")) {
      EXPECT_THROW(parse_client_message(json.dump()), InputError) << "without " << key;
    }
  };
  refuses("id", -1);
  refuses("camera", 5);
  refuses("camera", std::string(300, 'x'));
  refuses("frame", "1");
  refuses("shift_m", {0, 0});
  refuses("shift_m", {0, 0, 1e6});
  refuses("yaw_deg", 1000);
  refuses("pitch_deg", "up");
  refuses("layer", "colours");
  refuses("exposure", 1);
  refuses("overlays", {"all"});
  refuses("overlays", nlohmann::json(std::vector<std::string>(20, "lidar")));
  refuses("mount", {{"at", "0,0,0"}, {"lens", "F"}});
  refuses("mount", {{"at", "0,0,0,0,0,0"}, {"lens", "pinhole:180:64x64"}});
  refuses("reference", 1);
  refuses("novel", {{"set", "left_1"}});
  refuses("object", "7");
  EXPECT_THROW(parse_client_message(R"({"type": "load_path", "name": "a/b"})"), InputError);
  EXPECT_THROW(parse_client_message(std::string(kMaxMessageBytes + 1, ' ')), InputError);
}

}  // namespace
}  // namespace redrive::view
