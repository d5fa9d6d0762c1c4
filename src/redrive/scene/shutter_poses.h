// SPDX-License-Identifier: Apache-2.0
// The pose of a camera during an exposure: one for all pixels, or, with a rolling shutter, one per
// row or column.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/math/shutter_row.h"
#include "redrive/scene/key_time.h"

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
    std::vector<KeyTime> key_times;  ///< time of each of these among the keys of its track
    std::shared_ptr<const ActorBody> imported = nullptr;  ///< MovingObject::imported
    int number = 0;  ///< 1 + index into the objects of seen_actors
  };

  /// Number of keys of a rolling shutter: rows of a readout of 30 ms have one every 4 ms.
  static constexpr int kKeys = 9;

  ShutterPoses(const Rigid3d& pose) : keys_{plain(pose)} {}  // NOLINT: most images have one pose
  /// `keys`: at evenly spaced times from the upper edge of the image to the lower one, or, by
  /// column, from the left one to the right one; at least one.
  explicit ShutterPoses(const std::vector<Rigid3d>& keys, bool by_column = false);

  bool is_rolling() const { return keys_.size() > 1; }
  bool by_column() const { return by_column_; }
  const std::vector<PlainPose>& keys() const { return keys_; }
  /// The objects that exist during the exposure (Scene::with_actors); none unless set.
  const std::vector<Actor>& actors() const { return actors_; }
  void set_actors(std::vector<Actor> actors) { actors_ = std::move(actors); }
  /// `line`: 0 at the first edge, 1 at the last one (pose_at_row).
  Rigid3d at(double line) const { return rigid(pose_at_row(keys_.data(), keys_.size(), line)); }
  /// Returns the pose of a pixel, whole numbers at its centre, in an image of this size.
  Rigid3d at_pixel(double u, double v, int width, int height) const {
    return at(line_fraction(by_column_, u, v, width, height));
  }

 private:
  std::vector<PlainPose> keys_;
  bool by_column_ = false;
  std::vector<Actor> actors_;
};

/// The poses of all pixels of an image.
class PixelPoses {
 public:
  PixelPoses(const ShutterPoses& poses, int width, int height);

  const Rigid3d& of(std::size_t pixel) const {
    return by_column_ ? lines_[pixel % width_] : lines_[pixel / width_];
  }

 private:
  std::size_t width_;
  bool by_column_;
  std::vector<Rigid3d> lines_;
};

/// Returns the objects that exist at all of these times, at which the sensor has these poses.
std::vector<ShutterPoses::Actor> seen_actors(const std::vector<MovingObject>& actors,
                                             std::span<const PlainPose> world_from_sensor,
                                             std::span<const std::int64_t> t_ns);

}  // namespace redrive
