// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/view_requests.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using nlohmann::json;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

json view(const std::string& file) {
  return {{"file", file}, {"camera", "F_CAM"}, {"frame_id", 33650}, {"shift_body_m", {0, 0.5, 0}}};
}
ViewRequests parsed_poses(const json& document) {
  return parse_view_requests(document.dump(), "dir/poses.json");
}

std::string poses_message(const std::string& field, const json& value) {
  json document = {{"images", {view("a.png"), view("b.png")}}};
  document["images"][1][json::json_pointer(field)] = value;
  const std::string message = input_error([&] { parsed_poses(document); });
  EXPECT_THAT(message, AllOf(HasSubstr("dir/poses.json"), HasSubstr("images[1]"))) << field;
  return message;
}

TEST(ViewRequests, ReadsEveryForm) {
  json document = {{"calibration", testing::calibration()},
                   {"images", {view("a.png"), view("sub/b.jpg"), view("c.png")}}};
  document["images"][1]["RT_ECEF_body"] = testing::pose_at(7, 0)["RT_ECEF_body"];
  document["images"][1].erase("shift_body_m");
  document["images"][2]["ECEF_RT_body"] = testing::pose_at(8, 0)["RT_ECEF_body"];
  const ViewRequests poses = parsed_poses(document);
  EXPECT_EQ(poses.cameras.size(), 2u);
  ASSERT_EQ(poses.views.size(), 3u);
  EXPECT_EQ(poses.views[0].file, "a.png");
  EXPECT_EQ(poses.views[0].camera, "F_CAM");
  EXPECT_EQ(poses.views[0].frame_id, 33650);
  EXPECT_EQ(*poses.views[0].shift_body_m, Eigen::Vector3d(0, 0.5, 0));
  EXPECT_FALSE(poses.views[0].global_from_body);
  EXPECT_EQ(poses.views[1].global_from_body->translation().x(), 4e6 + 7);
  EXPECT_FALSE(poses.views[1].shift_body_m);
  EXPECT_EQ(poses.views[2].global_from_body->translation().x(), 4e6 + 8);
  EXPECT_TRUE(poses.views[2].shift_body_m);
}

TEST(ViewRequests, RejectsFileNamesOutsideTheOutputFolder) {
  for (const char* name : {"", "/tmp/a.png", "../a.png", "a/../b.png", "./a.png", "a//b.png", "a/",
                           "a.bmp", "a", ".png", "a\n.png"}) {
    EXPECT_THAT(poses_message("/file", name), HasSubstr("images[1].file")) << name;
  }
  EXPECT_THAT(poses_message("/file", "a.png"), HasSubstr("overwrite"));
  EXPECT_THAT(poses_message("/file", "a.png/b.png"), HasSubstr("folder"));
  EXPECT_THAT(poses_message("/file", 7), HasSubstr("images[1].file = 7"));
}

TEST(ViewRequests, RejectsInvalidFields) {
  EXPECT_THAT(poses_message("/camera", 3), HasSubstr("images[1].camera = 3"));
  EXPECT_THAT(poses_message("/frame_id", "33650"), HasSubstr("images[1].frame_id = \"33650\""));
  EXPECT_THAT(poses_message("/frame_id", -1), HasSubstr("images[1].frame_id = -1"));
  EXPECT_THAT(poses_message("/frame_id", 1.5), HasSubstr("images[1].frame_id = 1.5"));
  EXPECT_THAT(poses_message("/shift_body_m", {1, 2}), HasSubstr("images[1].shift_body_m = [1,2]"));
  EXPECT_THAT(poses_message("/shift_body_m/1", "nan"),
              HasSubstr("images[1].shift_body_m[1] = \"nan\""));
  EXPECT_THAT(poses_message("/shift_body_m/1", 1e5), HasSubstr("images[1].shift_body_m"));
  EXPECT_THAT(poses_message("/RT_ECEF_body", {{1, 0}, {0, 1}}),
              HasSubstr("images[1].RT_ECEF_body"));
  for (const char* key : {"file", "camera", "frame_id", "shift_body_m"}) {
    json document = {{"images", {view("a.png")}}};
    document["images"][0].erase(key);
    EXPECT_THAT(input_error([&] { parsed_poses(document); }),
                AllOf(HasSubstr("images[0]"), HasSubstr(key)));
  }
}

TEST(ViewRequests, RejectsInvalidDocuments) {
  EXPECT_THAT(input_error([] { parsed_poses(json::object()); }),
              AllOf(HasSubstr("images"), HasSubstr("missing")));
  EXPECT_THAT(input_error([] {
                parsed_poses({{"images", json::array()}});
              }),
              HasSubstr("at least one"));
  EXPECT_THAT(input_error([] {
                parsed_poses({{"images", {{"a", view("a.png")}}}});
              }),
              HasSubstr("images"));
  json document = {{"calibration", testing::calibration()}, {"images", {view("a.png")}}};
  document["calibration"]["F_CAM"]["model"] = "f_theta";
  EXPECT_THAT(input_error([&] { parsed_poses(document); }),
              AllOf(HasSubstr("calibration.F_CAM.model"), HasSubstr("f_theta")));
  EXPECT_THAT(input_error([] { read_view_requests("/nowhere/poses.json"); }),
              HasSubstr("/nowhere/poses.json"));
}

}  // namespace
}  // namespace redrive
