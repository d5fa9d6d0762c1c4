// SPDX-License-Identifier: Apache-2.0
// Poses, times and intrinsics of PandaSet, and the rig that follows from them: each image has a
// pose of its own, and the car's poses stand beside its scans.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/recording.h"

namespace redrive::pandaset {

/// Poses of poses.json by frame, world from sensor: a list of {"position": {x, y, z}, "heading":
/// {w, x, y, z}}. A pose that cannot be is nothing, and a record of `damaged`.
std::vector<std::optional<Rigid3d>> parse_poses(std::string_view text,
                                                const std::filesystem::path& file,
                                                const DamagedList* damaged);
/// Times of a sensor by frame, on the clock of the points.
using Times = std::vector<std::optional<std::int64_t>>;
/// Times of timestamps.json by frame: a list of seconds, each later than the one before. One that
/// cannot be is nothing, and a record of `damaged`.
Times parse_times(std::string_view text, const std::filesystem::path& file,
                  const DamagedList* damaged);
/// Reads fx, fy, cx and cy of intrinsics.json; the principal point must lie near the image.
void parse_intrinsics(std::string_view text, const std::filesystem::path& file,
                      CameraCalibration* camera);

/// Poses of a sensor with their times, by frame; frames without one of both are left out.
std::vector<FramePose> posed_times(const std::vector<std::optional<Rigid3d>>& poses,
                                   const Times& times_ns);

/// Returns world_from_body of a pose of lidar/poses.json. These are the car's at the ends of the
/// scans: y forward, x right, z up, the origin in the middle of the rear axle.
Rigid3d body_of_car(const Rigid3d& world_from_car);

/// Names of the cameras.
std::vector<std::string> camera_names();
/// Pose of the Pandar64 in a camera as the devkit publishes it; nothing for unknown cameras.
std::optional<Rigid3d> camera_from_lidar(const std::string& camera);
/// Pose of the PandarGT in the Pandar64 as the devkit publishes it, both with x forward.
Rigid3d pandar64_from_gt();
/// Body from the Pandar64 as measured in sequence 001, for excerpts without poses of the car.
Rigid3d usual_body_from_lidar();

/// Returns body_from_camera as the median over all images, which have poses and times of their own.
/// Images that are more than 0.3 m or 2 degrees away from it are records of `damaged`. Needs two
/// poses of the body and one of the camera.
Rigid3d body_from_camera(const std::vector<FramePose>& body, const std::vector<FramePose>& camera,
                         const std::filesystem::path& file, const DamagedList& damaged);

}  // namespace redrive::pandaset
