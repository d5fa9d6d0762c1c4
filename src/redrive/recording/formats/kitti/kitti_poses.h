// SPDX-License-Identifier: Apache-2.0
// Times and poses of KITTI. Raw drives: timestamps.txt of each sensor and a packet of the GPS and
// IMU (OXTS RT 3003) for each frame, oxts/data/<id>.txt. Sequences of the odometry benchmark:
// times.txt and poses/<sequence>.txt. Line n belongs to frame n - 1.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string_view>
#include <vector>

#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/recording.h"

namespace redrive::kitti {

/// Returns nanoseconds for each line, from "2011-09-26 13:10:51.175862102": since 1970 as if in
/// UTC, since the files name no zone. Nothing for an empty line: the sensor missed that frame.
/// InputError: no line. No such date or time, and times that do not increase: nothing, and a record
/// of `damaged`; without it they are errors.
std::vector<std::optional<std::int64_t>> parse_timestamps(std::string_view text,
                                                          const std::filesystem::path& file,
                                                          const DamagedList* damaged = nullptr);

/// Returns ECEF from IMU (x forward, y left, z up) from the first six of the 30 numbers: latitude
/// and longitude in degrees, altitude, and roll, pitch, yaw in radians. Yaw is 0 to the east and
/// counts counterclockwise; ENU from IMU is Rz(yaw) Ry(pitch) Rx(roll). InputError: another number
/// of values, values that are not finite or out of range.
Rigid3d parse_oxts(std::string_view text, const std::filesystem::path& file);

// The same for files with a line for each frame: nothing for a line that goes to `damaged`.

/// parse_oxts for each line of a sequence's file in the tracking benchmark.
std::vector<std::optional<Rigid3d>> parse_oxts_lines(std::string_view text,
                                                     const std::filesystem::path& file,
                                                     const DamagedList* damaged = nullptr);

/// Returns nanoseconds for each line, from seconds. InputError: no line, times that are no numbers
/// or do not increase.
std::vector<std::optional<std::int64_t>> parse_times(std::string_view text,
                                                     const std::filesystem::path& file,
                                                     const DamagedList* damaged = nullptr);

/// Returns, for each line, first rectified camera 0 from the frame's: 12 numbers, the rows of a 3 x
/// 4 matrix. InputError: no line, other numbers of values, no rigid transform, further than 1e7 m.
std::vector<std::optional<Rigid3d>> parse_poses(std::string_view text,
                                                const std::filesystem::path& file,
                                                const DamagedList* damaged = nullptr);

/// Parses lines of a frame's number and its pose, the rows of a 3 x 4 matrix, or of a 4 x 4 one
/// whose last row is not read: poses.txt and cam0_to_world.txt of KITTI-360. Times are 0.
/// InputError as parse_poses, and frames that do not increase.
std::vector<FramePose> parse_frame_poses(std::string_view text, const std::filesystem::path& file,
                                         const DamagedList* damaged = nullptr);

}  // namespace redrive::kitti
