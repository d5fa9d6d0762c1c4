// SPDX-License-Identifier: Apache-2.0
// A run's whole drive rendered anew: along another path, with other traffic, with labels.
#pragma once

#include <atomic>
#include <filesystem>
#include <string>

#include "redrive/export/drive.h"
#include "redrive/render/lidar_request.h"
#include "redrive/render/run_renderer.h"

namespace redrive {

/// Returns the scene with these cameras in place of its own, each with an image of every frame.
/// Throws as make_rig_camera.
Scene scene_with_rig(Scene scene, const std::vector<CameraCalibration>& cameras);
/// Returns the boxes of a frame in the axes of the body then: the scene's actors and those objects
/// of `moving` that are parked, ascending by id. `moving`: the run's.
std::vector<Box> boxes_at(const Scene& scene, const MovingObjects& moving, const Frame& frame);

struct SimulateOptions {
  const DriveFormat* format = nullptr;  ///< layout that the drive will have
  std::string path = "drive";
  /// Cameras of the scene (scene_with_rig), which have no exposures; empty: the run's.
  std::vector<CameraCalibration> rig;
  LidarOptions lidar;
  bool with_lidar = true;  ///< where the recording or the options have one
  bool labels = true, flow = true, guesses = false;
};

/// How long which part took, seconds; what was left from an earlier call does not count.
struct SimulateTimes {
  std::size_t images = 0, scans = 0, kept = 0;  ///< kept: images from an earlier call
  double images_s = 0, labels_s = 0, files_s = 0, scans_s = 0;
};

/// Renders images with labels and LiDAR scans of `scene`, whose path and traffic are final, into
/// `folder`, and returns them as a recording. Cameras for which the format has no place are left
/// out, with notes; labels are of the images as the format has them. Files of an earlier call with
/// the same arguments, which may have been killed, are kept; `folder` may be deleted once the
/// recording is written. Images have the recorded size.
///
///   images/CAM/ID.png   labels/...                               the recording's files
///   labels/ids/CAM/ID.png     16 bit: 1 + index into labels/poses.json's "objects"; 0: static
///   labels/depth/CAM/ID.png   16 bit: millimetres along the ray, 65535: 65.535 m and more
///   labels/flow/CAM/ID.flo    pixels until the camera's next image; the last one has none
///   labels/guesses/CAM/ID.png white: no training image saw the surface
///   labels/instances.json     COCO (export/labels.h)
///   labels/poses.json         poses of cameras and objects at each image
///   labels/images/CAM/ID.png  the images again, as the labels see them
///
/// Interrupted once `stop` is set. InputError, UsageError, IoError.
Recording simulate(RunRenderer& renderer, const Scene& scene, const SimulateOptions& options,
                   const std::filesystem::path& folder, const std::atomic<bool>& stop,
                   SimulateTimes* times, DriveNotes* notes);

}  // namespace redrive
