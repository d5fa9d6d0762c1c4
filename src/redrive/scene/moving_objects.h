// SPDX-License-Identifier: Apache-2.0
// Annotated objects that move, in the world: what a static scene has to leave out of pictures and
// LiDAR.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/recording/recording_reader.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Where an object is at one instant; grown by kBoxMargin_m on every side.
struct MovingBox {
  Rigid3d box_from_world;
  Eigen::Vector3d half_size_m;

  bool contains(const Eigen::Vector3d& in_world) const {
    return ((box_from_world * in_world).cwiseAbs().array() <= half_size_m.array()).all();
  }
  /// Whether the half-line from `origin` along `direction` meets the box (slab test); both in the
  /// world.
  bool meets(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction) const;
};

/// Mirrors and wheels that stick out, and how well boxes, poses and exposure times are known.
constexpr double kBoxMargin_m = 0.3;

/// An object moves, in all frames, if any of its boxes does at more than this. A box's velocity in
/// the world is its relative velocity plus the ego vehicle's; egomotion with errors of 10 cm over
/// 0.7 s (samples/street) makes up to 0.5 m/s of a parked car, and what is slower than walking pace
/// all the time stays within a box or two of its own length.
constexpr double kMovingSpeed_m_per_s = 1;

class MovingObjects {
 public:
  /// Boxes of all frames. They hold at their own time and go on at their own velocity.
  MovingObjects(const std::vector<Box>& boxes, const std::vector<FramePose>& frames,
                const Rigid3d& global_from_world);

  /// Of each object the box nearest in time, moved to t_ns; none of an object that has no box
  /// within 0.1 s.
  std::vector<MovingBox> at(std::int64_t t_ns) const;

  std::size_t objects() const { return objects_.size(); }
  std::size_t parked() const { return parked_; }  ///< objects that do not move

 private:
  struct Sighting {
    std::int64_t t_ns;
    Rigid3d world_from_box;
    Eigen::Vector3d size_m, velocity_in_world_m_per_s;
  };
  std::vector<std::vector<Sighting>> objects_;  ///< moving ones by id, sightings by time
  std::size_t parked_ = 0;
};

/// Reads all box files. InputError as RecordingReader::read_boxes.
MovingObjects read_moving_objects(const Recording& recording, const Scene& scene);

}  // namespace redrive
