// SPDX-License-Identifier: Apache-2.0
// Which pixels of a view that was never driven some training image saw: elsewhere a field can only
// guess.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/render/renderer.h"
#include "redrive/train/run.h"

namespace redrive {

/// Depth of the training views as the run's own field renders it, small, to tell what hides what.
/// Judging by the field's geometry needs no truth, so it works on every recording; where that
/// geometry is wrong, so is the map.
class Coverage {
 public:
  /// Renders at most kMaxViews training views, evenly spaced over each camera. What the run leaves
  /// out of them (train/training_data.h) saw nothing. InputError as read_exclusions.
  Coverage(const Run& run, kernels::Backend& backend);

  /// [height, width]: 1 where the surface that `rendered` shows lies inside a training image, is
  /// not masked there and has nothing in front of it, else 0. A ray that meets no surface (opacity
  /// below 1/2) ends at the far limit.
  std::vector<std::uint8_t> seen(const Camera& camera, const Rigid3d& world_from_camera,
                                 const RenderedImage& rendered) const;

  static constexpr int kMaxViews = 64;

 private:
  struct TrainingView {
    Camera camera;  ///< of the small image
    Rigid3d camera_from_world;
    std::vector<float> range_m;  ///< [height, width]; 0 where the camera's model does not reach, or
                                 ///< a mask leaves the pixel out
  };
  std::vector<TrainingView> views_;
  double far_m_ = 0;
};

}  // namespace redrive
