// SPDX-License-Identifier: Apache-2.0
// The visual hull of an object in images with transparency (Laurentini 1994): the space that no
// image shows as transparent.
#pragma once

#include <vector>

#include "redrive/model/trainee.h"

namespace redrive {

class VisualHull {
 public:
  /// Keeps references to the cameras of `data`. Opaque images are not used.
  explicit VisualHull(const TrainingSet& data);

  /// Whether no training image is transparent in the 3 x 3 pixels around the point, and at least
  /// one sees it; true if no image has transparency. position: world, metres.
  bool contains(const Eigen::Vector3d& position) const;

 private:
  struct Silhouette {
    const Camera* camera;
    Rigid3d camera_from_world;
    std::vector<bool> shown;  ///< [height, width]: not wholly transparent

    bool transparent_around(int x, int y) const;
  };
  std::vector<Silhouette> silhouettes_;
};

}  // namespace redrive
