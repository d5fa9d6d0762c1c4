// SPDX-License-Identifier: Apache-2.0
// Alignment with printed progress, for align and train --align.
#pragma once

#include <filesystem>

#include "redrive/align/align.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {

/// Aligns, and prints a line for each round and a summary. Throws what align throws.
AlignResult align_verbose(const Recording& recording, AlignOptions options, ThreadPool& pool);

/// Returns the aligned poses and calibration as files of the recording's format.
PoseFiles aligned_pose_files(const Recording& recording, const AlignResult& result);
/// Writes poses, calibration and report.html. `recording`: with its initial poses. Throws IoError.
void write_alignment(const std::filesystem::path& folder, const Recording& recording,
                     const AlignResult& result);

}  // namespace redrive
