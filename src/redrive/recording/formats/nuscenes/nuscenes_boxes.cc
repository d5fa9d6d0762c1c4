// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes_boxes.h"

#include <algorithm>
#include <span>

#include "redrive/recording/core/labels.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive::nuscenes {
namespace {

constexpr std::int64_t kMaxGap_ns = 1'100'000'000;  // a key frame where the object was hidden
constexpr std::int64_t kBeyond_ns = 100'000'000;    // as scene/moving_objects.cc

/// An object's boxes: poses are global_from_box at the time when the laser saw it.
struct Track {
  std::vector<FramePose> poses;
  std::vector<Eigen::Vector3d> sizes_m;
};

/// Returns the index of the box before a time, or of the first one; nothing in a gap.
std::optional<std::size_t> nearest_box(const Track& track, std::int64_t t_ns) {
  const std::vector<FramePose>& poses = track.poses;
  const auto after = std::ranges::lower_bound(poses, t_ns, {}, &FramePose::t_ns);
  if (after == poses.begin()) return 0;
  const std::size_t i = static_cast<std::size_t>(after - poses.begin()) - 1;
  if (after != poses.end() && after->t_ns - poses[i].t_ns > kMaxGap_ns &&
      t_ns - poses[i].t_ns > kBeyond_ns && after->t_ns - t_ns > kBeyond_ns)
    return std::nullopt;
  return i;
}

}  // namespace

std::map<std::int64_t, std::vector<Box>> boxes_of_frames(
    const SceneTables& scene, const std::optional<Rigid3d>& body_from_lidar, const Spin& spin,
    const std::vector<FramePose>& frames) {
  std::vector<std::vector<const Annotation*>> by_object(scene.categories.size());
  for (const Annotation& annotation : scene.annotations)
    by_object[annotation.object].push_back(&annotation);
  std::vector<Label> labels;
  for (std::size_t object = 0; object < by_object.size(); ++object) {
    std::vector<const Annotation*>& annotations = by_object[object];
    const auto time_of = [&](const Annotation* a) { return scene.sample_times_ns[a->sample]; };
    std::ranges::sort(annotations, {}, time_of);
    Track track;
    for (const Annotation* annotation : annotations) {
      std::int64_t t_ns = time_of(annotation);
      if (body_from_lidar)
        t_ns =
            spin.time_of((pose_at(scene.poses, t_ns) * *body_from_lidar).inverse(Eigen::Isometry) *
                             annotation->global_from_box.translation(),
                         t_ns);
      track.poses.push_back(
          {static_cast<std::int64_t>(track.poses.size()), t_ns, annotation->global_from_box});
      track.sizes_m.push_back(annotation->size_m);
    }
    const auto first = std::ranges::lower_bound(frames, track.poses.front().t_ns - kBeyond_ns, {},
                                                &FramePose::t_ns),
               last = std::ranges::upper_bound(frames, track.poses.back().t_ns + kBeyond_ns, {},
                                               &FramePose::t_ns);
    for (const FramePose& frame : std::span(first, last)) {
      const std::optional<std::size_t> nearest = nearest_box(track, frame.t_ns);
      if (!nearest) continue;
      Label label;
      label.frame_id = frame.id;
      label.object_id = static_cast<std::int64_t>(object);
      label.type = scene.categories[object];
      label.size_m = track.sizes_m[*nearest];
      label.sensor_from_box =
          frame.global_from_body.inverse(Eigen::Isometry) * pose_at(track.poses, frame.t_ns);
      labels.push_back(std::move(label));
    }
  }
  return place_boxes(labels, Rigid3d::Identity(), frames);
}

}  // namespace redrive::nuscenes
