// SPDX-License-Identifier: Apache-2.0
// Applies changes to the moving objects of a scene, and selects some of them.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/traffic_edit.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Changes scene->actors. InputError naming the edit's file and field where the scene has no such
/// object, a copy's id is taken, or a time is beyond the drive's end. Returns remarks: pairs of
/// objects whose boxes overlap then and did not before.
std::vector<std::string> edit_actors(const TrafficEdit& edit, Scene* scene);

/// Keeps the objects of --actors: all, none, or ids "3,17". UsageError where the scene has no such
/// object; it lists those that there are.
void select_actors(std::string_view chosen, Scene* scene);

}  // namespace redrive
