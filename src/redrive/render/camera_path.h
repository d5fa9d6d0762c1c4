// SPDX-License-Identifier: Apache-2.0
// Paths of a camera through a run: keys, and smooth motion through them.
#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/edit/camera_path_file.h"
#include "redrive/scene/scene.h"

namespace redrive {

struct PathKey {
  double t_s = 0;
  Rigid3d world_from_camera = Rigid3d::Identity();
  double fov_deg = 0;  ///< vertical; 0: the lens is given
  double drive_s = 0;  ///< time after the drive's first frame, at which moving objects are shown
};

/// Returns the time on the drive at a key.
inline std::int64_t drive_time_ns(const PathKey& key, const Scene& scene) {
  return scene.frames.front().t_ns + std::llround(1e9 * key.drive_s);
}

struct CameraPath {
  std::vector<PathKey> keys;  ///< at least one; times increase
  double fps = 24;            ///< images a second
  double seconds = 0;         ///< duration; the keys' times are scaled to it
  std::string camera;  ///< camera of the run, whose lens and exposure the images have; may be empty
  /// lens of a path without such a camera, for a field of view of 90 deg
  std::optional<Camera> lens;

  /// Number of images: round(seconds * fps), at least 1. They are spread evenly from the first key
  /// to the last.
  int images() const;
  /// Returns the key of an image, 0..images() - 1.
  PathKey at_image(int index) const;
};

/// Interpolates at time t_s, clamped to the keys' times. Positions follow a cubic Hermite curve
/// whose velocity at a key is the velocity of the parabola through it and its neighbours
/// (Overhauser; with even times Catmull-Rom), at the ends of the parabola through the next two.
/// Rotations follow the same curve of rotation vectors (Kim, Kim, Shin, SIGGRAPH 1995: cumulative
/// Bezier basis). So velocities are continuous, and motions of constant acceleration are reproduced
/// exactly. The field of view is linear.
PathKey interpolate_path(const std::vector<PathKey>& keys, double t_s);

/// Returns `lens` with another vertical field of view, (height / 2) / tan(fov / 2) as its f.
Camera with_fov(Camera lens, double fov_deg);
/// Returns the vertical field of view, in degrees, 1..179, of a pinhole with the lens' focal
/// length.
double fov_of(const Camera& lens);

/// Returns the path of a camera on the drive, `left_m` to the left in body axes, with a key at each
/// frame of the scene and the drive's own times.
CameraPath drive_path(const Scene& scene, const RigCamera& camera, double left_m);

/// Returns the path in a file. InputError where the run has no such camera or frame.
CameraPath path_of_file(const CameraPathFile& file, const Scene& scene);

/// Returns the pose of a keyframe, placed as `redrive render` does. InputError naming `file` and
/// keyframes[index].
PathKey path_key(const PathKeyframe& keyframe, const Scene& scene,
                 const std::filesystem::path& file, std::size_t index);

/// Returns one exposure for the whole path, so that nothing flickers: the exposure of `camera`, an
/// index in the rig, at the scene's frame nearest to the middle of the path.
Exposure path_exposure(const CameraPath& path, const Scene& scene, int camera);

}  // namespace redrive
