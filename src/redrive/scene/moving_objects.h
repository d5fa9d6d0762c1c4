// SPDX-License-Identifier: Apache-2.0
// Annotated moving objects in the world. Methods that do not draw them mask them in images; static
// LiDAR returns are the returns outside their boxes.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include "redrive/recording/formats/recording_reader.h"
#include "redrive/scene/moving_object.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// The box of a moving object at one time, grown by kBoxMargin_m on every side.
struct MovingBox {
  std::int64_t id = 0;  ///< MovingObject::id
  Rigid3d box_from_world;
  Eigen::Vector3d half_size_m;

  bool contains(const Eigen::Vector3d& in_world) const {
    return ((box_from_world * in_world).cwiseAbs().array() <= half_size_m.array()).all();
  }
  /// Returns where the ray from `origin` along `direction`, both in the world, enters the box (slab
  /// test), in lengths of `direction`: 0 if it begins inside; nothing if it does not before `most`.
  std::optional<double> entry(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                              double most = std::numeric_limits<double>::infinity()) const;
  /// Whether the ray intersects the box before origin + most * direction.
  bool intersects(const Eigen::Vector3d& origin, const Eigen::Vector3d& direction,
                  double most = std::numeric_limits<double>::infinity()) const {
    return entry(origin, direction, most).has_value();
  }
};

/// Covers protruding mirrors and wheels, and errors of boxes, poses and exposure times.
constexpr double kBoxMargin_m = 0.3;

/// An object counts as moving, in all frames, if its kind always does or any of its boxes is faster
/// than this. A box's velocity in the world is its relative velocity plus the ego vehicle's:
/// egomotion errors of 10 cm over 0.7 s (samples/street) give a parked car up to 0.5 m/s, and an
/// object slower than walking pace moves by only a few of its own lengths.
constexpr double kMovingSpeed_m_per_s = 1;

class MovingObjects {
 public:
  MovingObjects() = default;  ///< none

  /// `boxes`: boxes of all frames. Each holds at its own time.
  MovingObjects(const std::vector<Box>& boxes, const std::vector<FramePose>& frames,
                const Rigid3d& global_from_world);

  /// `objects`: all of them move.
  explicit MovingObjects(std::vector<MovingObject> objects) : objects_(std::move(objects)) {}

  /// Returns the box of each object that has a pose at t_ns.
  std::vector<MovingBox> at(std::int64_t t_ns) const;

  const std::vector<MovingObject>& objects() const& { return objects_; }  ///< ascending by id
  /// Returns all but these.
  MovingObjects without(const std::vector<MovingObject>& others) const;
  /// Returns these and `others`, which move, too.
  MovingObjects with(const std::vector<MovingObject>& others) const;
  const std::vector<MovingObject>& parked() const { return parked_; }  ///< objects that do not move

 private:
  std::vector<MovingObject> objects_;
  std::vector<MovingObject> parked_;
};

/// Reads all box files. InputError as RecordingReader::read_boxes.
MovingObjects read_moving_objects(const Recording& recording, const Scene& scene);

}  // namespace redrive
