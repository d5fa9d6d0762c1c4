// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/shutter_poses.h"

#include "redrive/base/error.h"
#include "redrive/scene/moving_object.h"

namespace redrive {

ShutterPoses::ShutterPoses(const std::vector<Rigid3d>& keys, bool by_column)
    : by_column_(by_column) {
  REDRIVE_CHECK(!keys.empty());
  for (const Rigid3d& key : keys) keys_.push_back(plain(key));
}

PixelPoses::PixelPoses(const ShutterPoses& poses, int width, int height)
    : width_(static_cast<std::size_t>(width)), by_column_(poses.by_column()) {
  const int lines = by_column_ ? width : height;
  for (int line = 0; line < lines; ++line) lines_.push_back(poses.at(row_fraction(line, lines)));
}

std::vector<ShutterPoses::Actor> seen_actors(const std::vector<MovingObject>& actors,
                                             std::span<const PlainPose> world_from_sensor,
                                             std::span<const std::int64_t> t_ns) {
  std::vector<ShutterPoses::Actor> seen;
  for (const MovingObject& actor : actors) {
    const int number = 1 + static_cast<int>(&actor - actors.data());
    ShutterPoses::Actor here{
        actor.body.value_or(actor.id), actor.gain, {}, {}, actor.imported, number};
    for (std::size_t key = 0; key < t_ns.size(); ++key) {
      const auto world_from_actor = actor.world_from_box(t_ns[key]);
      if (!world_from_actor) break;
      here.key_times.push_back(*actor.key_time(t_ns[key]));
      here.actor_from_camera.push_back(
          plain(world_from_actor->inverse(Eigen::Isometry) * rigid(world_from_sensor[key])));
    }
    if (here.actor_from_camera.size() == t_ns.size()) seen.push_back(std::move(here));
  }
  return seen;
}

}  // namespace redrive
