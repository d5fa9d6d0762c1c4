// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/moving_objects.h"

#include <algorithm>
#include <map>
#include <set>

#include "redrive/recording/trajectory.h"

namespace redrive {
namespace {

constexpr std::int64_t kMaxExtrapolation_ns = 100'000'000;  // bridges a missing revolution or frame
constexpr std::int64_t kVelocityOver_ns =
    100'000'000;  // to either side, to average errors of single poses

}  // namespace

bool MovingBox::intersects(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const {
  const Eigen::Vector3d o = box_from_world * origin, d = box_from_world.linear() * direction;
  double enter = 0, leave = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k) {
    if (d[k] == 0) {
      if (std::abs(o[k]) > half_size_m[k]) return false;
      continue;
    }
    const double a = (-half_size_m[k] - o[k]) / d[k], b = (half_size_m[k] - o[k]) / d[k];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter <= leave;
}

MovingObjects::MovingObjects(const std::vector<Box>& boxes, const std::vector<FramePose>& frames,
                             const Rigid3d& global_from_world) {
  const Rigid3d world_from_global = global_from_world.inverse();
  const auto world_from_body = [&](std::int64_t t_ns) {
    return world_from_global * pose_at(frames, t_ns);
  };
  std::map<std::int64_t, std::vector<BoxAtTime>> by_id;
  std::set<std::int64_t> deforming;
  for (const Box& box : boxes) {
    const Rigid3d here = world_from_body(box.t_ns);
    const Eigen::Vector3d ego_m_per_s =
        (world_from_body(box.t_ns + kVelocityOver_ns).translation() -
         world_from_body(box.t_ns - kVelocityOver_ns).translation()) /
        (2e-9 * static_cast<double>(kVelocityOver_ns));
    if (box.deforms) deforming.insert(box.object_id);
    by_id[box.object_id].push_back({box.t_ns, here * box.body_from_box, box.size_m,
                                    here.linear() * box.velocity_in_body_m_per_s + ego_m_per_s});
  }
  for (auto& [id, boxes_of_object] : by_id) {
    if (!deforming.contains(id) &&
        std::none_of(boxes_of_object.begin(), boxes_of_object.end(), [](const BoxAtTime& s) {
          return s.velocity_in_world_m_per_s.norm() > kMovingSpeed_m_per_s;
        })) {
      ++parked_;
      continue;
    }
    std::sort(boxes_of_object.begin(), boxes_of_object.end(),
              [](const auto& a, const auto& b) { return a.t_ns < b.t_ns; });
    objects_.push_back(std::move(boxes_of_object));
  }
}

std::vector<MovingBox> MovingObjects::at(std::int64_t t_ns) const {
  std::vector<MovingBox> boxes;
  for (const std::vector<BoxAtTime>& boxes_of_object : objects_) {
    auto nearest = std::lower_bound(boxes_of_object.begin(), boxes_of_object.end(), t_ns,
                                    [](const BoxAtTime& s, std::int64_t t) { return s.t_ns < t; });
    if (nearest == boxes_of_object.end() ||
        (nearest != boxes_of_object.begin() && t_ns - (nearest - 1)->t_ns < nearest->t_ns - t_ns))
      --nearest;
    const std::int64_t later_ns = t_ns - nearest->t_ns;
    if (std::abs(later_ns) > kMaxExtrapolation_ns) continue;
    Rigid3d world_from_box = nearest->world_from_box;
    world_from_box.translation() +=
        1e-9 * static_cast<double>(later_ns) * nearest->velocity_in_world_m_per_s;
    boxes.push_back(
        {world_from_box.inverse(), nearest->size_m / 2 + Eigen::Vector3d::Constant(kBoxMargin_m)});
  }
  return boxes;
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
