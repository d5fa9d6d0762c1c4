// SPDX-License-Identifier: Apache-2.0
// A recording without its files as JSON, for runs that move to a machine without it: rig, poses,
// which images there were, and boxes. Every number comes back bit for bit.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "redrive/base/json_field.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// Reads the recording's boxes. InputError as RecordingReader::read_boxes.
std::string recording_to_json(const Recording& recording);

/// Returns a recording whose images and scans cannot be read. InputError for a damaged file.
Recording read_recording_json(const std::filesystem::path& file);
/// Likewise from the text of a file.
Recording parse_recording_json(std::string_view text, const std::filesystem::path& file);

/// Reads BlindDirections::runs(). InputError naming the field.
BlindDirections blind_from_json(const JsonField& runs);

}  // namespace redrive
