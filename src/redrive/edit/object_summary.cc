// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/object_summary.h"

#include <algorithm>
#include <limits>

namespace redrive {
namespace {

ObjectSummary summary_of(const Scene& scene, const MovingObject& object, bool moves) {
  ObjectSummary out{
      .id = object.id, .type = object.type, .moves = moves, .boxes = object.keys.size()};
  for (std::size_t i = 1; i < object.keys.size(); ++i)
    out.driven_m += (object.keys[i].world_from_box.translation() -
                     object.keys[i - 1].world_from_box.translation())
                        .norm();
  out.nearest_m = std::numeric_limits<double>::infinity();
  for (const Frame& frame : scene.frames)
    if (const auto pose = object.world_from_box(frame.t_ns))
      out.nearest_m =
          std::min(out.nearest_m,
                   (pose->translation() - scene.world_from_body(frame.t_ns).translation()).norm());
  for (const View& view : scene.views) {
    const RigCamera& rig = scene.rig[view.camera];
    const auto pose = object.world_from_box(scene.frames[view.frame].t_ns + rig.time_offset_ns);
    if (!pose) continue;
    const auto pixel = rig.camera.project(scene.world_from_camera(view).inverse(Eigen::Isometry) *
                                          pose->translation());
    out.images += pixel && pixel->x() >= -0.5 && pixel->y() >= -0.5 &&
                  pixel->x() < rig.camera.width - 0.5 && pixel->y() < rig.camera.height - 0.5;
  }
  return out;
}

}  // namespace

std::vector<ObjectSummary> summarize_objects(const Scene& scene, const MovingObjects& objects) {
  std::vector<ObjectSummary> summaries;
  for (const MovingObject& object : objects.objects())
    summaries.push_back(summary_of(scene, object, true));
  for (const MovingObject& object : objects.parked())
    summaries.push_back(summary_of(scene, object, false));
  std::ranges::sort(summaries, {}, &ObjectSummary::id);
  return summaries;
}

}  // namespace redrive
