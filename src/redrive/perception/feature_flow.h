// SPDX-License-Identifier: Apache-2.0
// Corners and where they are in another image, for every search that follows points through images:
// the strongest corner of each cell of a grid (Shi, Tomasi 1994) and pyramidal Lucas-Kanade there
// and back.
#pragma once

#include <functional>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {

/// Area-averages by a whole factor; the remainder is cropped, as Camera::downscaled does.
cv::Mat averaged(const cv::Mat& image, int factor);

struct CornerGrid {
  int cell_px = 8;          ///< side of a cell, which has at most one corner
  int block_px = 7;         ///< side of the block whose gradients make a corner
  int border_px = 0;        ///< pixels this near to the image's border are no corners
  double least_levels = 1;  ///< least gradient in the weaker direction, grey levels per pixel
};

/// Calls use(corner) for each cell, row by row, that has a strong enough corner where `usable` is
/// not 0. `use` may change `usable`, which holds for the cells after it. grey: 8 bits or floats.
void for_each_corner(const cv::Mat& grey, const cv::Mat& usable, const CornerGrid& grid,
                     const std::function<void(const cv::Point&)>& use);

struct FlowOptions {
  int window_px = 7;
  int levels = 3;         ///< pyramid levels above the image that are searched
  float error_px = 0.5f;  ///< largest error in x and in y after the way there and back
};

/// Returns where Lucas-Kanade finds the points `at` of one image again in another, starting from
/// the guesses: nothing where it ends within 2 pixels of the border, or where tracking back does
/// not return to the point. The pyramids are cv::buildOpticalFlowPyramid's.
std::vector<std::optional<cv::Point2f>> flow_there_and_back(const std::vector<cv::Mat>& from,
                                                            const std::vector<cv::Mat>& to,
                                                            const std::vector<cv::Point2f>& at,
                                                            const std::vector<cv::Point2f>& guesses,
                                                            const FlowOptions& options);

}  // namespace redrive
