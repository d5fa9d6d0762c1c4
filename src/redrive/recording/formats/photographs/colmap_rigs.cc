// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/photographs/colmap_rigs.h"

#include <algorithm>
#include <cstdio>

#include <Eigen/Geometry>

#include "redrive/math/angles.h"
#include "redrive/recording/core/wording.h"

namespace redrive::colmap {
namespace {

constexpr double kSameAngle_rad = 1e-3 * kRadiansPerDegree, kSamePart = 1e-5;

Eigen::Vector3d center_of(const Rigid3d& camera_from_world) {
  return camera_from_world.inverse(Eigen::Isometry).translation();
}

/// Side of the box around the cameras, or the distance of a single one from the origin.
double extent_of(const std::vector<ImageRecord>& images) {
  Eigen::AlignedBox3d box;
  for (const ImageRecord& image : images) box.extend(center_of(image.camera_from_world));
  const double side = box.isEmpty() ? 0 : box.sizes().maxCoeff();
  return side > 0 ? side : box.center().norm();
}

}  // namespace

void take_poses_of_rigs(const std::vector<RigRecord>& rigs, const std::vector<FrameRecord>& frames,
                        std::vector<ImageRecord>* images, std::vector<Finding>* findings) {
  std::map<std::int64_t, const RigRecord*> rig_of;
  for (const RigRecord& rig : rigs) rig_of[rig.id] = &rig;
  std::map<std::int64_t, ImageRecord*> image_of;
  for (ImageRecord& image : *images) image_of[image.id] = &image;
  const double same = kSamePart * extent_of(*images);
  std::vector<std::string> moved;
  double most_rad = 0, most = 0;
  for (const FrameRecord& frame : frames) {
    const auto rig = rig_of.find(frame.rig_id);
    if (rig == rig_of.end()) continue;
    for (const auto& [image_id, camera_id] : frame.camera_of_image) {
      const auto image = image_of.find(image_id);
      const auto sensor = rig->second->camera_from_rig.find(camera_id);
      if (image == image_of.end() || image->second->camera_id != camera_id ||
          sensor == rig->second->camera_from_rig.end() || !sensor->second)
        continue;
      Rigid3d& pose = image->second->camera_from_world;
      const Rigid3d by_rig = *sensor->second * frame.rig_from_world;
      const double angle_rad =
                       Eigen::AngleAxisd(pose.linear().transpose() * by_rig.linear()).angle(),
                   apart = (center_of(pose) - center_of(by_rig)).norm();
      if (angle_rad <= kSameAngle_rad && apart <= same) continue;
      most_rad = std::max(most_rad, angle_rad);
      most = std::max(most, apart);
      pose = by_rig;
      moved.push_back(image->second->name);
    }
  }
  if (moved.empty()) return;
  char by[120];
  std::snprintf(by, sizeof by, "by up to %.3g degrees and %.3g", most_rad * kDegreesPerRadian,
                most);
  findings->push_back({"rigs", "poses of " + counted(moved.size(), "image") + " of " +
                                   std::to_string(images->size()) +
                                   " differ from those that the images have of their own, " + by +
                                   "; those of the rigs are used: " + first_few(moved)});
}

}  // namespace redrive::colmap
