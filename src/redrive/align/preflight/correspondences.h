// SPDX-License-Identifier: Apache-2.0
// What a camera's images alone say of how it moved: points followed over a few frames without a
// guess from poses or calibration, and how far a pose is from agreeing with them.
#pragma once

#include <vector>

#include "redrive/align/rig/rig_images.h"
#include "redrive/align/tracks/epipolar.h"

namespace redrive {

/// One point in two images of one camera, a before b.
struct Correspondence {
  int frame_a = 0, frame_b = 0;  ///< indices into Scene::frames
  RayPair rays;
};

struct CorrespondenceOptions {
  double min_driven_m = 1.2;  ///< between two images compared: as many frames as that takes,
  int max_frames = 4;         ///< but no more than these
  int pairs = 16;             ///< of images compared, spread over the drive
  int points_per_image = 250;
  double margin_s = 0.1;  ///< images this close to the first and last pose are left out
};

/// Corners followed by pyramidal Lucas-Kanade from image to image, forth and back to 0.5 px, none
/// on the vehicle, on moving objects or masked.
std::vector<Correspondence> find_correspondences(const RigImages& images, int camera,
                                                 const CorrespondenceOptions& options = {});

/// A camera's pose as an error is measured under it: where it is, and how far its rays may go.
struct PairGeometry {
  Rigid3d b_from_a;
  Eigen::Vector3d up_in_a;  ///< unit, of the body
  double height_m = 0;      ///< of camera a above the plane the vehicle stands on
};

/// Distance in pixels of image b between the point seen there and the nearest that the ray of a,
/// from 0.3 m on, can be seen at; rays below the horizon end 1 m below the ground. Other than an
/// epipolar error it tells forward from backward, and up from down.
double correspondence_error_px(const RayPair& rays, const PairGeometry& pose);

}  // namespace redrive
