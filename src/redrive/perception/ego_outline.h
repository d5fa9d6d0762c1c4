// SPDX-License-Identifier: Apache-2.0
// Finds the ego vehicle in the images of its camera: the part of the image that stays constant
// while the road moves through it.
//
// Two measurements per pixel. (1) Static structure: the temporal median of the brightness gradient
// along the optical flow of driving, over its standard error. Lane lines, kerbs and guard rails
// are static, too, but they are parallel to the flow and have no gradient along it. (2) Moving
// ground: the neighbouring image is warped by the egomotion of the plane z = 0 of the body; where
// deviations from the temporal mean correlate between the two, the pixel shows road. By day, where
// most of the road is recognised this way, the remaining pixels are vehicle. The outline is the
// first vehicle row of each column with the least total cost (dynamic programming): static
// structure lowers the cost; moving ground, pixels without evidence and steps between columns raise
// it. Only rays below the horizon that intersect the volume of a car (body x -1.5..4.3, |y| <= 1.2,
// z 0.1..1.15 m) are candidates, so that neither sky nor distant objects are taken for the vehicle.
//
// Unlit parts of the vehicle are not found. Light that the vehicle throws onto the road is static
// and may be taken for it.
#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "redrive/base/opencv_threads.h"
#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// An image of a drive.
struct GreyView {
  cv::Mat grey;  ///< [height, width] float, 0..255
  Rigid3d world_from_body;
  std::int64_t t_ns = 0;
};

/// Returns the first row of the vehicle in each column of `camera`, camera.height where there is
/// none. `views`: in order of time, all of the camera's size; widths of 200 to 400 pixels are
/// enough. With fewer than 8 views or 5 m of driving there is none in any column.
std::vector<int> find_ego_outline(const Camera& camera, const Rigid3d& body_from_sensor,
                                  const std::vector<GreyView>& views);

}  // namespace redrive
