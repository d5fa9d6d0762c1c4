// SPDX-License-Identifier: Apache-2.0
// Finds objects that move and that nobody annotated, in the LiDAR returns of a drive. Three things
// together make one:
//   1. Returns in places through which rays of other times passed far beyond, and where hardly any
//      of them ended. Thin things and surfaces along the rays let rays pass, too, but stop others.
//   2. Such returns lie together above the ground.
//   3. What they form moves steadily for some tenths of a second, by more than a metre.
// An object that is missed blurs the world; a wall that is taken for one leaves a hole in it. So
// all three are strict.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/moving_object.h"

namespace redrive {

/// Returns objects with the ids -1, -2, ... and the type "FOUND". Their boxes stand on the ground,
/// enclose the returns on them, and extend away from the sensor to the object's usual size; their
/// tracks are smooth. The result does not depend on threads. `returns`: of revolutions, in the
/// world, whose z axis points up, without those on `annotated` objects; what is left of these is no
/// object.
std::vector<MovingObject> find_moving_objects(const LidarReturns& returns,
                                              const MovingObjects& annotated, ThreadPool& pool);

/// Adds objects that were found in a later part of a drive to the objects of the parts before, with
/// ids below theirs. One that is at the place of another at most of their common times is that one:
/// its boxes go on with the later track.
void join_found(std::vector<MovingObject> later, std::vector<MovingObject>* objects);

/// Returns the objects of the type "FOUND".
std::vector<MovingObject> found_objects(const MovingObjects& moving);

}  // namespace redrive
