// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/moving_objects.h"

#include <algorithm>
#include <map>

#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {

std::optional<double> MovingBox::entry(const Eigen::Vector3d& origin,
                                       const Eigen::Vector3d& direction, double most) const {
  const Eigen::Vector3d o = box_from_world * origin, d = box_from_world.linear() * direction;
  double enter = 0, leave = most;
  for (int k = 0; k < 3; ++k) {
    if (d[k] == 0) {
      if (std::abs(o[k]) > half_size_m[k]) return std::nullopt;
      continue;
    }
    const double a = (-half_size_m[k] - o[k]) / d[k], b = (half_size_m[k] - o[k]) / d[k];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  if (enter > leave) return std::nullopt;
  return enter;
}

MovingObjects::MovingObjects(const std::vector<Box>& boxes, const std::vector<FramePose>& frames,
                             const Rigid3d& global_from_world) {
  const Rigid3d world_from_global = global_from_world.inverse();
  const auto world_from_body = [&](std::int64_t t_ns) {
    return world_from_global * pose_at(frames, t_ns);
  };
  std::map<std::int64_t, MovingObject> by_id;
  for (const Box& box : boxes) {
    const Rigid3d here = world_from_body(box.t_ns);
    const Eigen::Vector3d ego_m_per_s = world_from_global.linear() * velocity_at(frames, box.t_ns);
    MovingObject& object = by_id[box.object_id];
    object.id = box.object_id;
    object.type = box.type;
    object.size_m = object.size_m.cwiseMax(box.size_m);
    object.keys.push_back({box.t_ns, here * box.body_from_box,
                           here.linear() * box.velocity_in_body_m_per_s + ego_m_per_s});
  }
  for (auto& [id, object] : by_id) {
    const bool fast = std::ranges::any_of(object.keys, [](const MovingObject::Key& key) {
      return key.velocity_in_world_m_per_s.norm() > kMovingSpeed_m_per_s;
    });
    std::ranges::sort(object.keys, {}, &MovingObject::Key::t_ns);
    (kind_of(object.type).always_moves || fast ? objects_ : parked_).push_back(std::move(object));
  }
}

std::vector<MovingBox> MovingObjects::at(std::int64_t t_ns) const {
  std::vector<MovingBox> boxes;
  for (const MovingObject& object : objects_)
    if (const auto world_from_box = object.world_from_box(t_ns))
      boxes.push_back({object.id, world_from_box->inverse(),
                       object.size_m / 2 + Eigen::Vector3d::Constant(kBoxMargin_m)});
  return boxes;
}

MovingObjects MovingObjects::without(const std::vector<MovingObject>& others) const {
  MovingObjects rest = *this;
  std::erase_if(rest.objects_, [&](const MovingObject& object) {
    return std::ranges::find(others, object.id, &MovingObject::id) != others.end();
  });
  return rest;
}

MovingObjects MovingObjects::with(const std::vector<MovingObject>& others) const {
  MovingObjects all = *this;
  all.objects_.insert(all.objects_.end(), others.begin(), others.end());
  std::ranges::stable_sort(all.objects_, {}, &MovingObject::id);
  return all;
}

MovingObjects read_moving_objects(const Recording& recording, const Scene& scene) {
  std::vector<Box> boxes;
  for (const FrameFile& file : recording.box_files) {
    const std::vector<Box> of_frame = recording.reader->read_boxes(file);
    boxes.insert(boxes.end(), of_frame.begin(), of_frame.end());
  }
  return {boxes, recording.frames, scene.global_from_world};
}

}  // namespace redrive
