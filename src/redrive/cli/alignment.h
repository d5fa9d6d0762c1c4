// SPDX-License-Identifier: Apache-2.0
// What align and train --align share.
#pragma once

#include <filesystem>

#include "redrive/align/align.h"

namespace redrive {

/// Aligns, with a line on standard output for each round, and says what was found.
AlignResult align_verbose(const Recording& recording, AlignOptions options, ThreadPool& pool);

/// Poses, calibration and report.html. `recording`: with its own poses.
void write_alignment(const std::filesystem::path& folder, const Recording& recording,
                     const AlignResult& result);

}  // namespace redrive
