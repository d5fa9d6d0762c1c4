// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/flip.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using Triple = cv::Vec3f;

// Linear sRGB to XYZ (D65), IEC 61966-2-1.
const cv::Matx33f kXyzFromRgb(0.4124564f, 0.3575761f, 0.1804375f,  //
                              0.2126729f, 0.7151522f, 0.0721750f,  //
                              0.0193339f, 0.1191920f, 0.9503041f);
const cv::Matx33f kRgbFromXyz = kXyzFromRgb.inv();
const Triple kWhite = kXyzFromRgb * Triple(1, 1, 1);

// Section 4.1: contrast sensitivity as sums of Gaussians a sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees.
struct Gaussian {
  double a, b;
};
constexpr Gaussian kAchromatic{1, 0.0047}, kRedGreen{1, 0.0053}, kBlueYellow[2] = {{34.1, 0.04}, {13.5, 0.025}};
constexpr double kWidestB = 0.04;

// Section 4.1.3 and 4.2: exponents and the knee of the map of colour differences to [0, 1].
constexpr double kColourExponent = 0.7, kKneeAt = 0.4, kKneeValue = 0.95, kFeatureExponent = 0.5;
constexpr double kFeatureWidth_deg = 0.082;

float linear_from_srgb(float x) { return x <= 0.04045f ? x / 12.92f : std::pow((x + 0.055f) / 1.055f, 2.4f); }

/// YCxCz: linear in XYZ, so that it may be filtered.
Triple ycxcz_from_rgb(const Triple& linear) {
  const Triple xyz = kXyzFromRgb * linear;
  const float x = xyz[0] / kWhite[0], y = xyz[1] / kWhite[1], z = xyz[2] / kWhite[2];
  return {116 * y - 16, 500 * (x - y), 200 * (y - z)};
}

Triple rgb_from_ycxcz(const Triple& opponent) {
  const float y = (opponent[0] + 16) / 116;
  const Triple xyz((y + opponent[1] / 500) * kWhite[0], y * kWhite[1], (y - opponent[2] / 200) * kWhite[2]);
  return kRgbFromXyz * xyz;
}

/// L*a*b* with the chroma scaled by 0.01 L (Hunt: colours of dark surfaces look less colourful).
Triple hunt_lab_from_rgb(const Triple& linear) {
  constexpr float kDelta = 6.0f / 29;
  const auto f = [](float t) {
    return t > kDelta * kDelta * kDelta ? std::cbrt(t) : t / (3 * kDelta * kDelta) + 4.0f / 29;
  };
  const Triple xyz = kXyzFromRgb * linear;
  const float x = f(xyz[0] / kWhite[0]), y = f(xyz[1] / kWhite[1]), z = f(xyz[2] / kWhite[2]);
  const float lightness = 116 * y - 16;
  return {lightness, 0.01f * lightness * 500 * (x - y), 0.01f * lightness * 200 * (y - z)};
}

double hyab(const Triple& p, const Triple& q) {
  return std::abs(p[0] - q[0]) + std::hypot(double(p[1]) - q[1], double(p[2]) - q[2]);
}

/// Samples of exp(-x^2 / (2 sigma^2)) at whole pixels, scaled to sum 1; `sum` is the sum before.
cv::Mat gaussian_kernel(int radius, double sigma_px, double* sum = nullptr) {
  cv::Mat kernel(2 * radius + 1, 1, CV_32F);
  double total = 0;
  for (int i = -radius; i <= radius; ++i)
    total += kernel.at<float>(i + radius) = static_cast<float>(std::exp(-0.5 * i * i / (sigma_px * sigma_px)));
  kernel /= total;
  if (sum) *sum = total;
  return kernel;
}

cv::Mat filtered(const cv::Mat& image, const cv::Mat& along_x, const cv::Mat& along_y) {
  cv::Mat out;
  cv::sepFilter2D(image, out, CV_32F, along_x, along_y, {-1, -1}, 0, cv::BORDER_REPLICATE);
  return out;
}

/// One opponent channel through the eye's contrast sensitivity; the two-dimensional kernel sums to 1.
template <std::size_t N>
cv::Mat seen_channel(const cv::Mat& channel, const Gaussian (&terms)[N]) {
  const int radius = static_cast<int>(
      std::ceil(3 * std::sqrt(kWidestB / (2 * std::numbers::pi * std::numbers::pi)) * kFlipPixelsPerDegree));
  cv::Mat total = cv::Mat::zeros(channel.size(), CV_32F);
  double weights = 0;
  for (const Gaussian& term : terms) {
    // exp(-pi^2 x^2 / b) is a Gaussian of sigma sqrt(b / 2) / pi degrees.
    const double sigma_px = std::sqrt(term.b / 2) / std::numbers::pi * kFlipPixelsPerDegree;
    double sum = 0;
    const cv::Mat kernel = gaussian_kernel(radius, sigma_px, &sum);
    const double weight = term.a * std::sqrt(std::numbers::pi / term.b) * sum * sum;
    total += weight * filtered(channel, kernel, kernel);
    weights += weight;
  }
  return total / weights;
}

/// Picture as the eye resolves it, in Hunt-adjusted L*a*b*; and its achromatic channel in [0, 1], unfiltered.
struct Seen {
  cv::Mat lab, luminance;
};

Seen see(std::span<const float> rgb, std::span<const std::uint8_t> mask, int width, int height) {
  cv::Mat opponent(height, width, CV_32FC3);
  Seen seen{cv::Mat(height, width, CV_32FC3), cv::Mat(height, width, CV_32F)};
  for (int i = 0; i < width * height; ++i) {
    Triple linear(0, 0, 0);
    if (mask.empty() || mask[i] != 0)
      for (int c = 0; c < 3; ++c) linear[c] = linear_from_srgb(std::clamp(rgb[3 * std::size_t(i) + c], 0.0f, 1.0f));
    const Triple value = ycxcz_from_rgb(linear);
    opponent.ptr<Triple>()[i] = value;
    seen.luminance.ptr<float>()[i] = (value[0] + 16) / 116;
  }
  cv::Mat channels[3];
  cv::split(opponent, channels);
  channels[0] = seen_channel(channels[0], {kAchromatic});
  channels[1] = seen_channel(channels[1], {kRedGreen});
  channels[2] = seen_channel(channels[2], kBlueYellow);
  for (int i = 0; i < width * height; ++i) {
    Triple linear =
        rgb_from_ycxcz({channels[0].ptr<float>()[i], channels[1].ptr<float>()[i], channels[2].ptr<float>()[i]});
    for (int c = 0; c < 3; ++c) linear[c] = std::clamp(linear[c], 0.0f, 1.0f);
    seen.lab.ptr<Triple>()[i] = hunt_lab_from_rgb(linear);
  }
  return seen;
}

/// Length of the gradient and of the second derivatives of a channel: edges and points, section 4.2. Kernels are
/// scaled so that their positive and their negative parts each sum to 1.
struct Features {
  cv::Mat edges, points;
};

Features features_of(const cv::Mat& luminance) {
  const double sigma_px = 0.5 * kFeatureWidth_deg * kFlipPixelsPerDegree;
  const int radius = static_cast<int>(std::ceil(3 * sigma_px));
  const cv::Mat smooth = gaussian_kernel(radius, sigma_px);
  const auto derivative = [&](auto&& factor) {
    cv::Mat kernel = smooth.clone();
    double positive = 0, negative = 0;
    for (int i = -radius; i <= radius; ++i) {
      float& value = kernel.at<float>(i + radius);
      value *= static_cast<float>(factor(i));
      (value > 0 ? positive : negative) += value;
    }
    for (int i = 0; i <= 2 * radius; ++i) kernel.at<float>(i) /= kernel.at<float>(i) > 0 ? positive : -negative;
    return kernel;
  };
  const cv::Mat first = derivative([](int x) { return -x; });
  const cv::Mat second = derivative([&](int x) { return x * x / (sigma_px * sigma_px) - 1; });
  Features features;
  cv::magnitude(filtered(luminance, first, smooth), filtered(luminance, smooth, first), features.edges);
  cv::magnitude(filtered(luminance, second, smooth), filtered(luminance, smooth, second), features.points);
  return features;
}

/// Colour difference in [0, 1]: the largest possible one, green against blue, is 1.
double colour_difference(const Triple& p, const Triple& q) {
  static const double largest =
      std::pow(hyab(hunt_lab_from_rgb({0, 1, 0}), hunt_lab_from_rgb({0, 0, 1})), kColourExponent);
  const double value = std::pow(hyab(p, q), kColourExponent), knee = kKneeAt * largest;
  if (value < knee) return kKneeValue / knee * value;
  return kKneeValue + (value - knee) / (largest - knee) * (1 - kKneeValue);
}

}  // namespace

double flip(std::span<const float> rgb, std::span<const float> truth, std::span<const std::uint8_t> mask, int width,
            int height) {
  const std::size_t pixels = static_cast<std::size_t>(width) * height;
  REDRIVE_CHECK_OP(rgb.size(), ==, 3 * pixels);
  REDRIVE_CHECK_OP(truth.size(), ==, 3 * pixels);
  REDRIVE_CHECK(mask.empty() || mask.size() == pixels);
  const Seen a = see(rgb, mask, width, height), b = see(truth, mask, width, height);
  const Features of_a = features_of(a.luminance), of_b = features_of(b.luminance);
  double sum = 0;
  std::size_t counted = 0;
  for (std::size_t i = 0; i < pixels; ++i) {
    if (!mask.empty() && mask[i] == 0) continue;
    const double edges = std::abs(of_a.edges.ptr<float>()[i] - of_b.edges.ptr<float>()[i]);
    const double points = std::abs(of_a.points.ptr<float>()[i] - of_b.points.ptr<float>()[i]);
    const double feature = std::pow(std::min(1.0, std::max(edges, points) / std::numbers::sqrt2), kFeatureExponent);
    sum += std::pow(colour_difference(a.lab.ptr<Triple>()[i], b.lab.ptr<Triple>()[i]), 1 - feature);
    ++counted;
  }
  return counted == 0 ? std::numeric_limits<double>::quiet_NaN() : sum / static_cast<double>(counted);
}

}  // namespace redrive
