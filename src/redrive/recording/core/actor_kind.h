// SPDX-License-Identifier: Apache-2.0
// What all objects of a kind have in common beyond their boxes: when they count as moving, how they
// move between two boxes, and what a method that draws them starts from. CONTRIBUTING.md says how
// to add one.
#pragma once

#include <span>
#include <string_view>

#include "redrive/math/rigid3.h"

namespace redrive {

struct ActorKind {
  const char* name;
  /// A type in a data set's words, such as "human.pedestrian.adult" or "Person (sitting)", is of
  /// this kind if any of its words is one of these, which are in lower case.
  std::span<const std::string_view> words = {};
  bool always_moves = false;  ///< counts as moving at any speed
  double core = 0;            ///< opaque part of the box's sides; 0: what deforms has none
  bool headlights = false;    ///< lights the road ahead of it by night
  /// Pose of the box at a part (0..1) of the way between two boxes that are not far apart.
  Rigid3d (*between)(const Rigid3d& a, const Rigid3d& b, double part) = interpolate;
};

/// All kinds; the first one holds what no word assigns to another.
std::span<const ActorKind> actor_kinds();

/// Returns the kind of a type.
const ActorKind& kind_of(std::string_view type);

}  // namespace redrive
