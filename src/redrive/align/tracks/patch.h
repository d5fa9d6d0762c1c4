// SPDX-License-Identifier: Apache-2.0
// Registers a small patch of one image in another to a fraction of a pixel: position, affine warp,
// gain and offset of brightness by Gauss-Newton (Lucas, Kanade 1981; Shi, Tomasi, "Good features to
// track", 1994). Registering each image with the patch of a track's first one keeps errors from
// accumulating from frame to frame.
#pragma once

#include <array>
#include <optional>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {

inline constexpr int kPatchHalf = 7;  // 15 x 15 pixels
inline constexpr int kPatchSize = 2 * kPatchHalf + 1;

/// An image smoothed by a Gaussian of 0.7 px, so that linear interpolation is exact to about 0.01
/// px, and its gradient. Floats, [height, width].
struct SmoothImage {
  cv::Mat value, dx, dy;
};
SmoothImage smooth_image(const cv::Mat& grey);

/// values[i] at (column, row) = (i % kPatchSize, i / kPatchSize) - kPatchHalf from the centre.
using Patch = std::array<float, kPatchSize * kPatchSize>;

/// Samples image(centre + warp offset), averaged over the area of one patch pixel if that is more
/// than one image pixel. Nothing where that leaves the image.
std::optional<Patch> sample_patch(const SmoothImage& image, const Eigen::Vector2d& centre,
                                  const Eigen::Matrix2d& warp = Eigen::Matrix2d::Identity());

struct PatchFit {
  Eigen::Vector2d pixel;
  Eigen::Matrix2d warp;  ///< pixels of the image per pixel of the patch
  /// correlation of the patch and the image in it, -1..1, weighted like the fit
  double correlation = 0;
  double sigma_px = 0;  ///< standard deviation of the pixel from the residuals: large on an edge
};

/// Fits image(pixel + warp offset) = gain patch(offset) + shift from a start within a few pixels.
/// The warp has a prior of 0.1 around its start. Nothing where the fit leaves the image, moves by
/// more than max_move_px or does not converge.
std::optional<PatchFit> fit_patch(const Patch& patch, const SmoothImage& image,
                                  const Eigen::Vector2d& start, const Eigen::Matrix2d& start_warp,
                                  double max_move_px);

}  // namespace redrive
