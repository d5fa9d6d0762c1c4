// SPDX-License-Identifier: Apache-2.0
// Alignment with printed progress, for align and train --align.
#pragma once

#include <filesystem>

#include "redrive/align/align.h"

namespace redrive {

/// Aligns, and prints a line for each round and a summary. Throws what align throws.
AlignResult align_verbose(const Recording& recording, AlignOptions options, ThreadPool& pool);

/// Writes poses, calibration and report.html. `recording`: with its initial poses. Throws IoError.
void write_alignment(const std::filesystem::path& folder, const Recording& recording,
                     const AlignResult& result);

}  // namespace redrive
