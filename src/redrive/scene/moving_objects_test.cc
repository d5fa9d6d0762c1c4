// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/moving_objects.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

using Eigen::Vector3d;

/// 10 m/s along x of the world, turning left by 0.2 rad/s; frames 0.1 s apart from 1 s on.
std::vector<FramePose> turning_drive() {
  std::vector<FramePose> frames;
  Rigid3d pose = Rigid3d::Identity();
  for (int n = 0; n < 20; ++n) {
    frames.push_back({n, 1'000'000'000 + n * 100'000'000ll, pose});
    pose.translate(Vector3d(1, 0, 0));
    pose.rotate(Eigen::AngleAxisd(0.02, Vector3d::UnitZ()));
  }
  return frames;
}

/// Returns the boxes of an object that is at `start_m` at 1 s and moves at `velocity_m_per_s`, both
/// in the world.
std::vector<Box> sightings(const std::vector<FramePose>& frames, std::int64_t id,
                           const Vector3d& start_m, const Vector3d& velocity_m_per_s) {
  std::vector<Box> boxes;
  for (std::size_t n = 1; n + 1 < frames.size(); ++n) {
    const Rigid3d& here = frames[n].global_from_body;
    const Vector3d ego_m_per_s = (frames[n + 1].global_from_body.translation() -
                                  frames[n - 1].global_from_body.translation()) /
                                 0.2;
    Box box;
    box.object_id = id;
    box.t_ns = frames[n].t_ns;
    box.body_from_box =
        here.inverse() * Eigen::Translation3d(start_m + 0.1 * double(n) * velocity_m_per_s);
    box.size_m = Vector3d(4, 2, 1.6);
    box.velocity_in_body_m_per_s = here.linear().transpose() * (velocity_m_per_s - ego_m_per_s);
    boxes.push_back(box);
  }
  return boxes;
}

TEST(MovingBox, IntersectsRaysThatHaveAPointInside) {
  MovingBox box{0, Rigid3d::Identity(), Vector3d(2, 1, 0.5)};
  box.box_from_world =
      (Eigen::Translation3d(5, 3, 1) * Eigen::AngleAxisd(0.7, Vector3d(1, 2, 3).normalized()))
          .inverse();
  int met = 0;
  for (int i = 0; i < 500; ++i) {
    const Vector3d origin(0.01 * i, 1, 0);
    const Vector3d direction = Vector3d(1, 0.5 - 0.002 * i, 0.3 * std::sin(0.1 * i)).normalized();
    bool inside = false;
    double closest = 1e9;  // distance to the nearest face, to exclude grazing rays
    for (double t = 0; t < 20; t += 0.002) {
      const Vector3d p = box.box_from_world * (origin + t * direction);
      closest = std::min(closest, (p.cwiseAbs() - box.half_size_m).maxCoeff());
      inside = inside || box.contains(origin + t * direction);
    }
    if (std::abs(closest) < 0.01) continue;
    EXPECT_EQ(box.intersects(origin, direction), inside) << i;
    EXPECT_FALSE(inside && box.intersects(origin - 30 * direction, -direction)) << i;  // behind
    met += inside;
  }
  EXPECT_GT(met, 50);
  EXPECT_LT(met, 450);
  EXPECT_TRUE(box.intersects({5, 3, 1}, {0, 0, 1}));  // from inside, along an axis
  EXPECT_TRUE(box.intersects({-5, 3, 1}, {10, 0, 0}, 1));
  EXPECT_FALSE(box.intersects({-5, 3, 1}, {5, 0, 0}, 1)) << "what ends before it";
}

TEST(MovingObjects, AParkedCarBesideATurningEgoVehicleIsParked) {
  const auto frames = turning_drive();
  const MovingObjects objects(sightings(frames, 7, {30, 8, 0.8}, Vector3d::Zero()), frames,
                              Rigid3d::Identity());
  EXPECT_TRUE(objects.objects().empty());
  EXPECT_EQ(objects.parked().size(), 1u);
  EXPECT_TRUE(objects.at(frames[5].t_ns).empty());
}

TEST(MovingObjects, APersonMovesAtAnySpeed) {
  const auto frames = turning_drive();
  std::vector<Box> boxes = sightings(frames, 7, {30, 8, 0.8}, Vector3d::Zero());
  for (Box& box : boxes) box.type = "PEDESTRIAN";
  const MovingObjects objects(boxes, frames, Rigid3d::Identity());
  EXPECT_EQ(objects.objects().size(), 1u);
  EXPECT_EQ(objects.parked().size(), 0u);
  EXPECT_EQ(objects.at(frames[5].t_ns).size(), 1u);
}

TEST(MovingObjects, ExtrapolatesBoxesByTheirVelocity) {
  const auto frames = turning_drive();
  const Vector3d start(30, 8, 0.8), velocity(-3, 1, 0);
  const MovingObjects objects(sightings(frames, 7, start, velocity), frames, Rigid3d::Identity());
  EXPECT_EQ(objects.parked().size(), 0u);
  for (const double t_s : {1.1, 1.43, 2.0, 2.849}) {
    const auto boxes = objects.at(std::llround(t_s * 1e9));
    ASSERT_EQ(boxes.size(), 1u) << t_s;
    const Vector3d centre = boxes[0].box_from_world.inverse().translation();
    EXPECT_LT((centre - start - (t_s - 1) * velocity).norm(), 1e-3) << t_s;
    EXPECT_EQ(boxes[0].half_size_m, Vector3d(2.3, 1.3, 1.1));
  }
  EXPECT_TRUE(objects.at(frames.back().t_ns + 50'000'000).empty());  // 0.15 s after its last box
}

TEST(MovingObjects, InterpolatesBetweenBoxesThatTurn) {
  const auto frames = turning_drive();
  std::vector<Box> boxes = sightings(frames, 7, {30, 8, 0.8}, {5, 0, 0});
  boxes.erase(boxes.begin() + 3);  // a gap of 0.2 s
  boxes.resize(6);
  for (Box& box : boxes)  // 0.5 rad/s
    box.body_from_box.rotate(
        Eigen::AngleAxisd(0.5e-9 * double(box.t_ns - frames[0].t_ns), Vector3d::UnitZ()));
  boxes[2].size_m.x() = 4.5;
  boxes.back().t_ns += 400'000'000;  // end of the same motion
  const MovingObjects objects(boxes, frames, Rigid3d::Identity());
  ASSERT_EQ(objects.objects().size(), 1u);
  const MovingObject& object = objects.objects()[0];
  EXPECT_EQ(object.id, 7);
  EXPECT_EQ(object.size_m, Vector3d(4.5, 2, 1.6));
  const auto pose = object.world_from_box(frames[4].t_ns + 30'000'000);
  ASSERT_TRUE(pose);
  EXPECT_LT((pose->translation() - Vector3d(30 + 5 * 0.43, 8, 0.8)).norm(), 1e-3);
  const double yaw = std::atan2(pose->linear()(1, 0), pose->linear()(0, 0));
  EXPECT_NEAR(yaw, 0.5 * 0.43, 1e-6);
  EXPECT_TRUE(object.world_from_box(boxes[4].t_ns + 200'000'000));   // half a second apart
  EXPECT_FALSE(object.world_from_box(boxes[5].t_ns + 101'000'000));  // after the last one
  EXPECT_FALSE(object.world_from_box(boxes[0].t_ns - 101'000'000));
}

// It waits, then drives off, and leaves its first position empty.
TEST(MovingObjects, AnObjectThatMovesLaterIsMovingInAllFrames) {
  const auto frames = turning_drive();
  std::vector<Box> boxes = sightings(frames, 7, {30, 8, 0.8}, Vector3d::Zero());
  boxes.back().velocity_in_body_m_per_s += Vector3d(1.5, 0, 0);
  EXPECT_EQ(MovingObjects(boxes, frames, Rigid3d::Identity()).at(frames[3].t_ns).size(), 1u);
}

}  // namespace
}  // namespace redrive
