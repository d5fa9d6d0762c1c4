// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/poses/pose_changes.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/train/poses/pose_refiner.h"

namespace redrive {
namespace {

constexpr float kNearBound = 0.98f;

}  // namespace

int PoseChanges::frames_at_bound() const {
  return static_cast<int>(std::ranges::count(frames, true, &PoseChange::at_bound));
}

PoseChanges pose_changes(const Scene& scene, const PoseCorrections& corrections,
                         const PoseBounds& bounds) {
  REDRIVE_CHECK_OP(scene.rig.size(), ==, static_cast<std::size_t>(corrections.cameras));
  const auto near_bound = [&](std::size_t i) {
    return std::abs(corrections.values[i]) >= kNearBound * bound_of(bounds, corrections, i);
  };
  const auto change_at = [&](std::size_t at) {
    const auto three = [&](std::size_t i) {
      return Eigen::Vector3d(
          Eigen::Map<const Eigen::Vector3f>(&corrections.values[i]).cast<double>());
    };
    PoseChange change{three(at), three(at + 3)};
    for (std::size_t i = at; i < at + 6; ++i) change.at_bound |= near_bound(i);
    return change;
  };
  PoseChanges changes;
  changes.bounds = bounds;
  for (int f = 0; f < corrections.frames; ++f) {
    changes.frames.push_back(change_at(corrections.frame_slot(f)));
    changes.translation_m += changes.frames.back().translation_m.squaredNorm() / corrections.frames;
    changes.rotation_rad += changes.frames.back().rotation_rad.squaredNorm() / corrections.frames;
  }
  changes.translation_m = std::sqrt(changes.translation_m);
  changes.rotation_rad = std::sqrt(changes.rotation_rad);
  for (int c = 0; c < corrections.cameras; ++c) {
    const std::size_t at = corrections.camera_slot(c), time = corrections.time_slot(c);
    CameraChange camera{scene.rig[c].name, change_at(at), corrections.values[time]};
    camera.pose.at_bound |= near_bound(time);
    // Removes the correction from body_from_camera: corrections are in the initial axes.
    const Eigen::Matrix3d body_from_camera =
        scene.rig[c].body_from_sensor.linear() *
        rigid_from_vector(&corrections.values[at]).linear().transpose();
    camera.pose.translation_m = body_from_camera * camera.pose.translation_m;
    camera.pose.rotation_rad = body_from_camera * camera.pose.rotation_rad;
    changes.cameras.push_back(camera);
  }
  return changes;
}

std::string describe_changes(const PoseChanges& changes) {
  char line[200];
  std::snprintf(line, sizeof line, "poses refined: frames by %.1f cm and %.3f degrees RMS",
                100 * changes.translation_m, kDegreesPerRadian * changes.rotation_rad);
  std::string out = line;
  if (const int frames = changes.frames_at_bound(); frames > 0)
    out += "; WARNING: " + std::to_string(frames) + " of " + std::to_string(changes.frames.size()) +
           " at their bounds, see redrive align";
  out += '\n';
  for (const CameraChange& camera : changes.cameras) {
    const PoseChange& pose = camera.pose;
    std::snprintf(line, sizeof line, ": by %.1f cm, %.3f degrees, %+.1f ms%s\n",
                  100 * pose.translation_m.norm(), kDegreesPerRadian * pose.rotation_rad.norm(),
                  1e3 * camera.time_offset_s,
                  pose.at_bound ? "; WARNING: at its bound, see redrive align" : "");
    out += camera.name + line;
  }
  return out;
}

std::string at_bound(const PoseChanges& changes) {
  std::string out;
  if (const int frames = changes.frames_at_bound(); frames > 0)
    out = std::to_string(frames) + " of " + std::to_string(changes.frames.size()) + " frames";
  for (const CameraChange& camera : changes.cameras)
    if (camera.pose.at_bound) out += (out.empty() ? "" : ", ") + camera.name;
  return out;
}

}  // namespace redrive
