// SPDX-License-Identifier: Apache-2.0
// Finds moving objects that nobody annotated, in the LiDAR returns of a drive. Three things
// together make one:
//   1. Returns in places through which rays of other times passed far beyond, and where hardly any
//      of them ended. Thin things and surfaces along the rays let rays pass, too, but stop others.
//   2. Such returns lie together above the ground.
//   3. What they form moves steadily for some tenths of a second, by more than a metre.
// A missed object blurs the world; a wall taken for an object leaves a hole in it. So all three are
// strict.
#pragma once

#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/moving_object.h"

namespace redrive {

/// Returns objects with the ids -1, -2, ... and the type "FOUND". Their boxes stand on the ground,
/// enclose the returns on them, and extend away from the sensor to the object's usual size; their
/// tracks are smooth. The result does not depend on threads. `returns`: returns of the scans of
/// `scene`, whose world's z axis points up, without returns on `annotated` objects; leftovers of
/// these are no object.
std::vector<MovingObject> find_moving_objects(const Scene& scene, const LidarReturns& returns,
                                              const MovingObjects& annotated, ThreadPool& pool);

/// Adds objects that were found in a later part of a drive to the objects of the earlier parts,
/// with ids below theirs. An object at the place of another at most of their common times is the
/// same: its boxes continue with the later track.
void join_found(std::vector<MovingObject> later, std::vector<MovingObject>* objects);

/// Returns the objects of the type "FOUND".
std::vector<MovingObject> found_objects(const MovingObjects& moving);

}  // namespace redrive
