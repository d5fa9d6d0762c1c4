// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <cstdint>
#include <string>

#include "redrive/math/rigid3.h"

namespace redrive {

/// The bounding box of an annotated object in one frame.
struct Box {
  std::int64_t object_id = 0;  ///< the same object in every frame; at most once per frame
  std::string type;            ///< "CAR", "TRUCK", ...: recording/core/actor_kind.h
  std::string actor_name;
  std::int64_t t_ns = 0;  ///< host clock: time of validity
  Rigid3d body_from_box;  ///< box axes: x along the object's length, forward; y left; z up; the
                          ///< origin is the centre
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  ///< full lengths along the box's axes
  /// The object's velocity minus the ego vehicle's, in body axes; for a parked object minus the ego
  /// vehicle's. Formats that annotate none take differences of positions.
  Eigen::Vector3d velocity_in_body_m_per_s = Eigen::Vector3d::Zero();
};

}  // namespace redrive
