// SPDX-License-Identifier: Apache-2.0
// The report of redrive align.
#pragma once

#include <filesystem>

#include "redrive/align/align.h"

namespace redrive {

/// Writes folder/report.html with its figures inside, and folder/figures with the same figures and
/// their gnuplot scripts: corrections over time with their uncertainty, the trajectory from above,
/// reprojection errors by frame and as points. IoError where gnuplot is missing.
void write_align_page(const std::filesystem::path& folder, const Recording& recording,
                      const AlignResult& result);

}  // namespace redrive
