// SPDX-License-Identifier: Apache-2.0
// Straight lines of the world in an image, which bend in the image of a fisheye.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive {

/// A part of a line that the lens sees.
struct ImageLine {
  const char* kind = "";
  std::string label;  ///< label of the first part of what begin() began; may be empty
  std::vector<Eigen::Vector2d> points;
};

/// Projects lines point by point and collects them.
class LinePen {
 public:
  /// Returns where the image shows a point of the world, or nothing.
  using Project = std::function<std::optional<Eigen::Vector2d>(const Eigen::Vector3d& in_world)>;

  LinePen(Project project, std::vector<ImageLine>* lines)
      : project_(std::move(project)), lines_(*lines) {}

  void begin(const char* kind, std::string label = "");
  /// Draws a straight line in the world from the last point to this one.
  void to(const Eigen::Vector3d& in_world);

 private:
  void add(const Eigen::Vector3d& in_world);

  Project project_;
  std::vector<ImageLine>& lines_;
  const char* kind_ = "";
  std::string label_;
  bool open_ = false;
  std::optional<Eigen::Vector3d> last_;
};

/// Returns a corner of a box in the world: its front where bit 0 of i is set, its left side where
/// bit 1 is, its top where bit 2 is.
Eigen::Vector3d box_corner(const Rigid3d& world_from_box, const Eigen::Vector3d& size_m, int i);

/// Draws the twelve edges of a box; the label stands at the top of its back, on the right.
void draw_box(const char* kind, const std::string& label, const Eigen::Vector3d& size_m,
              const Rigid3d& world_from_box, LinePen* pen);

}  // namespace redrive
