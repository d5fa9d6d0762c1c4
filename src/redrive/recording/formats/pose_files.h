// SPDX-License-Identifier: Apache-2.0
// Poses and calibration stored apart from their recording: a folder that redrive align writes and
// --poses reads, with files in the recording's format (recording/formats/recording_reader.h).
#pragma once

#include <filesystem>

#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {

/// Pose files of `recording`'s format. InputError: one of them is missing or cannot be read.
PoseFiles read_pose_files(const Recording& recording, const std::filesystem::path& folder);
/// Creates folders where they are missing. IoError.
void write_pose_files(const std::filesystem::path& folder, const PoseFiles& files);

/// Replaces the recording's poses and calibration. Leaves out frames that the files lack, as after
/// align --frames, and frames whose pose or time cannot be or whose time is not the recording's;
/// findings count them. InputError (`folder` is for messages): a file that cannot be parsed, that
/// lacks all frames or a camera with images; more damaged poses among `frames` than the recording
/// allows; a recording of photographs.
void apply_pose_files(const PoseFiles& files, const std::filesystem::path& folder,
                      Recording* recording, const FrameRange& frames = {});

}  // namespace redrive
