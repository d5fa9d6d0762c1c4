// SPDX-License-Identifier: Apache-2.0
// Surface normals of a rendered image, computed from its depth, which any method has.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "redrive/model/rendered_image.h"
#include "redrive/rays/ray_table.h"

namespace redrive {

/// Normals of the pixels that one asks for.
class SurfaceNormals {
 public:
  SurfaceNormals(const RenderedImage& image, const RayTable& table);

  /// Returns the unit normal of the surface at a pixel, in camera axes (x right, y down, z
  /// forward), turned to the camera; 0 where opacity is below 0.5 or the pixels around it determine
  /// no plane. The plane is the best fit to the pixels of a window of 7 x 7 whose distance is
  /// within 5 % of the pixel's, so that an edge does not bend it.
  Eigen::Vector3d at(std::size_t pixel) const;

 private:
  int width_, height_;
  std::vector<Eigen::Vector3d> points_;  ///< [pixels], in camera axes; 0: no surface
  std::vector<double> distance_;
};

/// Returns SurfaceNormals::at of each pixel, [height, width, 3].
std::vector<float> surface_normals(const RenderedImage& image, const RayTable& table);

/// Returns normals as colours in the usual form: (1 + n) / 2 with x right, y up and z to the
/// camera; 0 is black.
Image8 normals_image(const RenderedImage& image, const RayTable& table);

}  // namespace redrive
