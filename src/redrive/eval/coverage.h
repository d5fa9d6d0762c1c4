// SPDX-License-Identifier: Apache-2.0
// Coverage of a novel view: the pixels whose surface some training image saw. Elsewhere the field
// is extrapolated.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/render/renderer.h"
#include "redrive/train/run.h"

namespace redrive {

/// Finds occlusions by small depth maps of the training views, rendered from the run's own field.
/// It needs no ground truth, so it works on every recording; where the field's geometry is wrong,
/// so is the coverage.
class Coverage {
 public:
  /// Renders at most kMaxViews training views, evenly spaced over each camera. Pixels that the run
  /// masks (train/training_data.h) count as not seen. Throws InputError as read_exclusions.
  Coverage(const Run& run, kernels::Backend& backend);

  /// Returns [height, width]: 1 where the surface in `rendered` projects into a training image, is
  /// not masked there and is not occluded, else 0. A ray that hits no surface (opacity below 1/2)
  /// ends at the far limit.
  std::vector<std::uint8_t> seen(const Camera& camera, const Rigid3d& world_from_camera,
                                 const RenderedImage& rendered) const;

  static constexpr int kMaxViews = 64;

 private:
  struct TrainingView {
    Camera camera;  ///< of the small image
    Rigid3d camera_from_world;
    std::vector<float> range_m;  ///< [height, width]; 0 outside the camera model's valid region
                                 ///< and where masked
  };
  std::vector<TrainingView> views_;
  double far_m_ = 0;
};

}  // namespace redrive
