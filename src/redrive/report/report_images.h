// SPDX-License-Identifier: Apache-2.0
// The images of a report: recorded images, renderings of their views and of novel views.
#pragma once

#include <string>
#include <vector>

#include "redrive/eval/coverage.h"
#include "redrive/eval/evaluate.h"
#include "redrive/train/run.h"

namespace redrive {

struct ReportImage {
  std::string name;  ///< file name without extension: "F_CAM_original"
  std::string caption;
  Image8 image;
};

/// Images that the report shows side by side.
struct ImageRow {
  std::string title;  ///< "F_CAM, frame 33650", "aside: A_0001.png"
  std::vector<ReportImage> images;
};

constexpr double kPerturbation_m = 0.5;  ///< shift of the extrinsic along x
constexpr int kDifferenceGain = 4;       ///< factor of difference images

/// Returns the training view that the figures show for a camera of the rig: drawn at random by the
/// run's seed.
const View& figure_view(const Run& run, int camera);

/// Returns a run's method and training time: "nerf, 5.0 min".
std::string method_text(const Run& run);

/// Renders a training view: original, reproduced (by `compared`, too, where it has the view),
/// shifted along x of the body and of the camera, and depth.
ImageRow camera_image_row(const Run& run, kernels::Backend& backend, int camera,
                          const Run* compared = nullptr);

/// Renders a view at the pose that it has in `run`, and `same` view of the compared run; null:
/// none.
ImageRow headline_image_row(const Run& run, kernels::Backend& backend, const View& view,
                            const Run* compared = nullptr, const View* same = nullptr);

/// Renders the middle view of a novel set, which has at least one: ground truth, rendering (by
/// `compared`, too, where it has the view), difference and coverage.
ImageRow novel_image_row(const Run& run, kernels::Backend& backend,
                         const NovelGroundTruth& ground_truth, const Coverage& coverage,
                         const Run* compared = nullptr);

/// Maps depth to the Turbo colours by its logarithm, near_m to the first and far_m to the last one;
/// invalid pixels are dark grey.
Image8 depth_colours(const RenderedImage& image, double near_m, double far_m);

/// Returns the image in grey, with the pixels that are not `seen` (eval/coverage.h) in red; invalid
/// pixels stay black.
Image8 coverage_colours(const RenderedImage& image, const std::vector<std::uint8_t>& seen);

/// Returns a labelled image in grey, with the pixels of each moving object in a colour of its own.
Image8 actor_colours(const RenderedImage& image);

/// Returns kDifferenceGain * |a - b| per channel, clamped.
Image8 difference(const Image8& a, const Image8& b);

}  // namespace redrive
