// SPDX-License-Identifier: Apache-2.0
// The drive of the benchmarks.
#pragma once

#include "redrive/model/benchmark.h"

namespace redrive::bench {

SyntheticDrive make_synthetic_drive();

/// Returns the drive with a camera of 153 degrees, whose image shows all that is far in some tiles:
/// thousands of Gaussians in a tile, as fisheyes have at the horizon.
SyntheticDrive wide_angle(SyntheticDrive drive);

/// Adds cars of 4 x 2 x 1.5 m that drive ahead in four lanes, 3 to 100 m before the first camera.
void add_actors(int n, SyntheticDrive* drive);

}  // namespace redrive::bench
