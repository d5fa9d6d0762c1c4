// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/feature_flow.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgproc.hpp>
#include <opencv2/video/tracking.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {

cv::Mat averaged(const cv::Mat& image, int factor) {
  cv::Mat small;
  const cv::Size size(image.cols / factor, image.rows / factor);
  cv::resize(image(cv::Rect({0, 0}, size * factor)), small, size, 0, 0, cv::INTER_AREA);
  return small;
}

void for_each_corner(const cv::Mat& grey, const cv::Mat& usable, const CornerGrid& grid,
                     const std::function<void(const cv::Point&)>& use) {
  // OpenCV sums squared Sobel gradients (8 x gradient) times (1 / (4 block))^2 over block^2 pixels:
  // 4 mean of gradient^2. It divides 8-bit images by 255.
  const double level = grey.depth() == CV_8U ? 1.0 / 255 : 1;
  const auto least = static_cast<float>(4 * std::pow(grid.least_levels * level, 2));
  cv::Mat strength;
  cv::cornerMinEigenVal(grey, strength, grid.block_px);
  const int bottom = grey.rows - grid.border_px, right = grey.cols - grid.border_px;
  for (int top = grid.border_px; top < bottom; top += grid.cell_px)
    for (int left = grid.border_px; left < right; left += grid.cell_px) {
      float best = least;
      cv::Point at(-1, -1);
      for (int y = top; y < std::min(top + grid.cell_px, bottom); ++y)
        for (int x = left; x < std::min(left + grid.cell_px, right); ++x)
          if (strength.at<float>(y, x) > best && usable.at<std::uint8_t>(y, x) != 0) {
            best = strength.at<float>(y, x);
            at = {x, y};
          }
      if (at.x >= 0) use(at);
    }
}

std::vector<std::optional<cv::Point2f>> flow_there_and_back(const std::vector<cv::Mat>& from,
                                                            const std::vector<cv::Mat>& to,
                                                            const std::vector<cv::Point2f>& at,
                                                            const std::vector<cv::Point2f>& guesses,
                                                            const FlowOptions& options) {
  constexpr float kEdge_px = 2;
  std::vector<std::optional<cv::Point2f>> result(at.size());
  if (at.empty()) return result;
  const auto flow = [&](const std::vector<cv::Mat>& a, const std::vector<cv::Mat>& b,
                        const std::vector<cv::Point2f>& points, std::vector<cv::Point2f>* found) {
    std::vector<std::uint8_t> good;
    std::vector<float> error;
    cv::calcOpticalFlowPyrLK(
        a, b, points, *found, good, error, {options.window_px, options.window_px}, options.levels,
        {cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 20, 0.02}, cv::OPTFLOW_USE_INITIAL_FLOW);
    return good;
  };
  std::vector<cv::Point2f> found = guesses, returned(at.size());
  const std::vector<std::uint8_t> there = flow(from, to, at, &found);
  // Tracks back with the guessed motion, not with the found one, which would confirm itself.
  for (std::size_t i = 0; i < at.size(); ++i) returned[i] = found[i] - (guesses[i] - at[i]);
  const std::vector<std::uint8_t> back = flow(to, from, found, &returned);
  const cv::Size size = to[0].size();
  for (std::size_t i = 0; i < at.size(); ++i) {
    const cv::Point2f error = returned[i] - at[i], &p = found[i];
    if (there[i] && back[i] && std::max(std::abs(error.x), std::abs(error.y)) < options.error_px &&
        p.x >= kEdge_px && p.y >= kEdge_px &&
        p.x <= static_cast<float>(size.width - 1) - kEdge_px &&
        p.y <= static_cast<float>(size.height - 1) - kEdge_px)
      result[i] = p;
  }
  return result;
}

}  // namespace redrive
