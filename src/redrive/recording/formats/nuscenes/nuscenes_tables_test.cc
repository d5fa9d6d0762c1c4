// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes_tables.h"

#include <functional>

#include "redrive/recording/formats/nuscenes/nuscenes_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using testing::NuScenesTables;

nuscenes::SceneTables read_tables(const NuScenesTables& tables, const std::string& scene) {
  return nuscenes::read_scene("data/v1.0-mini", scene, [&](RecordScanner* scanner) {
    scanner->add(tables.at(scanner->file().stem().string()).dump());
    scanner->finish();
  });
}

TEST(NuScenesTables, AreThoseOfOneScene) {
  const nuscenes::SceneTables scene = read_tables({}, "scene-0103");
  EXPECT_EQ(scene.name, "scene-0103");
  EXPECT_EQ(read_tables({}, "t-scene-0103").name, "scene-0103");
  ASSERT_EQ(scene.sample_times_ns.size(), 3u);
  EXPECT_EQ(scene.sample_times_ns[1], 1000 * (NuScenesTables::kFirst_us + 100'535'000));
  ASSERT_EQ(scene.sensors.size(), 4u);
  ASSERT_EQ(scene.files.size(), 39u);  // 13 of each sensor but the radar
  EXPECT_EQ(scene.files[0].path, "data/samples/CAM_FRONT/CAM_FRONT1532403027000000.jpg");
  EXPECT_TRUE(scene.files[0].key_frame);
  EXPECT_EQ(scene.files[3].sample, 1u) << "a sweep belongs to the sample after it";
  EXPECT_FALSE(scene.files[3].key_frame);
  ASSERT_EQ(scene.poses.size(), 39u);
  EXPECT_EQ(scene.poses[2].t_ns, scene.files[2].t_ns);
  EXPECT_TRUE(scene.poses[2].global_from_body.translation().isApprox(
      Eigen::Vector3d(2000.35, 600, 0), 1e-12));
  ASSERT_EQ(scene.annotations.size(), 6u);
  EXPECT_EQ(scene.annotations[0].size_m, Eigen::Vector3d(4.5, 2, 1.5)) << "length, width, height";
  EXPECT_EQ(scene.categories[scene.annotations[1].object], "human.pedestrian.adult");
  const CameraCalibration& front = scene.sensors[0].calibration;
  EXPECT_EQ(front.name, "CAM_FRONT");
  EXPECT_EQ(front.width, 1600);
  EXPECT_EQ(front.parameters, (std::vector<double>{1260, 1260, 800, 450, 0, 0, 0, 0, 0}));
  EXPECT_TRUE((front.body_from_sensor.linear() * Eigen::Vector3d::UnitZ())
                  .isApprox(Eigen::Vector3d::UnitX(), 1e-12));
  EXPECT_TRUE((front.body_from_sensor.linear() * Eigen::Vector3d::UnitY())
                  .isApprox(-Eigen::Vector3d::UnitZ(), 1e-12));
}

// Records before the faulty one are used once and in order, and none after it.
TEST(TokenTables, AFaultyRecordIsNamedOnce) {
  constexpr std::size_t kRecords = 6000, kFaulty = 4321;
  std::string text = "[";
  Tokens wanted;
  for (std::size_t i = 0; i < kRecords; ++i) {
    const std::string token = "t" + std::to_string(i);
    wanted.emplace(token, i);
    text += (i > 0 ? ",{\"token\":\"" : "{\"token\":\"") + token + "\",\"pad\":\"" +
            std::string(100, 'x') + "\"}";
  }
  const TokenTables tables("data", [&](RecordScanner* scanner) {
    scanner->add(text + "]");
    scanner->finish();
  });
  std::size_t used = 0;
  const std::string message = input_error([&] {
    tables.each_of("table", "token", wanted,
                   [&](const JsonField& record, std::size_t index, std::size_t number) {
                     EXPECT_EQ(index, used);
                     EXPECT_EQ(number, used++);
                     if (index == kFaulty) record.at("pad").fail("is wrong");
                   });
  });
  EXPECT_THAT(message, AllOf(HasSubstr("record 4321.pad"), HasSubstr("is wrong")));
  EXPECT_EQ(used, kFaulty + 1);
}

TEST(NuScenesTables, NameTheScenesThatThereAre) {
  EXPECT_THAT(input_error([] { read_tables({}, "scene-9"); }),
              AllOf(HasSubstr("scene.json: name = scene-9: no such scene"),
                    HasSubstr("there are scene-0061, scene-0103")));
  EXPECT_THAT(input_error([] { read_tables({}, ""); }),
              AllOf(HasSubstr("has several scenes"), HasSubstr("data/v1.0-mini/scene-0061")));
  NuScenesTables tables;
  tables["scene"].erase(0);
  EXPECT_EQ(read_tables(tables, "").name, "scene-0103");
  tables["scene"].push_back(tables["scene"][0]);
  EXPECT_THAT(input_error([&] { read_tables(tables, "scene-0103"); }),
              HasSubstr("record 1.name = \"scene-0103\": a second scene"));
  tables["scene"].clear();
  EXPECT_THAT(input_error([&] { read_tables(tables, ""); }), HasSubstr("has no scene"));
}

TEST(NuScenesTables, RejectInvalidValues) {
  const auto message = [](const std::function<void(NuScenesTables&)>& change) {
    NuScenesTables tables;
    change(tables);
    return input_error([&] { read_tables(tables, "scene-0061"); });
  };
  const auto changed = [&](const std::string& table, const std::string& key,
                           const nlohmann::json& value) {
    return message([&](NuScenesTables& tables) { tables[table][0][key] = value; });
  };
  EXPECT_THAT(changed("sample_data", "ego_pose_token", "x"),
              HasSubstr("sample_data.json: record 0.ego_pose_token = x: ego_pose.json has no"));
  EXPECT_THAT(changed("sample_data", "calibrated_sensor_token", "x"),
              HasSubstr("record 0.calibrated_sensor_token = \"x\": calibrated_sensor.json has no"));
  EXPECT_THAT(changed("calibrated_sensor", "sensor_token", "x"),
              HasSubstr("record 0.sensor_token = \"x\": sensor.json has no record"));
  EXPECT_THAT(changed("sample_annotation", "instance_token", "x"),
              HasSubstr("record 0.instance_token = x: instance.json has no record"));
  EXPECT_THAT(changed("instance", "category_token", "x"),
              HasSubstr("record 0.category_token = x: category.json has no record"));
  EXPECT_THAT(message([](NuScenesTables& t) { t["sample"].clear(); }),
              HasSubstr("sample.json: has none of scene-0061"));
  EXPECT_THAT(message([](NuScenesTables& t) { t["sample_data"].clear(); }),
              HasSubstr("sample_data.json: has no file of a camera"));
  EXPECT_THAT(changed("sample", "timestamp", NuScenesTables::kFirst_us + 534'000),
              HasSubstr("less than 0.1 s after"));
  EXPECT_THAT(message([](NuScenesTables& t) { t["sample"].push_back(t["sample"][0]); }),
              HasSubstr("a second record of this token"));
  EXPECT_THAT(message([](NuScenesTables& t) { t["ego_pose"].push_back(t["ego_pose"][0]); }),
              HasSubstr("a second record of this token"));
  EXPECT_THAT(message([](NuScenesTables& t) {
                nlohmann::json& record = t["ego_pose"][0];  // keys are written by name
                record["a"] = {{"token", record["token"]}};
                record["token"] = "other";
              }),
              HasSubstr("record 0.token = \"other\": a second one, inside of the record, is"));
  EXPECT_THAT(message([](NuScenesTables& t) {
                t["sample_annotation"].push_back(t["sample_annotation"][0]);
              }),
              HasSubstr("a second box of this object"));
  EXPECT_THAT(changed("calibrated_sensor", "translation", {0, 0, 51}), HasSubstr("50 m"));
  EXPECT_THAT(
      changed("calibrated_sensor", "camera_intrinsic", {{1260, 1, 800}, {0, 1260, 450}, {0, 0, 1}}),
      HasSubstr("without skew"));
  EXPECT_THAT(
      changed("calibrated_sensor", "camera_intrinsic", {{0, 0, 800}, {0, 1260, 450}, {0, 0, 1}}),
      HasSubstr("record 0.camera_intrinsic[0][0]"));
  EXPECT_THAT(changed("calibrated_sensor", "camera_intrinsic", nlohmann::json::array()),
              HasSubstr("record 0.camera_intrinsic"));
  EXPECT_THAT(changed("sensor", "channel", "../x"), HasSubstr("a channel is made of"));
  EXPECT_THAT(changed("sample_annotation", "size", {2, 0, 1}), HasSubstr("0.01 and 100 m"));
  EXPECT_THAT(changed("sample_data", "is_key_frame", 1), HasSubstr("true or false"));
  EXPECT_THAT(changed("sample_data", "sample_token", 1), HasSubstr("a string"));
  EXPECT_THAT(changed("sample_data", "width", 0), HasSubstr("record 0.width"));
  EXPECT_THAT(message([](NuScenesTables& t) { t["sample_data"][4]["height"] = 800; }),
              HasSubstr("record 4.height = 800: other images of CAM_FRONT have 900"));
  for (const char* path : {"../a.jpg", "/etc/passwd", "samples/../../a.jpg", "", ".", "samples/"})
    EXPECT_THAT(changed("sample_data", "filename", path), HasSubstr("record 0.filename")) << path;
  EXPECT_THAT(message([](NuScenesTables& t) {
                nlohmann::json other = t["calibrated_sensor"][0];
                other["token"] = "other", other["translation"] = {1, 0, 1.5};
                t["calibrated_sensor"].push_back(other);
                t["sample_data"][4]["calibrated_sensor_token"] = "other";
              }),
              HasSubstr("another calibration of CAM_FRONT"));
}

TEST(NuScenesTables, APoseOrATimeThatCannotBeCostsItself) {
  const auto damage = [](const char* table, const char* key, const nlohmann::json& value) {
    NuScenesTables tables;
    tables[table][0][key] = value;
    const nuscenes::SceneTables scene = read_tables(tables, "scene-0061");
    EXPECT_EQ(scene.damaged.size(), 1u) << key;
    EXPECT_EQ(scene.files.size() + scene.poses.size(), 77u) << key;
    return scene.damaged.empty() ? std::string() : scene.damaged[0].why;
  };
  EXPECT_THAT(damage("ego_pose", "rotation", {0, 0, 0, 0}),
              HasSubstr("ego_pose.json: record 0.rotation = [0,0,0,0]: must be a rotation"));
  EXPECT_THAT(damage("ego_pose", "rotation", {1, 0, 0}), HasSubstr("4 numbers"));
  EXPECT_THAT(damage("ego_pose", "translation", {1, 2, nullptr}), HasSubstr("a number"));
  EXPECT_THAT(damage("ego_pose", "translation", {1e8, 0, 0}), HasSubstr("further than 1e+07 m"));
  EXPECT_THAT(damage("ego_pose", "timestamp", 1.5), HasSubstr("an integer"));
  EXPECT_THAT(damage("ego_pose", "timestamp", -1), HasSubstr("microseconds"));
  NuScenesTables tables;
  tables["ego_pose"][0]["rotation"] = {1.01, 0, 0, 0};
  EXPECT_TRUE(read_tables(tables, "scene-0061").damaged.empty()) << "it is normalised";
}

TEST(NuScenesTables, PosesOfOneTimeAreAtOnePlace) {
  NuScenesTables tables;
  nlohmann::json other = tables["ego_pose"][0];
  other["token"] = "other", other["translation"] = {1001, 600, 0};
  tables["ego_pose"].push_back(other);
  tables["sample_data"][1]["ego_pose_token"] = "other";
  EXPECT_THAT(input_error([&] { read_tables(tables, "scene-0061"); }),
              HasSubstr("of the same time"));
}

TEST(NuScenesTables, ANaNCostsItsPose) {
  const NuScenesTables tables;
  const auto read = [&](RecordScanner* scanner) {
    std::string text = tables.at(scanner->file().stem().string()).dump();
    if (const std::size_t at = text.find("1000.0"); at != text.npos) text.replace(at, 6, "NaN");
    scanner->add(text);
    scanner->finish();
  };
  EXPECT_THAT(nuscenes::read_scene("v1.0-mini", "scene-0061", read).damaged.at(0).why,
              AllOf(HasSubstr("ego_pose.json: record 0.translation"), HasSubstr("NaN")));
}

// Records of other scenes are not parsed, however wrong they are.
TEST(NuScenesTables, SkipOtherScenes) {
  NuScenesTables tables;
  for (nlohmann::json& file : tables["sample_data"])
    if (std::string(file["sample_token"]).starts_with("scene-0103")) file["timestamp"] = "never";
  EXPECT_EQ(read_tables(tables, "scene-0061").files.size(), 39u);
  EXPECT_THAT(input_error([&] { read_tables(tables, "scene-0103"); }), HasSubstr("timestamp"));
}

}  // namespace
}  // namespace redrive
