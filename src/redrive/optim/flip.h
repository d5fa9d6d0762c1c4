// SPDX-License-Identifier: Apache-2.0
// FLIP (Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020, LDR
// form): the perceived difference of two images when flipping between them. Here are the operations
// of one pixel and the filters' taps:
//   flip_opponent -> colour filters -> flip_lab;  flip_luminance -> feature filters ->
//   flip_magnitude;  both images' -> flip_difference
// Filters are separable and replicate the border, as in the paper.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <numbers>

namespace redrive {

using FlipColour = std::array<float, 3>;
using FlipMatrix = std::array<FlipColour, 3>;  // rows

/// Pixels per degree in the paper's viewing conditions: a 3840 pixels wide, 0.7 m wide screen at
/// 0.7 m.
constexpr double kFlipPixelsPerDegree = 3840 * std::numbers::pi / 180;

constexpr FlipColour flip_product(const FlipMatrix& m, const FlipColour& v) {
  FlipColour out{};
  for (int row = 0; row < 3; ++row)
    for (int k = 0; k < 3; ++k) out[row] += m[row][k] * v[k];
  return out;
}

/// Linear sRGB to XYZ (D65), IEC 61966-2-1.
constexpr FlipMatrix flip_xyz_from_rgb() {
  return {{{0.4124564f, 0.3575761f, 0.1804375f},
           {0.2126729f, 0.7151522f, 0.0721750f},
           {0.0193339f, 0.1191920f, 0.9503041f}}};
}

/// Inverse of flip_xyz_from_rgb, by cofactors.
constexpr FlipMatrix flip_rgb_from_xyz() {
  constexpr FlipMatrix m = flip_xyz_from_rgb();
  constexpr float determinant = m[0][0] * (m[1][1] * m[2][2] - m[2][1] * m[1][2]) -
                                m[0][1] * (m[1][0] * m[2][2] - m[2][0] * m[1][2]) +
                                m[0][2] * (m[1][0] * m[2][1] - m[2][0] * m[1][1]);
  FlipMatrix inverse{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
      inverse[i][j] = (m[a][c] * m[b][d] - m[a][d] * m[b][c]) * (1 / determinant);
    }
  return inverse;
}

constexpr FlipColour flip_white() { return flip_product(flip_xyz_from_rgb(), {1, 1, 1}); }

inline float linear_from_srgb(float x) {
  return x <= 0.04045f ? x / 12.92f : std::pow((x + 0.055f) / 1.055f, 2.4f);
}

/// Converts sRGB (clamped to [0, 1]) to YCxCz, which is linear in XYZ and may be filtered.
inline FlipColour flip_opponent(const FlipColour& srgb) {
  constexpr FlipMatrix kXyzFromRgb = flip_xyz_from_rgb();
  constexpr FlipColour kWhite = flip_white();
  FlipColour linear;
  for (int c = 0; c < 3; ++c) linear[c] = linear_from_srgb(std::clamp(srgb[c], 0.0f, 1.0f));
  const FlipColour xyz = flip_product(kXyzFromRgb, linear);
  const float x = xyz[0] / kWhite[0], y = xyz[1] / kWhite[1], z = xyz[2] / kWhite[2];
  return {116 * y - 16, 500 * (x - y), 200 * (y - z)};
}

/// Returns the achromatic channel in [0, 1].
inline float flip_luminance(const FlipColour& opponent) { return (opponent[0] + 16) / 116; }

/// Converts linear sRGB to L*a*b* with the chroma scaled by 0.01 L (Hunt effect: dark colours look
/// less colourful).
inline FlipColour flip_hunt_lab(const FlipColour& linear) {
  constexpr FlipMatrix kXyzFromRgb = flip_xyz_from_rgb();
  constexpr FlipColour kWhite = flip_white();
  constexpr float kDelta = 6.0f / 29;
  const FlipColour xyz = flip_product(kXyzFromRgb, linear);
  FlipColour f;
  for (int k = 0; k < 3; ++k) {
    const float t = xyz[k] / kWhite[k];
    f[k] = t > kDelta * kDelta * kDelta ? std::cbrt(t) : t / (3 * kDelta * kDelta) + 4.0f / 29;
  }
  const float lightness = 116 * f[1] - 16;
  return {lightness, 0.01f * lightness * 500 * (f[0] - f[1]),
          0.01f * lightness * 200 * (f[1] - f[2])};
}

inline double flip_hyab(const FlipColour& p, const FlipColour& q) {
  return std::abs(p[0] - q[0]) + std::hypot(double(p[1]) - q[1], double(p[2]) - q[2]);
}

// Section 4.1.3 and 4.2: exponents and the knee of the map of colour differences to [0, 1].
constexpr double kFlipColourExponent = 0.7, kFlipKneeAt = 0.4, kFlipKneeValue = 0.95,
                 kFlipFeatureExponent = 0.5;

/// Taps of a filter at whole pixels around its centre.
template <int radius>
using FlipTaps = std::array<float, 2 * radius + 1>;

struct FlipFilters {
  // Three standard deviations, in pixels: 3 sqrt(0.04 / (2 pi^2)) 67.02 = 9.05 for section 4.1's
  // widest Gaussian, 3 0.041 67.02 = 8.24 for features.
  static constexpr int kColourRadius = 10, kFeatureRadius = 9, kTerms = 4;

  /// Contrast sensitivity: a channel is the weighted sum of its terms, times its scale.
  struct Term {
    int channel;
    float weight;
    FlipTaps<kColourRadius> taps;  ///< along x and along y
  };
  std::array<Term, kTerms> colour;
  FlipColour scale;
  /// Edge filter (first derivative) and point filter (second derivative) along one axis; smooth
  /// along the other.
  FlipTaps<kFeatureRadius> smooth, first, second;
  double largest;  ///< the maximum colour difference: green against blue
};

/// Samples of exp(-x^2 / (2 sigma^2)) at whole pixels, scaled to sum 1; `sum` is the sum before.
template <int radius>
FlipTaps<radius> flip_gaussian(double sigma_px, double* sum) {
  FlipTaps<radius> taps;
  *sum = 0;
  for (int i = -radius; i <= radius; ++i)
    *sum += taps[i + radius] = static_cast<float>(std::exp(-0.5 * i * i / (sigma_px * sigma_px)));
  for (float& tap : taps) tap *= static_cast<float>(1 / *sum);
  return taps;
}

inline FlipFilters flip_filters() {
  FlipFilters filters{};
  // Section 4.1: contrast sensitivity as sums of Gaussians a sqrt(pi / b) exp(-pi^2 x^2 / b), x in
  // degrees.
  struct Gaussian {
    int channel;
    double a, b;
  };
  constexpr Gaussian kGaussians[] = {
      {0, 1, 0.0047}, {1, 1, 0.0053}, {2, 34.1, 0.04}, {2, 13.5, 0.025}};
  double weights[3]{};
  for (int t = 0; t < FlipFilters::kTerms; ++t) {
    const auto& [channel, a, b] = kGaussians[t];
    // exp(-pi^2 x^2 / b) is a Gaussian of sigma sqrt(b / 2) / pi degrees.
    const double sigma_px = std::sqrt(b / 2) / std::numbers::pi * kFlipPixelsPerDegree;
    double sum = 0;
    const auto taps = flip_gaussian<FlipFilters::kColourRadius>(sigma_px, &sum);
    const double weight =
        a * std::sqrt(std::numbers::pi / b) * sum * sum;  // sum of the two-dimensional kernel
    filters.colour[t] = {channel, static_cast<float>(weight), taps};
    weights[channel] += weight;
  }
  for (int c = 0; c < 3; ++c) filters.scale[c] = static_cast<float>(1 / weights[c]);

  // Section 4.2. Kernels are scaled so that their positive and their negative parts each sum to 1.
  constexpr double kFeatureWidth_deg = 0.082,
                   kSigma_px = 0.5 * kFeatureWidth_deg * kFlipPixelsPerDegree;
  constexpr int kRadius = FlipFilters::kFeatureRadius;
  double sum = 0;
  filters.smooth = flip_gaussian<kRadius>(kSigma_px, &sum);
  const auto derivative = [&](const auto& factor) {
    FlipTaps<kRadius> taps = filters.smooth;
    double positive = 0, negative = 0;
    for (int i = -kRadius; i <= kRadius; ++i) {
      float& tap = taps[i + kRadius];
      tap *= static_cast<float>(factor(i));
      (tap > 0 ? positive : negative) += tap;
    }
    for (float& tap : taps) tap = static_cast<float>(tap / (tap > 0 ? positive : -negative));
    return taps;
  };
  filters.first = derivative([](int x) { return -x; });
  filters.second = derivative([](int x) { return x * x / (kSigma_px * kSigma_px) - 1; });

  const volatile float one =
      1;  // cube roots at run time, as for pixels: a compiler's are rounded otherwise
  filters.largest = std::pow(flip_hyab(flip_hunt_lab({0, one, 0}), flip_hunt_lab({0, 0, one})),
                             kFlipColourExponent);
  return filters;
}

/// Returns the Hunt-adjusted L*a*b* of a pixel; `filtered`: its opponent channel after each term's
/// filter.
inline FlipColour flip_lab(const FlipFilters& filters,
                           const std::array<float, FlipFilters::kTerms>& filtered) {
  constexpr FlipColour kWhite = flip_white();
  constexpr FlipMatrix kRgbFromXyz = flip_rgb_from_xyz();
  FlipColour opponent{};
  for (int t = 0; t < FlipFilters::kTerms; ++t)
    opponent[filters.colour[t].channel] += filters.colour[t].weight * filtered[t];
  for (int c = 0; c < 3; ++c) opponent[c] *= filters.scale[c];
  const float y = (opponent[0] + 16) / 116;
  FlipColour linear = flip_product(kRgbFromXyz, {(y + opponent[1] / 500) * kWhite[0], y * kWhite[1],
                                                 (y - opponent[2] / 200) * kWhite[2]});
  for (float& value : linear) value = std::clamp(value, 0.0f, 1.0f);
  return flip_hunt_lab(linear);
}

/// Magnitude of a feature from its responses along x and y.
inline float flip_magnitude(float x, float y) { return std::sqrt(std::fma(x, x, y * y)); }

/// A pixel of one image after the filters.
struct FlipPixel {
  FlipColour lab;
  float edges, points;
};

/// Returns the FLIP error of a pixel in [0, 1], 0 for equal pixels.
inline double flip_difference(const FlipFilters& filters, const FlipPixel& a, const FlipPixel& b) {
  const double value = std::pow(flip_hyab(a.lab, b.lab), kFlipColourExponent),
               knee = kFlipKneeAt * filters.largest;
  const double colour = value < knee ? kFlipKneeValue / knee * value
                                     : kFlipKneeValue + (value - knee) / (filters.largest - knee) *
                                                            (1 - kFlipKneeValue);
  const double edges = std::abs(a.edges - b.edges), points = std::abs(a.points - b.points);
  const double feature =
      std::pow(std::min(1.0, std::max(edges, points) / std::numbers::sqrt2), kFlipFeatureExponent);
  return std::pow(colour, 1 - feature);
}

}  // namespace redrive
