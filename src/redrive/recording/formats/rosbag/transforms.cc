// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/transforms.h"

#include <algorithm>

#include "redrive/recording/core/trajectory.h"

namespace redrive::rosbag {

void TransformTree::add(const Transform& transform, bool is_static) {
  if (transform.child.empty() || transform.child == transform.header.frame) return;
  Link& of = frames_[transform.child];
  if (of.parent != transform.header.frame) of = {transform.header.frame, {}, true};
  if (is_static) of.poses.clear();
  of.is_static = is_static;
  of.poses.push_back({0, transform.header.t_ns, transform.parent_from_child});
}

void sort_by_time(std::vector<FramePose>* poses) {
  std::ranges::stable_sort(*poses, {}, &FramePose::t_ns);
  const auto repeated = [](const FramePose& a, const FramePose& b) { return a.t_ns == b.t_ns; };
  poses->erase(std::unique(poses->begin(), poses->end(), repeated), poses->end());
}

void TransformTree::finish() {
  for (auto& [child, of] : frames_) {
    sort_by_time(&of.poses);
    const Rigid3d& same = of.poses.front().global_from_body;
    of.is_static |= std::ranges::all_of(of.poses, [&](const FramePose& pose) {
      return pose.global_from_body.isApprox(same, 1e-12);
    });
  }
}

bool TransformTree::is_parent(const std::string& frame) const {
  return std::ranges::any_of(frames_,
                             [&](const auto& named) { return named.second.parent == frame; });
}

const TransformTree::Link* TransformTree::link(const std::string& frame) const {
  const auto found = frames_.find(frame);
  return found == frames_.end() ? nullptr : &found->second;
}

std::vector<std::string> TransformTree::ancestors(const std::string& frame) const {
  std::vector<std::string> above;
  constexpr std::size_t kMostLevels = 64;  // a loop has no end
  for (const Link* of = link(frame); of && above.size() < kMostLevels; of = link(above.back()))
    above.push_back(of->parent);
  return above;
}

std::optional<Rigid3d> TransformTree::fixed(const std::string& a, const std::string& b) const {
  // Frames above that only static transforms lead to, with their transforms.
  const auto chain = [&](const std::string& frame) {
    std::vector<std::pair<std::string, Rigid3d>> above = {{frame, Rigid3d::Identity()}};
    constexpr std::size_t kMostLevels = 64;
    for (const Link* of = link(frame); of && of->is_static && above.size() < kMostLevels;
         of = link(above.back().first)) {
      const Rigid3d from_frame = of->poses.front().global_from_body * above.back().second;
      above.emplace_back(of->parent, from_frame);
    }
    return above;
  };
  const auto of_a = chain(a), of_b = chain(b);
  for (const auto& [name, from_b] : of_b)
    for (const auto& [other, from_a] : of_a)
      if (name == other) return from_a.inverse() * from_b;
  return std::nullopt;
}

std::vector<FramePose> TransformTree::poses(const std::string& parent,
                                            const std::string& child) const {
  std::vector<const Link*> links;  // from the child up
  constexpr std::size_t kMostLevels = 64;
  for (std::string at = child; at != parent;) {
    const Link* const of = link(at);
    if (!of || links.size() >= kMostLevels) return {};
    links.push_back(of);
    at = of->parent;
  }
  const auto most = std::ranges::max_element(
      links, {}, [](const Link* of) { return of->is_static ? std::size_t{0} : of->poses.size(); });
  if (most == links.end() || (*most)->is_static) return {};
  std::vector<FramePose> out;
  for (const FramePose& at : (*most)->poses) {
    Rigid3d pose = Rigid3d::Identity();
    for (const Link* of : links) {
      const std::int64_t t_ns = std::clamp(at.t_ns, of->poses.front().t_ns, of->poses.back().t_ns);
      pose = (of->is_static ? of->poses.front().global_from_body : pose_at(of->poses, t_ns)) * pose;
    }
    out.push_back({0, at.t_ns, pose});
  }
  return out;
}

std::vector<std::string> TransformTree::moving() const {
  std::vector<std::string> out;
  for (const auto& [child, of] : frames_)
    if (!of.is_static) out.push_back(child);
  return out;
}

}  // namespace redrive::rosbag
