// SPDX-License-Identifier: Apache-2.0
// Photographs whose poses lie far from all others: images that a reconstruction could not place.
#pragma once

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Drops photographs that are more than 20 times as far from the middle of all as half of them are,
/// and more than 5 times that from every other one, with a finding that names them; bounds of the
/// scene then follow the others. Keeps all where that would be more than one and more than a
/// twentieth of them, and where there are not ten others.
void leave_out_far_photographs(Recording* recording);

}  // namespace redrive
