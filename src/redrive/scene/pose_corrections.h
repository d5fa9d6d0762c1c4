// SPDX-License-Identifier: Apache-2.0
// Small corrections of recorded poses: the body's at each frame, each camera's extrinsics and time
// offset. Training refines them (train/poses/pose_refiner.h), a checkpoint holds them, and a scene
// applies them whenever it is asked for a pose (Scene::correct).
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive {

struct Scene;

/// The poses that a scene is asked for: with its corrections, or as they were recorded.
enum class Poses { kCorrected, kRecorded };

struct PoseCorrections {
  int frames = 0, cameras = 0;  ///< numbers of frames and cameras of the scene
  /// [frames, 6] in the body's axes, [cameras, 6] in the camera's, each a translation (m) and a
  /// rotation vector (rad), then [cameras] seconds by which images are exposed later. Empty: no
  /// corrections.
  std::vector<float> values;

  PoseCorrections() = default;
  explicit PoseCorrections(const Scene& scene);

  std::size_t size() const {
    return 6 * static_cast<std::size_t>(frames + cameras) + static_cast<std::size_t>(cameras);
  }
  std::size_t frame_slot(int frame) const { return 6 * static_cast<std::size_t>(frame); }
  std::size_t camera_slot(int camera) const { return frame_slot(frames + camera); }
  std::size_t time_slot(int camera) const {
    return frame_slot(frames + cameras) + static_cast<std::size_t>(camera);
  }
};

/// The motion of a Vector6d (math/so3.h) in single precision.
Rigid3d rigid_from_vector(const float* six);

/// The interval that contains a time among n ascending ones, and the fraction `part` in it, below 0
/// and above 1 at the ends as in recording/core/trajectory.h. With a single time, both ends are
/// that one.
struct Between {
  std::size_t before = 0;
  double part = 0;

  Between clamped() const { return {before, std::clamp(part, 0.0, 1.0)}; }
};
template <class TimeOf>
Between find_interval(std::size_t n, std::int64_t t_ns, const TimeOf& time_of) {
  if (n == 1) return {};
  std::size_t after = 1, end = n - 1;  // the first one later than t_ns, or the last one
  while (after < end) {
    const std::size_t middle = (after + end) / 2;
    if (time_of(middle) <= t_ns)
      after = middle + 1;
    else
      end = middle;
  }
  const std::int64_t a = time_of(after - 1), b = time_of(after);
  return {after - 1, static_cast<double>(t_ns - a) / static_cast<double>(b - a)};
}
/// Interpolates six numbers; with part = 0 reads only `a`.
std::array<float, 6> interpolate_vector6(const float* a, const float* b, double part);

}  // namespace redrive
