// SPDX-License-Identifier: Apache-2.0
// What is drawn over an image: lines and LiDAR points, projected through the camera's real lens.
#pragma once

#include <list>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "redrive/view/view_renderer.h"

namespace redrive::view {

/// A line in an image: u, v from 0 at the left and upper edge to 1 at the others.
struct OverlayLine {
  const char* kind = "";  ///< "trajectory", "frustum", "box"
  std::string label;      ///< of the first point of an object; may be empty
  std::vector<Eigen::Vector2d> points;
};

class Overlay {
 public:
  explicit Overlay(const Run& run) : run_(run) {}  ///< `run` must outlive it

  /// Lines are broken where the lens sees nothing. InputError for a damaged box file.
  std::vector<OverlayLine> lines(const Placement& placement, const Overlays& which) const;

  /// Returns the points of the frame's revolution that are not behind a surface of the image, 6
  /// bytes each: u and v in 1/65535 of the image (16 bits, little-endian), colour (0 near, 255
  /// far, by the logarithm of the range), 0. InputError for a damaged LiDAR file.
  std::string points(const RenderJob& job);

 private:
  using Points = std::vector<Eigen::Vector3f>;
  std::shared_ptr<const Points> revolution(std::int64_t frame);

  const Run& run_;
  std::list<std::pair<std::int64_t, std::shared_ptr<const Points>>> revolutions_;  ///< latest first
};

}  // namespace redrive::view
