// SPDX-License-Identifier: Apache-2.0
// The Gaussians of an object without its track: what `redrive export --actor` writes and an edit
// puts on another track. Axes are those of the object's box: origin in its centre, x forward, y
// left, z up, metres.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "redrive/base/buffer.h"

namespace redrive {

struct ActorBody {
  std::string type;                                  ///< MovingObject::type; may be empty
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  ///< of its box: length, width, height
  std::size_t n = 0;                                 ///< Gaussians
  Buffer<float> numbers;                             ///< their blocks (field/gaussian.h)
};

/// Comments of a PLY that keep type and size: "redrive class CAR", "redrive size_m 4.5 1.8 1.5".
std::vector<std::string> body_comments(const std::string& type, const Eigen::Vector3d& size_m);

/// Parses a PLY in the layout of 3D Gaussian Splatting (model/gaussian_ply.h), with harmonics of
/// degree 0 to 3, of which degree 0 and 1 are kept. Without a comment the size is twice what 98 %
/// of the means keep of the origin along each axis. InputError for damaged files, more than 10^6
/// Gaussians or none, numbers that are not finite, and means more than 100 m from the origin.
ActorBody parse_actor_body(std::string_view bytes, const std::filesystem::path& file);
ActorBody read_actor_body(const std::filesystem::path& file);

}  // namespace redrive
