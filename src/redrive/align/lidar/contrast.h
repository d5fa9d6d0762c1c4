// SPDX-License-Identifier: Apache-2.0
// What is bright to the LiDAR and to a camera as well: lane markings, signs, posts. Where the two
// pictures of it lie upon each other tells when a camera exposes. Tracks alone cannot tell a camera
// that exposes late from one mounted further forward while the vehicle drives straight on at one
// speed, and at night there are few of them; LiDAR planes know of no camera.
#pragma once

#include <vector>

#include "redrive/align/lidar/planes.h"
#include "redrive/align/rig/rig_images.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/base/parallel.h"

namespace redrive {

/// What it takes.
struct ContrastData {
  const RigImages& images;                  ///< of any size, averaged or not; the larger, the finer
  const std::vector<LidarSample>& samples;  ///< the more, the better
};

/// What one camera's images say of its clock.
struct ContrastFit {
  int cells = 0;  ///< compared: places of an image with LiDAR returns
  /// Correlation of both contrasts, -1..1, over time offsets: kContrastStep_s apart, the middle one
  /// is the model's as it is.
  std::vector<double> correlation;
  bool told = false;                 ///< it has a peak, and all images together agree where
  double offset_s = 0, sigma_s = 0;  ///< there, with the rest of the model as it is
  double now() const { return correlation[correlation.size() / 2]; }
};
constexpr double kContrastStep_s = 2e-3;

/// By camera, of at most 16 of its images. Poses and cameras of `model` may be wrong by some
/// pixels; all but the clocks is taken as it is.
std::vector<ContrastFit> fit_time_offsets(const RigModel& model, const ContrastData& source,
                                          ThreadPool& pool);

}  // namespace redrive
