// SPDX-License-Identifier: Apache-2.0
// Point correspondences between images of one camera, tracked over a few frames without a guess
// from poses or calibration, and their error under a relative pose.
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
  double min_driven_m = 1.2;  ///< distance driven between two images,
  int max_frames = 4;         ///< limited to these frames
  int pairs = 16;             ///< pairs of images, spread over the drive
  int points_per_image = 250;
  double margin_s = 0.1;  ///< images this close to the first and last pose are not used
};

/// Corners tracked by pyramidal Lucas-Kanade from image to image, with a forward-backward error of
/// at most 0.5 px, none on the vehicle, on moving objects or masked.
std::vector<Correspondence> find_correspondences(const RigImages& images, int camera,
                                                 const CorrespondenceOptions& options = {});

/// Relative pose of two images and the ground plane, which limits depths.
struct PairGeometry {
  Rigid3d b_from_a;
  Eigen::Vector3d up_in_a;  ///< unit, of the body
  double height_m = 0;      ///< height of camera a above the plane the vehicle stands on
};

/// Distance in pixels of image b between the observed point and the nearest projection of the ray
/// of a from 0.3 m on; rays below the horizon end 1 m below the ground. Unlike an epipolar error it
/// distinguishes forward from backward and up from down.
double correspondence_error_px(const RayPair& rays, const PairGeometry& pose);

}  // namespace redrive
