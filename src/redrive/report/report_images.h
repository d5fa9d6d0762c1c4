// SPDX-License-Identifier: Apache-2.0
// The pictures of a report: what a camera saw, what the run makes of it, and what it would have
// seen from elsewhere.
#pragma once

#include <string>
#include <vector>

#include "redrive/eval/coverage.h"
#include "redrive/eval/evaluate.h"
#include "redrive/train/run.h"

namespace redrive {

struct Picture {
  std::string name;  ///< file name without extension: "F_CAM_original"
  std::string caption;
  Image8 image;
};

struct ImageRow {
  std::string title;  ///< "F_CAM, frame 33650", "aside: A_0001.png"
  std::vector<Picture> pictures;
};

constexpr double kPerturbation_m = 0.5;  ///< the report's shift of the extrinsic, along x
constexpr int kDifferenceGain = 4;       ///< of difference pictures

/// The training view that the figures show for a camera of the rig: random, but the same for the
/// same seed.
const View& figure_view(const Run& run, int camera);

/// "nerf, 5.0 min": a run's method and training time.
std::string method_text(const Run& run);

/// Original, reproduced (by `beside`, too, where it has the view), perturbed along x of the body
/// and of the camera, and depth.
ImageRow camera_image_row(const Run& run, kernels::Backend& backend, int camera,
                          const Run* beside = nullptr);

/// Truth, render (of `beside`, too, where it has the view), difference and coverage of the middle
/// view of a novel set, which has at least one.
ImageRow novel_image_row(const Run& run, kernels::Backend& backend, const NovelGroundTruth& truth,
                         const Coverage& coverage, const Run* beside = nullptr);

/// Depth in the colours of the Turbo map, near_m the first and far_m the last; pixels that are not
/// valid are dark grey.
Image8 depth_colours(const RenderedImage& image, double near_m, double far_m);

/// The image in grey, with what is not `seen` (eval/coverage.h) in red; pixels that are not valid
/// stay black.
Image8 coverage_colours(const RenderedImage& image, const std::vector<std::uint8_t>& seen);

/// kDifferenceGain * |a - b| per channel, clamped.
Image8 difference(const Image8& a, const Image8& b);

}  // namespace redrive
