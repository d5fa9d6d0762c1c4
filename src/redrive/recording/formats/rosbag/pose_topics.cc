// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/pose_topics.h"

#include <algorithm>
#include <mutex>
#include <numbers>

#include "redrive/base/error.h"
#include "redrive/math/local_level.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"

namespace redrive::rosbag {
namespace {

/// Calls `take(message index, bytes)` for all messages of a topic, one at a time; an InputError of
/// it makes its message a damaged pose.
template <class Take>
void each_message(const Bag& bag, const Topic& topic, Recording* recording, const Take& take) {
  std::mutex mutex;
  const auto fail = [&](std::size_t, const InputError& why) {
    const std::lock_guard lock(mutex);
    recording->damaged.push_back({"poses", -1, why.what()});
  };
  bag.read(
      topic.messages, kAllBytes,
      [&](std::size_t i, std::string_view bytes) {
        try {
          const std::lock_guard lock(mutex);
          take(i, bytes);
          return;
        } catch (const InputError& error) {
          recording->damaged.push_back({"poses", -1, error.what()});
        }
      },
      fail);
}

std::int64_t time_of(const Header& header, const Message& message, Clock clock) {
  return clock == Clock::kLog ? message.log_ns : header.t_ns;
}

/// Returns body_from_sensor without the height above ground: identity with a finding where it is
/// not known.
Rigid3d known_place(const std::string& frame, const std::string& topic, const Rig& rig,
                    const TransformTree& tree, Recording* recording) {
  if (frame.empty() || frame == rig.body) return Rigid3d::Identity();
  if (const auto pose = tree.fixed(rig.body, frame)) return *pose;
  recording->findings.push_back({topic, "/tf_static does not lead from " + rig.body + " to " +
                                            frame + ": taken for the same"});
  return Rigid3d::Identity();
}

std::vector<FramePose> poses_of_topic(const Bag& bag, const Topic& topic, const Rig& rig,
                                      const TransformTree& tree, Recording* recording) {
  std::vector<FramePose> poses;
  std::string child;
  each_message(bag, topic, recording, [&](std::size_t i, std::string_view bytes) {
    for (const Transform& pose : parse_poses(topic.type, bytes, bag.folder(), topic.name)) {
      if (child.empty()) child = pose.child;
      poses.push_back(
          {0, time_of(pose.header, topic.messages[i], rig.clock), pose.parent_from_child});
    }
  });
  const Rigid3d child_from_body = known_place(child, topic.name, rig, tree, recording).inverse();
  for (FramePose& pose : poses) pose.global_from_body = pose.global_from_body * child_from_body;
  return poses;
}

std::vector<FramePose> orientations(const Bag& bag, const Rig& rig, std::string* frame,
                                    Recording* recording) {
  const Topic* const topic = bag.find(rig.imu);
  const auto fail = [&](const std::string& rule) {
    throw InputError(bag.folder() / kRigFile, "poses.imu", rig.imu, rule);
  };
  if (!topic || topic->type != "sensor_msgs/msg/Imu") fail("is no topic with Imu messages");
  std::vector<FramePose> out;
  each_message(bag, *topic, recording, [&](std::size_t i, std::string_view bytes) {
    const Orientation of = parse_imu(bytes, bag.folder(), topic->name);
    if (!of.world_from_sensor) return;
    *frame = of.header.frame;
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = of.world_from_sensor->toRotationMatrix();
    out.push_back({0, time_of(of.header, topic->messages[i], rig.clock), pose});
  });
  if (out.empty()) fail("its messages have no orientation");
  sort_by_time(&out);
  return out;
}

/// Returns poses at the times of fixes; Imu orientations are in the local level frame, x east
/// (REP 103).
std::vector<FramePose> poses_of_fixes(const Bag& bag, const Topic& topic, const Rig& rig,
                                      const TransformTree& tree, Recording* recording) {
  std::string imu_frame, antenna_frame;
  const std::vector<FramePose> turned = orientations(bag, rig, &imu_frame, recording);
  std::vector<FramePose> poses;
  std::size_t without_fix = 0, without_turn = 0;
  constexpr double kRadian = std::numbers::pi / 180;
  constexpr std::int64_t kMostApart_ns = 100'000'000;
  each_message(bag, topic, recording, [&](std::size_t i, std::string_view bytes) {
    const Fix fix = parse_fix(bytes, bag.folder(), topic.name);
    const std::int64_t t_ns = time_of(fix.header, topic.messages[i], rig.clock);
    antenna_frame = fix.header.frame;
    if (!fix.valid) {
      ++without_fix;
      return;
    }
    if (t_ns < turned.front().t_ns - kMostApart_ns || t_ns > turned.back().t_ns + kMostApart_ns) {
      ++without_turn;
      return;
    }
    Rigid3d pose =
        ecef_from_enu({fix.latitude_deg * kRadian, fix.longitude_deg * kRadian, fix.altitude_m});
    pose.linear() *= pose_at(turned, t_ns).linear();
    poses.push_back({0, t_ns, pose});
  });
  const auto note = [&](std::size_t count, const char* what) {
    if (count > 0) recording->findings.push_back({topic.name, counted(count, "message") + what});
  };
  note(without_fix, " without a fix left out");
  note(without_turn, " without an orientation left out");
  const Rigid3d body_from_imu = known_place(imu_frame, rig.imu, rig, tree, recording),
                body_from_antenna = known_place(antenna_frame, topic.name, rig, tree, recording);
  for (FramePose& pose : poses) {
    pose.global_from_body.linear() *= body_from_imu.linear().transpose();
    pose.global_from_body =
        pose.global_from_body * Eigen::Translation3d(-body_from_antenna.translation());
  }
  recording->global_frame = GlobalFrame::kEcef;
  return poses;
}

}  // namespace

std::vector<FramePose> read_poses(const Bag& bag, const Topic& topic, const Rig& rig,
                                  const TransformTree& tree, Recording* recording) {
  std::vector<FramePose> poses;
  if (topic.type == "tf2_msgs/msg/TFMessage") {
    poses = tree.poses(rig.world, rig.body);
    if (poses.empty())
      throw InputError(bag.folder() / kRigFile, "poses.world, body.frame",
                       rig.world + ", " + rig.body,
                       "no moving transform of tf leads from one to the other");
  } else if (is_pose_type(topic.type)) {
    poses = poses_of_topic(bag, topic, rig, tree, recording);
  } else if (topic.type == "sensor_msgs/msg/NavSatFix") {
    poses = poses_of_fixes(bag, topic, rig, tree, recording);
  } else {
    throw InputError(bag.folder() / kRigFile, "poses.topic", topic.type, "is no type of poses");
  }
  const std::size_t unset =
      std::erase_if(poses, [](const FramePose& pose) { return pose.t_ns <= 0; });
  if (unset > 0)
    recording->findings.push_back(
        {topic.name, counted(unset, "pose") + " without a stamp left out"});
  sort_by_time(&poses);
  const DamagedList damaged{"poses", &recording->damaged};
  if (!poses.empty()) leave_out_strays(bag.folder(), topic.name + " position", damaged, &poses);
  if (poses.empty()) throw InputError(bag.folder(), topic.name, "", "has no pose that can be used");
  for (FramePose& pose : poses)
    pose.global_from_body = pose.global_from_body * Eigen::Translation3d(0, 0, -rig.above_ground_m);
  return poses;
}

}  // namespace redrive::rosbag
