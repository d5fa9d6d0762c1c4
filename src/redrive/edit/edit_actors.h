// SPDX-License-Identifier: Apache-2.0
// Applies changes to the moving objects of a scene, and selects some of them.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "redrive/edit/actor_body.h"
#include "redrive/edit/traffic_edit.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Changes scene->actors. InputError naming the edit's file and field where the scene has no such
/// object, the id of a copy or an added object is taken, or a time is beyond the drive's end; or as
/// read_actor_body. Returns remarks: pairs of objects whose boxes overlap now and did not before,
/// and changed objects that no frame of the drive has. `bodies` keeps the bodies that it reads for
/// the next edit; null: they are not kept.
std::vector<std::string> edit_actors(const TrafficEdit& edit, Scene* scene,
                                     ActorBodies* bodies = nullptr);

/// Throws InputError where an edit adds objects and the model draws none (Field::draws_actors).
void check_added(const TrafficEdit& edit, bool draws_actors);

/// Returns shift_m and turn_deg of a change: box_from_moved_box.
Rigid3d own_motion(const ActorChange& change);

/// Returns the object of an option. UsageError where the scene has no such object; it lists the
/// scene's objects.
const MovingObject& find_actor(const Scene& scene, const char* option, std::int64_t id);

/// Keeps the objects of --actors: all, none, or ids "3,17". UsageError where the scene has no such
/// object; it lists the scene's objects.
void select_actors(std::string_view chosen, Scene* scene);

}  // namespace redrive
