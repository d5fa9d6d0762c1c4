// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/patch.h"

#include <cmath>

#include <Eigen/Cholesky>
#include <opencv2/imgproc.hpp>

#include "redrive/base/opencv_threads.h"

namespace redrive {
namespace {

constexpr double kWarpSigma = 0.1;  // prior of the warp
constexpr double kNoise = 3;  // grey levels, relative to which the prior of the warp is weighted
constexpr double kConverged_px = 0.005;
constexpr int kMaxIterations = 20;

/// Gaussian window, since the border may show another surface.
const std::array<float, kPatchSize * kPatchSize>& window() {
  static const auto weights = [] {
    std::array<float, kPatchSize * kPatchSize> w;
    for (int i = 0; i < kPatchSize * kPatchSize; ++i) {
      const double x = i % kPatchSize - kPatchHalf, y = i / kPatchSize - kPatchHalf;
      const double sigma = 0.6 * kPatchHalf;
      w[i] = static_cast<float>(std::exp(-(x * x + y * y) / (2 * sigma * sigma)));
    }
    return w;
  }();
  return weights;
}

/// Whether the whole warped patch lies where it can be interpolated.
bool inside(const cv::Mat& image, const Eigen::Vector2d& centre, const Eigen::Matrix2d& warp) {
  const Eigen::Vector2d reach = kPatchHalf * warp.cwiseAbs().rowwise().sum();
  const Eigen::Vector2d low = centre - reach, high = centre + reach;
  return low.x() >= 0 && low.y() >= 0 && high.x() < image.cols - 1 &&
         high.y() < image.rows - 1;  // NaN: no
}

struct Corner {
  std::size_t index;
  float x, y;
};
Corner corner(const cv::Mat& image, const Eigen::Vector2d& at) {
  const auto x = static_cast<int>(at.x()), y = static_cast<int>(at.y());
  return {std::size_t(y) * image.cols + x, static_cast<float>(at.x() - x),
          static_cast<float>(at.y() - y)};
}
float interpolate(const cv::Mat& image, const Corner& c) {
  const float* p = image.ptr<float>() + c.index;
  const float* q = p + image.cols;
  const float upper = p[0] + c.x * (p[1] - p[0]), lower = q[0] + c.x * (q[1] - q[0]);
  return upper + c.y * (lower - upper);
}

Eigen::Vector2d offset_of(int i) {
  return {i % kPatchSize - kPatchHalf, i / kPatchSize - kPatchHalf};
}

}  // namespace

SmoothImage smooth_image(const cv::Mat& grey) {
  SmoothImage image;
  grey.convertTo(image.value, CV_32F);
  cv::GaussianBlur(image.value, image.value, {5, 5}, 0.7);
  cv::Scharr(image.value, image.dx, CV_32F, 1, 0, 1.0 / 32);
  cv::Scharr(image.value, image.dy, CV_32F, 0, 1, 1.0 / 32);
  return image;
}

std::optional<Patch> sample_patch(const SmoothImage& image, const Eigen::Vector2d& centre,
                                  const Eigen::Matrix2d& warp) {
  if (!inside(image.value, centre, warp)) return std::nullopt;
  const Eigen::Vector2d last(image.value.cols - 1.001, image.value.rows - 1.001);
  const int fine =
      std::max(1, static_cast<int>(std::lround(std::sqrt(std::abs(warp.determinant())))));
  Patch patch{};
  for (int i = 0; i < static_cast<int>(patch.size()); ++i)
    for (int v = 0; v < fine; ++v)
      for (int u = 0; u < fine; ++u) {
        const Eigen::Vector2d within((u + 0.5) / fine - 0.5, (v + 0.5) / fine - 0.5);
        const Eigen::Vector2d at =
            (centre + warp * (offset_of(i) + within)).cwiseMax(0).cwiseMin(last);
        patch[i] +=
            interpolate(image.value, corner(image.value, at)) / static_cast<float>(fine * fine);
      }
  return patch;
}

std::optional<PatchFit> fit_patch(const Patch& patch, const SmoothImage& image,
                                  const Eigen::Vector2d& start, const Eigen::Matrix2d& start_warp,
                                  double max_move_px) {
  using Vector8f = Eigen::Matrix<float, 8, 1>;
  const auto& weights = window();
  double sum = 0, sum_w = 0, sum_sq = 0;  // sums over the patch
  for (std::size_t i = 0; i < patch.size(); ++i) {
    sum_w += weights[i];
    sum += weights[i] * patch[i];
    sum_sq += weights[i] * patch[i] * patch[i];
  }
  const double patch_mean = sum / sum_w, patch_var = sum_sq / sum_w - patch_mean * patch_mean;
  if (!(patch_var > 1e-3)) return std::nullopt;

  PatchFit fit{start, start_warp};
  double gain = 1, shift = 0;
  const double prior = kNoise * kNoise / (kWarpSigma * kWarpSigma);
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    if (!inside(image.value, fit.pixel, fit.warp)) return std::nullopt;
    std::array<float, kPatchSize * kPatchSize> value;
    double mean = 0, cross = 0, square = 0;
    std::array<Corner, kPatchSize * kPatchSize> at;
    for (int i = 0; i < static_cast<int>(patch.size()); ++i) {
      at[i] = corner(image.value, fit.pixel + fit.warp * offset_of(i));
      value[i] = interpolate(image.value, at[i]);
      mean += weights[i] * value[i];
      cross += weights[i] * value[i] * (patch[i] - patch_mean);
      square += weights[i] * value[i] * value[i];
    }
    mean /= sum_w;
    const double value_var = square / sum_w - mean * mean;
    gain = cross / sum_w / patch_var;  // the best for this position
    shift = mean - gain * patch_mean;
    if (!(gain > 0.1) || !(value_var > 1e-6)) return std::nullopt;
    fit.correlation = gain * std::sqrt(patch_var / value_var);

    Eigen::Matrix<float, 8, 8> hf = Eigen::Matrix<float, 8, 8>::Zero();
    Vector8f gf = Vector8f::Zero();
    double residuals = 0;
    for (int i = 0; i < static_cast<int>(patch.size()); ++i) {
      const float gx = interpolate(image.dx, at[i]), gy = interpolate(image.dy, at[i]);
      const Eigen::Vector2d o = offset_of(i);
      const auto x = static_cast<float>(o.x()), y = static_cast<float>(o.y());
      const float r = value[i] - static_cast<float>(gain * patch[i] + shift);
      Vector8f j;
      j << gx, gy, gx * x, gx * y, gy * x, gy * y, -static_cast<float>(patch[i] - patch_mean), -1;
      hf.selfadjointView<Eigen::Lower>().rankUpdate(j, weights[i]);
      gf += weights[i] * r * j;
      residuals += weights[i] * r * r;
    }
    Eigen::Matrix<double, 8, 8> h =
        hf.selfadjointView<Eigen::Lower>().toDenseMatrix().cast<double>();
    Eigen::Matrix<double, 8, 1> g = gf.cast<double>();
    const Eigen::Matrix2d drift = fit.warp - start_warp;
    for (int k = 0; k < 4; ++k) {
      h(2 + k, 2 + k) += prior;
      g[2 + k] += prior * drift(k / 2, k % 2);
    }
    const Eigen::LDLT<Eigen::Matrix<double, 8, 8>> solver(h);
    if (solver.info() != Eigen::Success || !solver.isPositive()) return std::nullopt;
    const Eigen::Matrix<double, 8, 1> step = -solver.solve(g);
    if (!step.allFinite()) return std::nullopt;
    const double limit = std::min(1.0, 2.0 / std::max(1e-9, step.head<2>().norm()));  // 2 px a step
    fit.pixel += limit * step.head<2>();
    fit.warp += limit * (Eigen::Matrix2d() << step[2], step[3], step[4], step[5]).finished();
    if ((fit.pixel - start).norm() > max_move_px || (fit.warp - start_warp).norm() > 1)
      return std::nullopt;
    if (step.head<2>().norm() < kConverged_px) {
      const double variance = std::max(residuals / sum_w, 1.0);
      const Eigen::Matrix<double, 8, 2> of_pixel =
          solver.solve(Eigen::Matrix<double, 8, 2>::Identity());
      fit.sigma_px = std::sqrt(variance * of_pixel.topRows<2>().trace());
      return fit;
    }
  }
  return std::nullopt;
}

}  // namespace redrive
