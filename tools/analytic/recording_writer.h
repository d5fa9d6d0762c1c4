// SPDX-License-Identifier: Apache-2.0
// Writes the recording of a four-camera car that drives through the courtyard, in the aiMotive
// layout.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/camera/camera.h"
#include "redrive/image/image.h"
#include "tools/analytic/analytic_scene.h"

namespace redrive::analytic {

struct DriveOptions {
  unsigned seed = 1;
  int frames = 24;  ///< at 15 Hz
  std::int64_t first_id = 1200;
};

/// The rig: two pinhole cameras with OpenCV distortion (front, rear), two Mei fisheyes (left,
/// right).
std::vector<CameraCalibration> rig_calibration();

/// Body pose at frame `index`: 5 m/s along a gentle left-right curve, first frame at the origin.
/// World as analytic_scene.h.
Rigid3d world_from_body(int index);

/// The invented location: 47.5 N, 19.0 E, 150 m (WGS84), world x towards heading 35
/// degrees.
Rigid3d global_from_world();

struct CapturedImage {
  Image8 image;
  std::vector<std::uint16_t>
      depth_mm;  ///< [height, width] along the ray, 0 for the sky and unseen pixels
};

/// Mean of 4x4 rays a pixel; depth of the pixel's centre. Pixels outside the camera's valid region
/// are black.
CapturedImage capture_image(const Courtyard& scene, const Camera& camera,
                            const Rigid3d& world_from_camera, ThreadPool& pool);

/// Writes the recording below `root`, which must not exist, with novel/<name>: poses, ground truth
/// and depth.
void write_recording(const std::filesystem::path& root, const DriveOptions& options,
                     ThreadPool& pool);

}  // namespace redrive::analytic
