// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/labels.h"

#include <algorithm>
#include <cmath>

#include "redrive/recording/core/trajectory.h"

namespace redrive {
namespace {

constexpr double kVelocityOver_s = 0.5;  // to either side, to average errors of annotators

struct BoxAt {
  std::int64_t frame_id = 0;
  double t_s = 0;  ///< seconds after the first frame
  Eigen::Vector3d in_global;
  Box box;
};

/// Slope of the positions near boxes[i], least squares; zero for a single one.
Eigen::Vector3d velocity_of(const std::vector<BoxAt>& boxes, std::size_t i) {
  double times = 0, n = 0;
  Eigen::Vector3d positions = Eigen::Vector3d::Zero();
  const auto near = [&](const BoxAt& b) {
    return std::abs(b.t_s - boxes[i].t_s) <= kVelocityOver_s;
  };
  std::size_t begin = i, end = i + 1;
  while (begin > 0 && near(boxes[begin - 1])) --begin;
  while (end < boxes.size() && near(boxes[end])) ++end;
  // Relative to boxes[i]: ECEF coordinates would cost digits.
  for (std::size_t k = begin; k < end; ++k) {
    times += boxes[k].t_s - boxes[i].t_s;
    positions += boxes[k].in_global - boxes[i].in_global;
    n += 1;
  }
  double squares = 0;
  Eigen::Vector3d products = Eigen::Vector3d::Zero();
  for (std::size_t k = begin; k < end; ++k) {
    const double t = boxes[k].t_s - boxes[i].t_s - times / n;
    squares += t * t;
    products += t * (boxes[k].in_global - boxes[i].in_global - positions / n);
  }
  return squares > 0 ? Eigen::Vector3d(products / squares) : Eigen::Vector3d::Zero();
}

}  // namespace

std::map<std::int64_t, std::vector<Box>> place_boxes(const std::vector<Label>& labels,
                                                     const Rigid3d& body_from_sensor,
                                                     const std::vector<FramePose>& frames,
                                                     const TimeOfLabel& time_of) {
  std::map<std::int64_t, std::vector<BoxAt>> by_object;
  for (const Label& label : labels) {
    const auto frame = std::ranges::lower_bound(frames, label.frame_id, {}, &FramePose::id);
    if (frame == frames.end() || frame->id != label.frame_id) continue;
    BoxAt at;
    at.frame_id = label.frame_id;
    Box& box = at.box;
    box.object_id = label.object_id;
    box.type = label.type;
    box.actor_name = label.type + " " + std::to_string(label.object_id);
    box.size_m = label.size_m;
    box.body_from_box = body_from_sensor * label.sensor_from_box;
    box.t_ns = time_of ? time_of(label, *frame) : frame->t_ns;
    at.t_s = 1e-9 * static_cast<double>(box.t_ns - frames.front().t_ns);
    at.in_global = pose_at(frames, box.t_ns) * box.body_from_box.translation();
    by_object[label.object_id].push_back(std::move(at));
  }
  std::map<std::int64_t, std::vector<Box>> by_frame;
  for (auto& [id, boxes] : by_object) {
    std::ranges::sort(boxes, {}, &BoxAt::t_s);
    for (std::size_t i = 0; i < boxes.size(); ++i) {
      Box box = std::move(boxes[i].box);
      box.velocity_in_body_m_per_s = pose_at(frames, box.t_ns).linear().transpose() *
                                     (velocity_of(boxes, i) - velocity_at(frames, box.t_ns));
      by_frame[boxes[i].frame_id].push_back(std::move(box));
    }
  }
  return by_frame;
}

}  // namespace redrive
