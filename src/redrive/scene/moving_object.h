// SPDX-License-Identifier: Apache-2.0
// An object that moves, annotated or found: its boxes in the world over time.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/math/rigid3.h"
#include "redrive/scene/key_time.h"
#include "redrive/scene/pose_corrections.h"

namespace redrive {

struct ActorBody;

struct MovingObject {
  struct Key {
    std::int64_t t_ns;
    Rigid3d world_from_box;
    Eigen::Vector3d velocity_in_world_m_per_s;
  };
  std::int64_t id = 0;                               ///< Box::object_id
  std::string type;                                  ///< recording/core/actor_kind.h
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  ///< along each axis, the largest of its boxes
  std::vector<Key> keys;                             ///< ascending by time, at least one
  /// [keys, 6] as PoseCorrections::values, in the box's axes: what training corrected of each key,
  /// linear in time between them. An articulated object has its middle part's.
  /// Empty: nothing.
  std::vector<float> corrections;
  // Changes (edit/edit_actors.h):
  std::optional<std::int64_t> body;  ///< id of the object whose Gaussians it shows; none: its own
  /// Gaussians from another run that it shows instead (edit/actor_body.h); null: none.
  std::shared_ptr<const ActorBody> imported = nullptr;
  std::array<float, 3> gain{1, 1, 1};  ///< factors of r, g, b
  std::vector<std::pair<std::int64_t, std::int64_t>>
      hidden_ns;  ///< inclusive times at which it is not drawn

  /// Returns two keys at most 0.5 s apart, or the nearest one within 0.1 s; nothing at other times.
  std::optional<KeyTime> key_time(std::int64_t t_ns) const;
  /// Returns the pose of the box at t_ns: between the keys of key_time as its kind moves
  /// (recording/core/actor_kind.h), or extrapolated by the velocity. Nothing at other times, and
  /// while it is hidden.
  std::optional<Rigid3d> world_from_box(std::int64_t t_ns, Poses which = Poses::kCorrected) const;
  /// Moves the corrections into the keys, which then count as recorded.
  void apply_corrections();
};

}  // namespace redrive
