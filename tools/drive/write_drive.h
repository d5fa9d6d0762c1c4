// SPDX-License-Identifier: Apache-2.0
// Writes a made drive in the aiMotive layout (redrive/recording/formats/aimotive/aimotive.h), with
// its ground truth: calibration_true.json and egomotion2_true.json, and images of shifted cameras
// below novel/.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/camera/calibration.h"
#include "tools/drive/motion.h"
#include "tools/drive/world.h"

namespace redrive::drive {

struct DriveOptions {
  unsigned seed = 1;
  double length_m = 100;
  double spacing_m = 1;  ///< between frames, which are 0.1 s apart
  int cameras = 2;       ///< 2: front pinholes; 4: and Mei fisheyes to both sides
  double size = 1;       ///< factor on the images' sides, which are 640 x 352
  double loop_m = 0;     ///< length of a road that meets itself, a multiple of 3; 0: it never does
  double drift = 0;      ///< drift of the egomotion: part of the way that it errs by after 400 m
  double exposure = 0;   ///< RMS of the images' exposure about its mean, stops
  int lidar_beams = 16;  ///< 0: no LiDAR
  double lidar_noise_m = 0.02;
  int novel_every = 10;  ///< frames between those that have shifted views; 0: none

  int frames() const;
};

/// The rig without errors, of images `size` times as large.
std::vector<CameraCalibration> true_rig(const DriveOptions& options);
/// What calibration.json says: a yaw that is 0.15 degrees off, and no time offset.
std::vector<CameraCalibration> recorded_rig(const DriveOptions& options);
/// The LiDAR's axes in the body's: its place, without rotation.
Rigid3d body_from_lidar();

/// The world that the drive sees, and the way through it.
World make_world(const DriveOptions& options);
double time_s(int frame);         ///< since the first frame
std::int64_t time_ns(int frame);  ///< time on the recording's clock
std::int64_t frame_id(int frame);

/// Sets of shifted views: name and shift in body axes.
struct NovelShift {
  const char* name;
  Eigen::Vector3d shift_body_m;
};
const std::vector<NovelShift>& novel_shifts();

/// Writes the recording into `folder`, which exists. IoError.
void write_drive(const std::filesystem::path& folder, const DriveOptions& options,
                 ThreadPool& pool);

}  // namespace redrive::drive
