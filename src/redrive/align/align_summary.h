// SPDX-License-Identifier: Apache-2.0
// Figures of an alignment.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "redrive/align/align.h"

namespace redrive {

/// Standard deviation of the trajectory's shape at its worst frame.
struct ShapeSigma {
  double translation_m = 0, rotation_deg = 0;
};
ShapeSigma worst_sigma(const AlignResult& result);

/// Returns what `redrive align` prints, by camera and for the whole drive. A standard deviation is
/// null where the drive does not determine the number.
nlohmann::json alignment_to_json(const AlignResult& result);

}  // namespace redrive
