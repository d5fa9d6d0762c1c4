// SPDX-License-Identifier: Apache-2.0
// The Gaussians of an object without its track: what `redrive export --actors` writes and an edit
// puts on another track. Axes are the axes of the object's box: origin in its centre, x forward, y
// left, z up, metres.
#pragma once

#include <cstddef>
#include <filesystem>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>

#include "redrive/base/buffer.h"

namespace redrive {

struct ActorBody {
  std::string type;                                  ///< MovingObject::type; may be empty
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();  ///< size of its box: length, width, height
  std::size_t n = 0;                                 ///< Gaussians
  Buffer<float> numbers;                             ///< their blocks (field/gaussian.h)
};

/// Comments of a PLY that keep type and size: "redrive class CAR", "redrive size_m 4.5 1.8 1.5".
std::vector<std::string> body_comments(const std::string& type, const Eigen::Vector3d& size_m);

/// Parses a PLY in the layout of 3D Gaussian Splatting (model/gaussian_ply.h), or an SPZ of
/// version 2 or 3 (model/gaussian_spz.h; version 2 has x y z of the quaternion in 8 bits
/// each, (b - 127.5) / 127.5, with w >= 0), by their first bytes. Keeps degree 0 and 1 of harmonics
/// of degree 0 to 3. Without a comment the size is twice the range that holds 98 % of the means,
/// from the origin along each axis. InputError for damaged files, more than 10^6 Gaussians or none,
/// numbers that are not finite, and means more than 100 m from the origin.
ActorBody parse_actor_body(std::string_view bytes, const std::filesystem::path& file);
ActorBody read_actor_body(const std::filesystem::path& file);

/// Bodies from files. A file is read once, and again after it has changed.
class ActorBodies {
 public:
  /// As read_actor_body.
  std::shared_ptr<const ActorBody> read(const std::filesystem::path& file);

 private:
  struct Known {
    std::filesystem::file_time_type written;
    std::shared_ptr<const ActorBody> body;
  };
  std::map<std::filesystem::path, Known> known_;
};

}  // namespace redrive
