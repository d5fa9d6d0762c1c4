// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"

#include <numbers>

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

json object(int id) {
  return {{"ActorName", "CAR 04"},
          {"ObjectId", id},
          {"ObjectType", "CAR"},
          {"BoundingBox3D Extent X", 4},
          {"BoundingBox3D Extent Y", 2},
          {"BoundingBox3D Extent Z", 1.5},
          {"BoundingBox3D Orientation Quat W", 1},
          {"BoundingBox3D Orientation Quat X", 0},
          {"BoundingBox3D Orientation Quat Y", 0},
          {"BoundingBox3D Orientation Quat Z", 0},
          {"BoundingBox3D Origin X", 10},
          {"BoundingBox3D Origin Y", -20},
          {"BoundingBox3D Origin Z", 0.75},
          {"Occluded", 0},
          {"Relative Velocity X", -1.5},
          {"Relative Velocity Y", 0.25},
          {"Relative Velocity Z", 0.125},
          {"Truncated", 0}};
}

json frame() {
  return {{"CapturedObjects", {object(4), object(7)}}, {"Timestamp", "4833189570000"}};
}

std::vector<Box> parsed_boxes(const json& document) {
  return aimotive::parse_boxes(document.dump(), "dir/frame_0000001.json");
}

std::string boxes_message(const std::string& pointer, const json& value) {
  json document = frame();
  document[json::json_pointer(pointer)] = value;
  const std::string message = input_error([&] { parsed_boxes(document); });
  EXPECT_THAT(message, HasSubstr("dir/frame_0000001.json: ")) << pointer;
  return message;
}

TEST(Boxes, ReadsKnownValues) {
  json document = frame();
  // A quarter turn to the left: forward, the box's x axis, points along the body's y axis.
  const double half = std::numbers::pi / 4;
  document["CapturedObjects"][1]["BoundingBox3D Orientation Quat W"] = std::cos(half);
  document["CapturedObjects"][1]["BoundingBox3D Orientation Quat Z"] = std::sin(half);
  const std::vector<Box> boxes = parsed_boxes(document);
  ASSERT_EQ(boxes.size(), 2u);
  EXPECT_EQ(boxes[0].object_id, 4);
  EXPECT_EQ(boxes[0].type, "CAR");
  EXPECT_EQ(boxes[0].actor_name, "CAR 04");
  EXPECT_EQ(boxes[0].t_ns, 4833189570000);
  EXPECT_EQ(boxes[0].size_m, Eigen::Vector3d(4, 2, 1.5));
  EXPECT_EQ(boxes[0].velocity_in_body_m_per_s, Eigen::Vector3d(-1.5, 0.25, 0.125));
  EXPECT_TRUE((boxes[0].body_from_box * Eigen::Vector3d(2, 1, 0.5))
                  .isApprox(Eigen::Vector3d(12, -19, 1.25), 1e-15));
  EXPECT_EQ(boxes[1].object_id, 7);
  EXPECT_TRUE((boxes[1].body_from_box * Eigen::Vector3d(2, 1, 0.5))
                  .isApprox(Eigen::Vector3d(9, -18, 1.25), 1e-15));
  document["CapturedObjects"] = json::array();
  EXPECT_TRUE(parsed_boxes(document).empty());
}

TEST(Boxes, ReadsRotations) {
  json document = frame();
  json& quaternion_w = document["CapturedObjects"][0]["BoundingBox3D Orientation Quat W"];
  quaternion_w = 1.01;  // written with few digits: normalised
  EXPECT_NEAR(
      (parsed_boxes(document)[0].body_from_box.linear() - Eigen::Matrix3d::Identity()).norm(), 0,
      1e-15);
  quaternion_w = 0;
  EXPECT_THAT(input_error([&] { parsed_boxes(document); }),
              AllOf(HasSubstr("CapturedObjects[0].BoundingBox3D Orientation Quat = norm 0"),
                    HasSubstr("rotation")));
  EXPECT_THAT(boxes_message("/CapturedObjects/1/BoundingBox3D Orientation Quat X", 1e300),
              HasSubstr("Quat X = 1e+300"));
  EXPECT_THAT(boxes_message("/CapturedObjects/1/BoundingBox3D Orientation Quat W", 1e300),
              HasSubstr("norm inf"));
}

TEST(Boxes, RejectsInvalidValues) {
  const std::string first = "/CapturedObjects/0/";
  EXPECT_THAT(boxes_message(first + "BoundingBox3D Extent Y", 0),
              AllOf(HasSubstr("CapturedObjects[0].BoundingBox3D Extent Y = 0"), HasSubstr("0.01")));
  EXPECT_THAT(boxes_message(first + "BoundingBox3D Extent Y", -2), HasSubstr("Extent Y = -2"));
  EXPECT_THAT(boxes_message(first + "BoundingBox3D Extent Z", 101),
              AllOf(HasSubstr("Extent Z = 101"), HasSubstr("100")));
  EXPECT_THAT(boxes_message(first + "BoundingBox3D Origin X", 4e6),
              HasSubstr("CapturedObjects[0].BoundingBox3D Origin X = 4000000"));
  EXPECT_THAT(boxes_message(first + "Relative Velocity Z", -301),
              HasSubstr("CapturedObjects[0].Relative Velocity Z = -301"));
  EXPECT_THAT(boxes_message(first + "Relative Velocity Z", "nan"), HasSubstr("a number"));
  EXPECT_THAT(boxes_message(first + "ObjectId", 1.5),
              HasSubstr("CapturedObjects[0].ObjectId = 1.5"));
  EXPECT_THAT(boxes_message(first + "ObjectId", -1),
              AllOf(HasSubstr("CapturedObjects[0].ObjectId = -1"), HasSubstr("0 or above")));
  EXPECT_THAT(boxes_message(first + "ObjectType", 3),
              HasSubstr("CapturedObjects[0].ObjectType = 3"));
  EXPECT_THAT(boxes_message(first + "ActorName", nullptr),
              HasSubstr("CapturedObjects[0].ActorName = null"));
  EXPECT_THAT(boxes_message("/CapturedObjects/1/ObjectId", 4),
              AllOf(HasSubstr("CapturedObjects[1].ObjectId = 4"), HasSubstr("second")));
  EXPECT_THAT(boxes_message("/CapturedObjects", {{"a", 1}}), HasSubstr("an array"));
  EXPECT_THAT(boxes_message("/CapturedObjects/0", 5), HasSubstr("CapturedObjects[0] = 5"));
  for (const json& time :
       {json(4833189570000), json(""), json("12.5"), json("noon"), json("99999999999999999999")})
    EXPECT_THAT(boxes_message("/Timestamp", time), HasSubstr("Timestamp = " + time.dump()));
}

TEST(Boxes, RejectsMissingFields) {
  const json whole = object(4);
  for (const auto& [key, value] : whole.items()) {
    json document = frame();
    document["CapturedObjects"][1].erase(key);
    if (key == "Occluded" || key == "Truncated") {
      EXPECT_EQ(parsed_boxes(document).size(), 2u);
    } else {
      EXPECT_THAT(input_error([&] { parsed_boxes(document); }),
                  HasSubstr("CapturedObjects[1]." + key + ": missing"));
    }
  }
  for (const char* key : {"CapturedObjects", "Timestamp"}) {
    json document = frame();
    document.erase(key);
    EXPECT_THAT(input_error([&] { parsed_boxes(document); }),
                HasSubstr(std::string(key) + ": missing"));
  }
  EXPECT_THAT(input_error([] { aimotive::parse_boxes("[", "dir/frame_0000001.json"); }),
              HasSubstr("dir/frame_0000001.json"));
}

}  // namespace
}  // namespace redrive
