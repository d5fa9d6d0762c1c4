// SPDX-License-Identifier: Apache-2.0
// Poses and calibration apart from the recording they belong to: what redrive align writes and
// --poses reads. A folder with the two files at the places they have in a recording of the aiMotive
// layout (recording/aimotive.h), in its formats.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "redrive/recording/recording.h"

namespace redrive {

/// The text of the two files.
struct PoseFiles {
  std::string egomotion;    ///< sensor/gnssins/egomotion2.json
  std::string calibration;  ///< sensor/calibration/calibration.json
};

/// InputError: one of them is missing or cannot be read.
PoseFiles read_pose_files(const std::filesystem::path& folder);
/// IoError. The folder and what is in between are made where they are missing.
void write_pose_files(const std::filesystem::path& folder, const PoseFiles& files);

/// Frames and cameras as files. The calibration is that of `recording` with these cameras' lenses,
/// mounts, time offsets and readouts; other sensors stay as they are, and so does what else stands
/// there, but for angles that the new mount belies (yaw_pitch_roll_deg).
PoseFiles make_pose_files(const Recording& recording, const std::vector<FramePose>& frames,
                          const std::vector<CameraCalibration>& cameras);

/// Puts them in the place of the recording's own. InputError (`folder` is for messages): a file
/// that cannot be parsed, that lacks a frame or a camera with images, or whose times are not the
/// recording's; a recording that is no drive.
void apply_pose_files(const PoseFiles& files, const std::filesystem::path& folder,
                      Recording* recording);

}  // namespace redrive
