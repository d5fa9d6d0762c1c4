// SPDX-License-Identifier: Apache-2.0
// Time offsets of cameras from features that are bright in LiDAR intensities and in images: lane
// markings, signs, posts. The offset at which both contrasts correlate best is the camera's. At
// constant velocity tracks alone cannot distinguish a late exposure from a camera further forward,
// at night there are few tracks, and LiDAR planes do not involve the cameras.
#pragma once

#include <vector>

#include "redrive/align/lidar/planes.h"
#include "redrive/align/rig/rig_images.h"
#include "redrive/align/rig/rig_model.h"
#include "redrive/base/parallel.h"

namespace redrive {

/// Input of fit_time_offsets.
struct ContrastData {
  const RigImages& images;                  ///< any size; larger ones give a finer estimate
  const std::vector<LidarSample>& samples;  ///< all of the drive
};

/// Correlation of one camera's images with the LiDAR.
struct ContrastFit {
  int cells = 0;  ///< image cells with LiDAR returns that were compared
  /// Correlation of both contrasts, -1..1, over time offsets kContrastStep_s apart around the
  /// model's present one.
  std::vector<double> correlation;
  bool observable = false;  ///< whether there is a peak on which all images agree
  /// position and sigma of the peak, with the rest of the model fixed
  double offset_s = 0, sigma_s = 0;
  double now() const { return correlation[correlation.size() / 2]; }
};
constexpr double kContrastStep_s = 2e-3;

/// Estimates by camera, each from at most 16 of its images. Errors of `model` of a few pixels are
/// tolerated; only time offsets are estimated.
std::vector<ContrastFit> fit_time_offsets(const RigModel& model, const ContrastData& source,
                                          ThreadPool& pool);

}  // namespace redrive
