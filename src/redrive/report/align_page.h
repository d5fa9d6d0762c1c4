// SPDX-License-Identifier: Apache-2.0
// What redrive align did, as a page to look at.
#pragma once

#include <filesystem>

#include "redrive/align/align.h"

namespace redrive {

/// folder/report.html with the figures inside, and folder/figures with them and their gnuplot
/// scripts: corrections over time with their uncertainty, the trajectory from above, reprojection
/// errors by frame and as points. IoError where gnuplot is missing.
void write_align_page(const std::filesystem::path& folder, const Recording& recording,
                      const AlignResult& result);

}  // namespace redrive
