// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_boxes.h"

#include <numbers>

#include "redrive/recording/formats/kitti/kitti_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;
using testing::kitti_label;

constexpr const char* kDontCare =
    "0 -1 DontCare -1 -1 -10 320 172 357 195 -1000 -1000 -1000 -10 -1 -1 -1\n";

TEST(KittiLabels, ReadsKnownValues) {
  const std::vector<Label> labels =
      kitti::parse_labels(std::string(kDontCare) + kitti_label(3, 7, "Car", 20) +
                              "3 8 Pedestrian 0 0 0 0 0 0 0 1.8 0.6 0.8 -2 1.7 12 0 0.97\n",
                          "0001.txt");
  ASSERT_EQ(labels.size(), 2u);
  const Label& car = labels[0];
  EXPECT_EQ(car.frame_id, 3);
  EXPECT_EQ(car.object_id, 7);
  EXPECT_EQ(car.type, "Car");
  EXPECT_EQ(car.size_m, Eigen::Vector3d(4.2, 1.8, 1.5));
  // rotation_y of -90 degrees: the object's front looks along the camera's z axis; its left is the
  // camera's -x, its top -y.
  EXPECT_TRUE((car.sensor_from_box * Eigen::Vector3d(2.1, 0.9, 0.75))
                  .isApprox(Eigen::Vector3d(1 - 0.9, 1.6 - 1.5, 20 + 2.1), 1e-12));
  // Without rotation the front looks along x, the left side along z.
  EXPECT_TRUE((labels[1].sensor_from_box * Eigen::Vector3d(0.4, 0.3, -0.9))
                  .isApprox(Eigen::Vector3d(-1.6, 1.7, 12.3), 1e-12));
  EXPECT_TRUE(kitti::parse_labels("", "0001.txt").empty());
}

TEST(KittiLabels, RejectsInvalidValues) {
  const auto message = [](const std::string& before, const std::string& after) {
    std::string line = kitti_label(3, 7, "Car", 20);
    line.replace(line.find(before), before.size(), after);
    const std::string message =
        input_error([&] { kitti::parse_labels(line, "label_02/0001.txt"); });
    EXPECT_THAT(message, HasSubstr("label_02/0001.txt: line 1")) << after;
    return message;
  };
  EXPECT_THAT(message(" Car", " Spaceship"),
              AllOf(HasSubstr("type = Spaceship"), HasSubstr("Cyclist")));
  EXPECT_THAT(message(" Car", " Car 1 1"), HasSubstr("number of values = 19"));
  EXPECT_THAT(message(" Car", ""), HasSubstr("number of values = 16"));
  EXPECT_THAT(message("3 7", "-3 7"), HasSubstr("frame = -3"));
  EXPECT_THAT(message("3 7", "3 -1"), HasSubstr("track = -1"));
  EXPECT_THAT(message("3 7", "3.5 7"), HasSubstr("frame = 3.5: a whole number"));
  EXPECT_THAT(message(" 1.5 ", " 0 "), HasSubstr("height = 0"));
  EXPECT_THAT(message(" 1.8 ", " nan "), HasSubstr("width = nan"));
  EXPECT_THAT(message(" 4.2 ", " 101 "), HasSubstr("length = 101"));
  EXPECT_THAT(message(" 1.6 ", " inf "), HasSubstr("y = inf"));
  EXPECT_THAT(message(" 20.", " 2000."), HasSubstr("z = 2000"));
  EXPECT_THAT(message(" -1.5707963267948966", " 90"), HasSubstr("rotation_y = 90"));
  EXPECT_THAT(input_error([] {
                kitti::parse_labels(kitti_label(3, 7, "Car", 20) + kitti_label(3, 7, "Car", 21),
                                    "0001.txt");
              }),
              AllOf(HasSubstr("line 2, track = 7"), HasSubstr("second")));
}

std::string tracklets_of(const std::string& items) {
  return "<?xml version=\"1.0\" encoding=\"UTF-8\" standalone=\"yes\" ?>\n"
         "<!DOCTYPE boost_serialization>\n"
         "<boost_serialization signature=\"serialization::archive\" version=\"9\">\n"
         "<tracklets class_id=\"0\" version=\"0\"><count>1</count>" +
         items + "</tracklets></boost_serialization>\n";
}

std::string tracklet(const std::string& type, int first_frame, int poses) {
  std::string text = "<item version=\"1\"><objectType>" + type +
                     "</objectType><h>1.5</h><w>1.8</w><l>4.2</l><first_frame>" +
                     std::to_string(first_frame) + "</first_frame><poses><count>" +
                     std::to_string(poses) + "</count>";
  for (int i = 0; i < poses; ++i)
    text += "<item><tx>" + std::to_string(20 + i) +
            "</tx><ty>3</ty><tz>-1.7</tz><rx>0</rx><ry>0</ry><rz>1.5707963267948966</rz>"
            "<state>2</state></item>";
  return text + "</poses><finished>1</finished></item>";
}

TEST(KittiTracklets, ReadsKnownValues) {
  const std::vector<Label> labels = kitti::parse_tracklets(
      tracklets_of(tracklet("Car", 3, 2) + tracklet("Person (sitting)", 0, 1)), "t.xml");
  ASSERT_EQ(labels.size(), 3u);
  EXPECT_EQ(labels[1].frame_id, 4);
  EXPECT_EQ(labels[1].object_id, 0);
  EXPECT_EQ(labels[1].size_m, Eigen::Vector3d(4.2, 1.8, 1.5));
  // The front looks to the left of the Velodyne.
  EXPECT_TRUE((labels[1].sensor_from_box * Eigen::Vector3d(2.1, 0.9, -0.75))
                  .isApprox(Eigen::Vector3d(21 - 0.9, 3 + 2.1, -1.7), 1e-12));
  EXPECT_EQ(labels[2].object_id, 1);
  EXPECT_EQ(labels[2].type, "Person (sitting)");
}

TEST(KittiTracklets, RejectsInvalidValues) {
  const auto message = [](const std::string& before, const std::string& after) {
    std::string text = tracklets_of(tracklet("Car", 3, 1));
    text.replace(text.find(before), before.size(), after);
    const std::string message =
        input_error([&] { kitti::parse_tracklets(text, "tracklet_labels.xml"); });
    EXPECT_THAT(message, HasSubstr("tracklet_labels.xml: ")) << after;
    return message;
  };
  const std::string item = "boost_serialization.tracklets[0].";
  EXPECT_THAT(message("</tracklets>", ""), AllOf(HasSubstr("byte "), HasSubstr("no XML")));
  EXPECT_THAT(message("boost_serialization sig", "boost sig"), HasSubstr("no XML"));
  EXPECT_THAT(message("<h>1.5</h>", ""), HasSubstr(item + "h: missing"));
  EXPECT_THAT(message("<h>1.5</h>", "<h>-1</h>"), HasSubstr(item + "h = -1"));
  EXPECT_THAT(message("<h>1.5</h>", "<h/>"), HasSubstr(item + "h: a number was expected"));
  EXPECT_THAT(message("<w>1.8</w>", "<w>1 2</w>"), HasSubstr(item + "w = 1 2"));
  EXPECT_THAT(message("Car", "Boat"), HasSubstr(item + "objectType = Boat: unknown"));
  EXPECT_THAT(message("<first_frame>3", "<first_frame>x"), HasSubstr("first_frame = x"));
  EXPECT_THAT(message("<ty>3</ty>", ""), HasSubstr(item + "poses[0].ty: missing"));
  EXPECT_THAT(message("<ty>3</ty>", "<ty>nan</ty>"), HasSubstr(item + "poses[0].ty = nan"));
  EXPECT_THAT(message("<tz>-1.7", "<tz>-1e4"), HasSubstr("tz = -1e4"));
  EXPECT_THAT(input_error([] { kitti::parse_tracklets("<a></a>", "t.xml"); }),
              HasSubstr("boost_serialization: missing"));
  EXPECT_THAT(input_error([] { kitti::parse_tracklets("", "t.xml"); }), HasSubstr("no XML"));
}

TEST(KittiBoxes, HoldWhenTheLaserPointsAtThem) {
  FramePose frame;
  frame.id = 4, frame.t_ns = 50;
  Label label;
  label.sensor_from_box = Eigen::Translation3d(0, 20, 0);  // to the left
  EXPECT_EQ(kitti::time_in_scans(Rigid3d::Identity(), {{4, {0, 1000}}})(label, frame), 250);
  EXPECT_EQ(kitti::time_in_scans(Rigid3d::Identity(), {{5, {0, 1000}}})(label, frame), 50);
}

}  // namespace
}  // namespace redrive
