// SPDX-License-Identifier: Apache-2.0
// Poses and calibration of Argoverse 2.
#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/parse/arrow_table.h"

namespace redrive::argoverse2 {

constexpr double kMaxCoordinate_m = 1e7;
constexpr std::int64_t kMaxTime_ns = 9'000'000'000'000'000'000;
constexpr const char* kTimeRule = "nanoseconds, 0 to 9e18";

/// Files of a log.
constexpr const char *kPoses = "city_SE3_egovehicle.feather", *kAnnotations = "annotations.feather",
                     *kExtrinsics = "calibration/egovehicle_SE3_sensor.feather",
                     *kIntrinsics = "calibration/intrinsics.feather";
/// Sensors; kUpLidar and kDownLidar are the two LiDARs.
constexpr const char *kUpLidar = "up_lidar", *kDownLidar = "down_lidar",
                     *kFirstCamera = "ring_front_center";
/// Columns of poses, and of lengths along a box's axes.
constexpr const char* kPoseColumns[] = {"qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"};
constexpr const char* kSizeColumns[] = {"length_m", "width_m", "height_m"};

/// Columns kPoseColumns of a table.
class PoseColumns {
 public:
  PoseColumns(const ArrowTable& table, const std::filesystem::path& file);
  /// InputError: row i is no pose.
  Rigid3d at(std::size_t i) const;

 private:
  std::filesystem::path file_;
  std::vector<double> columns_[7];
};

/// The vehicle's axes, x forward and z up, are the body's; their origin is the middle of the rear
/// axle, 0.33 m above the ground.
Rigid3d body_from_vehicle();

/// Returns the body's poses in the city by time, at least 1 ms apart: rows of sensors that fire
/// together are nanoseconds apart. Rows that are no poses go to `damaged`. InputError without any.
std::vector<FramePose> parse_poses(std::string_view feather, const std::filesystem::path& file,
                                   const DamagedList* damaged);

/// Returns body_from_sensor by the sensor's name. InputError: a row is no pose, two of one name.
std::map<std::string, Rigid3d> parse_extrinsics(std::string_view feather,
                                                const std::filesystem::path& file);

/// Returns the cameras by name, without extrinsics. Images are rectified already, so the columns
/// k1, k2 and k3 do not apply. InputError: a camera that cannot be, two of one name.
std::map<std::string, CameraCalibration> parse_intrinsics(std::string_view feather,
                                                          const std::filesystem::path& file);

}  // namespace redrive::argoverse2
