// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/labels.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

// An ego vehicle at 10 m/s behind a car at 8 m/s and a standing person, annotated in body axes.
TEST(PlaceBoxes, VelocitiesAreDifferencesOfPositions) {
  std::vector<FramePose> frames;
  std::vector<Label> labels;
  for (int f = 0; f < 11; ++f) {
    FramePose frame;
    frame.id = f, frame.t_ns = f * 100'000'000ll;
    frame.global_from_body = Eigen::Translation3d(4e6 + f, 5, 6);
    frames.push_back(frame);
    for (const bool person : {false, true}) {
      Label label;
      label.frame_id = f, label.object_id = person;
      label.type = person ? "Pedestrian" : "Car";
      label.size_m = {4, 2, 1.5};
      label.sensor_from_box = Eigen::Translation3d(person ? 30 - f : 20 - 0.2 * f, 0, 0);
      labels.push_back(label);
    }
  }
  Label without_pose = labels[0];
  without_pose.frame_id = 11;
  labels.push_back(without_pose);
  const auto boxes = place_boxes(labels, Rigid3d::Identity(), frames);
  ASSERT_EQ(boxes.size(), 11u);
  for (const auto& [frame_id, of_frame] : boxes) {
    ASSERT_EQ(of_frame.size(), 2u);
    EXPECT_EQ(of_frame[0].t_ns, frame_id * 100'000'000);
    EXPECT_EQ(of_frame[0].actor_name, "Car 0");
    // 1e-8: steps of doubles at 4e6 over tenths of a second.
    EXPECT_LT((of_frame[0].velocity_in_body_m_per_s - Eigen::Vector3d(-2, 0, 0)).norm(), 1e-8);
    EXPECT_LT((of_frame[1].velocity_in_body_m_per_s - Eigen::Vector3d(-10, 0, 0)).norm(), 1e-8);
  }
  // An object that is seen once is taken to stand.
  const auto once = place_boxes({labels[0]}, Rigid3d::Identity(), frames);
  EXPECT_LT((once.at(0)[0].velocity_in_body_m_per_s - Eigen::Vector3d(-10, 0, 0)).norm(), 1e-8);
}

// A box ahead of the sensor, which is 1 m ahead of the body, as it was 20 ms before the frame.
TEST(PlaceBoxes, HoldAtTheirOwnTime) {
  FramePose frame;
  frame.id = 4, frame.t_ns = 50'000'000;
  frame.global_from_body = Rigid3d::Identity();
  Label label;
  label.frame_id = 4;
  label.sensor_from_box = Eigen::Translation3d(10, 0, 0);
  const Rigid3d body_from_sensor(Eigen::Translation3d(1, 0, 0));
  const auto boxes =
      place_boxes({label}, body_from_sensor, {frame}, [](const Label& of, const FramePose& at) {
        EXPECT_EQ(of.frame_id, at.id);
        return at.t_ns - 20'000'000;
      });
  EXPECT_EQ(boxes.at(4)[0].t_ns, 30'000'000);
  EXPECT_EQ(boxes.at(4)[0].body_from_box.translation(), Eigen::Vector3d(11, 0, 0));
}

}  // namespace
}  // namespace redrive
