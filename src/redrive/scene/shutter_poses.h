// SPDX-License-Identifier: Apache-2.0
// The pose of a camera during an exposure: one for all rows, or, with a rolling shutter, one per
// row.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/math/shutter_row.h"

namespace redrive {

struct ActorBody;
struct MovingObject;

class ShutterPoses {
 public:
  /// Poses of the camera in the axes of a moving object, at the times of the keys.
  struct Actor {
    std::int64_t body = 0;               ///< MovingObject::id of the Gaussians
    std::array<float, 3> gain{1, 1, 1};  ///< factors of r, g, b
    std::vector<PlainPose> actor_from_camera;
    std::shared_ptr<const ActorBody> imported = nullptr;  ///< MovingObject::imported
    int number = 0;  ///< 1 + index into the objects of seen_actors
  };

  /// Number of keys of a rolling shutter: rows of a readout of 30 ms have one every 4 ms.
  static constexpr int kKeys = 9;

  ShutterPoses(const Rigid3d& pose) : keys_{plain(pose)} {}  // NOLINT: most images have one pose
  /// `keys`: at evenly spaced times from the upper edge of the image to the lower one; at least
  /// one.
  explicit ShutterPoses(const std::vector<Rigid3d>& keys);

  bool is_rolling() const { return keys_.size() > 1; }
  const std::vector<PlainPose>& keys() const { return keys_; }
  /// The objects that exist during the exposure (Scene::with_actors); none unless set.
  const std::vector<Actor>& actors() const { return actors_; }
  void set_actors(std::vector<Actor> actors) { actors_ = std::move(actors); }
  /// `row`: 0 at the upper edge, 1 at the lower one (pose_at_row).
  Rigid3d at(double row) const { return rigid(pose_at_row(keys_.data(), keys_.size(), row)); }
  /// Returns the pose at the middle of row y.
  Rigid3d at_row(int y, int height) const { return at(row_fraction(y, height)); }

 private:
  std::vector<PlainPose> keys_;
  std::vector<Actor> actors_;
};

/// Returns the objects that exist at all of these times, at which the sensor has these poses.
std::vector<ShutterPoses::Actor> seen_actors(const std::vector<MovingObject>& actors,
                                             std::span<const PlainPose> world_from_sensor,
                                             std::span<const std::int64_t> t_ns);

}  // namespace redrive
