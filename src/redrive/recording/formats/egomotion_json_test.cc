// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/egomotion_json.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using testing::egomotion;
using ::testing::HasSubstr;
using testing::input_error;
using testing::pose_at;

std::vector<FramePose> parsed_egomotion(const json& document) {
  return parse_egomotion(document.dump(), "dir/egomotion2.json");
}

std::string egomotion_message(const std::string& field, const json& value) {
  json document = egomotion();
  document[json::json_pointer(field)] = value;
  const std::string message = input_error([&] { parsed_egomotion(document); });
  EXPECT_THAT(message, HasSubstr("dir/egomotion2.json")) << field;
  return message;
}

TEST(Egomotion, ReadsPosesInOrderOfIds) {
  const auto frames = parsed_egomotion(egomotion());
  ASSERT_EQ(frames.size(), 3u);
  EXPECT_EQ(frames[0].id, 9);
  EXPECT_EQ(frames[1].id, 10);
  EXPECT_EQ(frames[2].id, 11);
  EXPECT_EQ(frames[1].t_ns, 50100000000);
  EXPECT_EQ(frames[2].global_from_body.translation(), Eigen::Vector3d(4e6 + 4, 1.4e6, 4.6e6));
}

TEST(Egomotion, AcceptsBothSpellings) {
  json document = egomotion();
  document["10"]["ECEF_RT_body"] = document["10"]["RT_ECEF_body"];
  document["10"].erase("RT_ECEF_body");
  for (const char* id : {"9", "10", "11"}) {
    document[id]["time"] = document[id]["time_host"];
    document[id].erase("time_host");
  }
  const auto frames = parsed_egomotion(document);
  EXPECT_EQ(frames[1].t_ns, 50100000000);
  EXPECT_EQ(frames[1].global_from_body.translation().x(), 4e6 + 2);
}

TEST(Egomotion, PrefersHostTime) {
  json document = egomotion();
  document["10"]["time"] = 7;
  EXPECT_EQ(parsed_egomotion(document)[1].t_ns, 50100000000);
}

// `time` and `time_host` may be of different clocks: mixing them is an error.
TEST(Egomotion, RejectsMixedClocks) {
  json document = egomotion();
  document["11"]["time"] = document["11"]["time_host"];
  document["11"].erase("time_host");
  EXPECT_THAT(input_error([&] { parsed_egomotion(document); }),
              AllOf(HasSubstr("egomotion2.json: 11"), HasSubstr("time_host")));
}

TEST(Egomotion, RejectsInvalidIds) {
  for (const char* key : {"frame_12", "0012", "+12", "-12", "12.0", "", "99999999999999999999"}) {
    json document = egomotion();
    document[key] = pose_at(6, 50.3);
    EXPECT_THAT(input_error([&] { parsed_egomotion(document); }),
                AllOf(HasSubstr("\"" + std::string(key) + "\""), HasSubstr("frame id")));
  }
}

TEST(Egomotion, RejectsMissingAndMalformedFields) {
  for (const char* key : {"RT_ECEF_body", "time_host"}) {
    json document = egomotion();
    document["10"].erase(key);
    EXPECT_THAT(input_error([&] { parsed_egomotion(document); }),
                AllOf(HasSubstr("egomotion2.json: 10 "), HasSubstr(key)));
  }
  EXPECT_THAT(input_error([] { parsed_egomotion(json::object()); }), HasSubstr("no pose"));
  EXPECT_THAT(input_error([] { parsed_egomotion(json::array()); }), HasSubstr("egomotion2.json"));
  EXPECT_THAT(input_error([] { parse_egomotion("{\"9\": {", "e.json"); }),
              AllOf(HasSubstr("e.json"), HasSubstr("line 1")));
  EXPECT_THAT(egomotion_message("/10/RT_ECEF_body/0/3", "nan"),
              AllOf(HasSubstr("10.RT_ECEF_body"), HasSubstr("\"nan\"")));
  EXPECT_THAT(egomotion_message("/10/RT_ECEF_body", {1, 2, 3}), HasSubstr("10.RT_ECEF_body"));
  EXPECT_THAT(egomotion_message("/10/RT_ECEF_body/0/0", 1.2),
              AllOf(HasSubstr("10.RT_ECEF_body"), HasSubstr("orthonormal")));
  EXPECT_THAT(egomotion_message("/10/RT_ECEF_body/0/0", -1),
              AllOf(HasSubstr("10.RT_ECEF_body"), HasSubstr("det = -1")));
  EXPECT_THAT(egomotion_message("/10/RT_ECEF_body/0/3", 4e9),
              AllOf(HasSubstr("10.RT_ECEF_body"), HasSubstr("4e+09")));
  EXPECT_THAT(egomotion_message("/10/time_host", "noon"),
              AllOf(HasSubstr("10.time_host"), HasSubstr("noon")));
  EXPECT_THAT(egomotion_message("/10/time_host", 1.6e18),
              AllOf(HasSubstr("10.time_host"), HasSubstr("1.6e+18"), HasSubstr("seconds")));
  EXPECT_THAT(egomotion_message("/10/time_host", -1),
              AllOf(HasSubstr("10.time_host"), HasSubstr("from 0")));
}

TEST(Egomotion, RejectsDecreasingTimes) {
  EXPECT_THAT(egomotion_message("/10/time_host", 50.0),
              AllOf(HasSubstr("10.time"), HasSubstr("50.000"), HasSubstr("frame 9")));
  EXPECT_THAT(egomotion_message("/11/time_host", 49.9),
              AllOf(HasSubstr("11.time"), HasSubstr("49.900"), HasSubstr("frame 10")));
}

TEST(Egomotion, RejectsImplausibleSpeeds) {
  // Gaps may be long; 16 m in 0.1 s are 160 m/s.
  json document = {{"1", pose_at(0, 0)}, {"2", pose_at(400, 20)}};
  EXPECT_EQ(parsed_egomotion(document).size(), 2u);
  document["2"] = pose_at(14, 0.1);
  EXPECT_EQ(parsed_egomotion(document).size(), 2u);
  document["2"] = pose_at(16, 0.1);
  EXPECT_THAT(input_error([&] { parsed_egomotion(document); }),
              AllOf(HasSubstr("2.RT_ECEF_body"), HasSubstr("16.00 m"), HasSubstr("frame 1")));
}

/// Ten frames from 0 on, 2 m and 0.1 s apart.
json ten_frames() {
  json document;
  for (int id = 0; id < 10; ++id) document[std::to_string(id)] = pose_at(2 * id, 50 + 0.1 * id);
  return document;
}

std::vector<DamagedRecord> damaged_of(const json& document, std::vector<FramePose>* frames) {
  std::vector<DamagedRecord> damaged;
  const DamagedList list{"poses", &damaged};
  std::string text = document.dump();
  if (const std::size_t at = text.find("\"NaN\""); at != text.npos) text.replace(at, 5, "NaN");
  *frames = parse_egomotion(text, "e.json", &list);
  return damaged;
}

TEST(Egomotion, APoseOrATimeThatCannotBeCostsItself) {
  const auto with = [](const char* pointer, const json& value) {
    json document = ten_frames();
    document[json::json_pointer(pointer)] = value;
    return document;
  };
  for (const json& document :
       {with("/4/RT_ECEF_body/0/3", "NaN"), with("/4/RT_ECEF_body/0/0", 1.2),
        with("/4/RT_ECEF_body/0/3", 0), with("/4/time_host", -1), with("/4/time_host", 51),
        with("/4/time_host", 50.25), with("/4/RT_ECEF_body/0/3", 4e6 + 500)}) {
    std::vector<FramePose> frames;
    const std::vector<DamagedRecord> damaged = damaged_of(document, &frames);
    ASSERT_EQ(damaged.size(), 1u) << document;
    EXPECT_EQ(damaged[0].frame_id, 4) << document;
    EXPECT_FALSE(damaged[0].breaks);
    EXPECT_THAT(damaged[0].why, AllOf(HasSubstr("e.json: "), HasSubstr("4"))) << document;
    EXPECT_EQ(frames.size(), 9u);
  }
}

TEST(Egomotion, APlaceFromWhichOnAllIsElsewhereIsNamed) {
  json document;
  for (int id = 0; id < 40; ++id)
    document[std::to_string(id)] = pose_at(2 * id + (id < 20 ? 0 : 1e5), 50 + 0.1 * id);
  std::vector<FramePose> frames;
  const std::vector<DamagedRecord> damaged = damaged_of(document, &frames);
  ASSERT_EQ(damaged.size(), 1u);
  EXPECT_TRUE(damaged[0].breaks);
  EXPECT_EQ(damaged[0].frame_id, 20);
  EXPECT_EQ(frames.size(), 40u);
}

}  // namespace
}  // namespace redrive
