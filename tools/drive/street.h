// SPDX-License-Identifier: Apache-2.0
// What stands along the road: kerbs, houses, trees, parked cars, lamps, signs and small things,
// each a function of the seed and its own lot of the road, so that the street has no end and does
// not repeat.
#pragma once

#include <vector>

#include "tools/drive/caster.h"
#include "tools/drive/road.h"

namespace redrive::drive {

/// All of them from the road's first metre to its last one.
std::vector<Primitive> furnish(const Road& road, unsigned seed);

}  // namespace redrive::drive
