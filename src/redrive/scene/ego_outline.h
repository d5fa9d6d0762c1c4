// SPDX-License-Identifier: Apache-2.0
// Where a camera sees the vehicle that carries it: what never moves in the picture while the road
// streams by.
//
// Two things are measured at each pixel. (1) Structure that stays: the temporal median of the
// brightness gradient along the direction in which driving moves the picture there, over its
// standard error. Lane lines, kerbs and guard rails stay in place, too, but along that direction,
// where they have no gradient. (2) Ground that moves: a picture warped by the egomotion as the
// plane z = 0 of the body moves; where its deviations from the temporal mean correlate with those
// of the neighbouring picture, there is road. By day, when most of the road is seen to move like
// this, what is not is vehicle. The outline is the row per column, below which all is vehicle, that
// costs least: staying structure is earned, moving ground and each pixel without evidence are paid
// for, and so are steps between columns (dynamic programming). Only rays below the horizon that
// meet the space a car may take up (body x -1.5..4.3, |y| <= 1.2, z 0.1..1.15 m) are looked at:
// neither sky nor anything far away can be taken for the vehicle.
//
// It is blind to what is not lit, and light that the vehicle itself throws onto the road stays in
// place as the vehicle does.
#pragma once

#include <cstdint>
#include <vector>

#include <opencv2/core.hpp>

#include "redrive/camera/camera.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// One picture of a drive.
struct GreyView {
  cv::Mat grey;  ///< [height, width] float, 0..255
  Rigid3d world_from_body;
  std::int64_t t_ns = 0;
};

/// The first row of the vehicle in each column of `camera`, camera.height where there is none.
/// `views` by time, all of the camera's size; widths of 200 to 400 pixels are enough. None in any
/// column where less than 8 views or 5 m of driving cannot tell.
std::vector<int> find_ego_outline(const Camera& camera, const Rigid3d& body_from_sensor,
                                  const std::vector<GreyView>& views);

}  // namespace redrive
