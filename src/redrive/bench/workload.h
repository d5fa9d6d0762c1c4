// SPDX-License-Identifier: Apache-2.0
// The drive of the benchmarks.
#pragma once

#include "redrive/model/benchmark.h"

namespace redrive::bench {

SyntheticDrive make_synthetic_drive();

/// Adds cars of 4 x 2 x 1.5 m that drive ahead in four lanes, 3 to 100 m before the first camera.
void add_actors(int n, SyntheticDrive* drive);

}  // namespace redrive::bench
