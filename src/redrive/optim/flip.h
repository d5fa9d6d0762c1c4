// SPDX-License-Identifier: Apache-2.0
// FLIP (Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", HPG 2020, LDR
// form): the perceived difference of two images when flipping between them. Here are the operations
// of one pixel in any arithmetic (math/lanes.h) and the filters' taps:
//   flip_opponent -> colour filters -> flip_lab;  Y of flip_opponent -> feature filters ->
//   flip_magnitude;  both images' -> flip_difference
// Filters are separable and replicate the border, as in the paper.
#pragma once

#include <cmath>
#include <numbers>

#include "redrive/math/lanes.h"

namespace redrive {

/// Pixels per degree in the paper's viewing conditions: a 3840 pixels wide, 0.7 m wide screen at
/// 0.7 m.
constexpr double kFlipPixelsPerDegree = 3840 * std::numbers::pi / 180;

struct FlipMatrix {
  double at[3][3];  // rows
};
/// Linear sRGB to XYZ (D65), IEC 61966-2-1.
constexpr FlipMatrix kFlipXyzFromRgb{{{0.4124564, 0.3575761, 0.1804375},
                                      {0.2126729, 0.7151522, 0.0721750},
                                      {0.0193339, 0.1191920, 0.9503041}}};
/// By cofactors.
constexpr FlipMatrix flip_inverse(const FlipMatrix& matrix) {
  const auto& m = matrix.at;
  const double determinant = m[0][0] * (m[1][1] * m[2][2] - m[2][1] * m[1][2]) -
                             m[0][1] * (m[1][0] * m[2][2] - m[2][0] * m[1][2]) +
                             m[0][2] * (m[1][0] * m[2][1] - m[2][0] * m[1][1]);
  FlipMatrix inverse{};
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) {
      const int a = (j + 1) % 3, b = (j + 2) % 3, c = (i + 1) % 3, d = (i + 2) % 3;
      inverse.at[i][j] = (m[a][c] * m[b][d] - m[a][d] * m[b][c]) / determinant;
    }
  return inverse;
}
constexpr FlipMatrix kFlipRgbFromXyz = flip_inverse(kFlipXyzFromRgb);
/// XYZ of white.
constexpr double kFlipWhite[3] = {
    kFlipXyzFromRgb.at[0][0] + kFlipXyzFromRgb.at[0][1] + kFlipXyzFromRgb.at[0][2],
    kFlipXyzFromRgb.at[1][0] + kFlipXyzFromRgb.at[1][1] + kFlipXyzFromRgb.at[1][2],
    kFlipXyzFromRgb.at[2][0] + kFlipXyzFromRgb.at[2][1] + kFlipXyzFromRgb.at[2][2]};

template <class M>
REDRIVE_LANES void flip_product(const FlipMatrix& m, const typename M::Real* v,
                                typename M::Real* out) {
  for (int row = 0; row < 3; ++row)
    out[row] = M::constant(m.at[row][0]) * v[0] + M::constant(m.at[row][1]) * v[1] +
               M::constant(m.at[row][2]) * v[2];
}

/// x^exponent for x >= 0, 0 below 1e-30.
template <class M>
REDRIVE_LANES typename M::Real flip_power(const typename M::Real& x,
                                          const typename M::Real& exponent) {
  const typename M::Real least = M::constant(1e-30);
  return M::select(x > least, M::exp(exponent * M::log(M::max(x, least))), M::constant(0));
}

template <class M>
REDRIVE_LANES typename M::Real linear_from_srgb(const typename M::Real& x) {
  return M::select(
      x > M::constant(0.04045),
      flip_power<M>((x + M::constant(0.055)) * M::constant(1 / 1.055), M::constant(2.4)),
      x * M::constant(1 / 12.92));
}

template <class M>
REDRIVE_LANES typename M::Real flip_clamped(const typename M::Real& x) {
  return M::min(M::max(x, M::constant(0)), M::constant(1));
}

/// Converts sRGB (clamped to [0, 1]) to YCxCz, which is linear in XYZ and may be filtered.
template <class M>
REDRIVE_LANES void flip_opponent(const typename M::Real* srgb, typename M::Real* opponent) {
  using Real = typename M::Real;
  Real linear[3], xyz[3];
  for (int c = 0; c < 3; ++c) linear[c] = linear_from_srgb<M>(flip_clamped<M>(srgb[c]));
  flip_product<M>(kFlipXyzFromRgb, linear, xyz);
  for (int c = 0; c < 3; ++c) xyz[c] = xyz[c] * M::constant(1 / kFlipWhite[c]);
  opponent[0] = M::constant(116) * xyz[1] - M::constant(16);
  opponent[1] = M::constant(500) * (xyz[0] - xyz[1]);
  opponent[2] = M::constant(200) * (xyz[1] - xyz[2]);
}

/// Converts linear sRGB in [0, 1] to L*a*b* with the chroma scaled by 0.01 L (Hunt effect: dark
/// colours look less colourful).
template <class M>
REDRIVE_LANES void flip_hunt_lab(const typename M::Real* linear, typename M::Real* lab) {
  using Real = typename M::Real;
  constexpr double kDelta = 6.0 / 29;
  Real xyz[3], f[3];
  flip_product<M>(kFlipXyzFromRgb, linear, xyz);
  for (int k = 0; k < 3; ++k) {
    const Real t = xyz[k] * M::constant(1 / kFlipWhite[k]);
    f[k] =
        M::select(t > M::constant(kDelta * kDelta * kDelta), flip_power<M>(t, M::constant(1.0 / 3)),
                  t * M::constant(1 / (3 * kDelta * kDelta)) + M::constant(4.0 / 29));
  }
  lab[0] = M::constant(116) * f[1] - M::constant(16);
  lab[1] = M::constant(0.01 * 500) * lab[0] * (f[0] - f[1]);
  lab[2] = M::constant(0.01 * 200) * lab[0] * (f[1] - f[2]);
}

template <class M>
REDRIVE_LANES typename M::Real flip_magnitude(const typename M::Real& x,
                                              const typename M::Real& y) {
  return M::sqrt(x * x + y * y);
}

template <class M>
REDRIVE_LANES typename M::Real flip_distance(const typename M::Real& a, const typename M::Real& b) {
  return M::max(a - b, b - a);
}

template <class M>
REDRIVE_LANES typename M::Real flip_hyab(const typename M::Real* p, const typename M::Real* q) {
  return flip_distance<M>(p[0], q[0]) + flip_magnitude<M>(p[1] - q[1], p[2] - q[2]);
}

// Section 4.1.3 and 4.2: exponents and the knee of the map of colour differences to [0, 1].
constexpr double kFlipColourExponent = 0.7, kFlipKneeAt = 0.4, kFlipKneeValue = 0.95;

/// A filter's taps at whole pixels around its centre, along one axis.
constexpr int kFlipColourRadius = 10, kFlipFeatureRadius = 9, kFlipTerms = 4;
constexpr int kFlipColourTaps = 2 * kFlipColourRadius + 1,
              kFlipFeatureTaps = 2 * kFlipFeatureRadius + 1;

// The radii are three standard deviations, in pixels: 3 sqrt(0.04 / (2 pi^2)) 67.02 = 9.05 for
// section 4.1's widest Gaussian, 3 0.041 67.02 = 8.24 for features.
struct FlipFilters {
  /// Contrast sensitivity: an opponent channel is the weighted sum of its terms.
  struct Term {
    int channel;
    float weight;
    float taps[kFlipColourTaps];  ///< along x and along y
  };
  Term colour[kFlipTerms];
  /// Edge filter (first derivative) and point filter (second derivative) of luminance along one
  /// axis; smooth along the other. Derivatives sum to 0, so they filter Y as well, 116 times as
  /// large.
  float smooth[kFlipFeatureTaps], first[kFlipFeatureTaps], second[kFlipFeatureTaps];
  double largest;  ///< the maximum colour difference: green against blue
};

/// Samples of exp(-x^2 / (2 sigma^2)) at whole pixels, scaled to sum 1; returns the sum before.
inline double flip_gaussian(double sigma_px, int radius, float* taps) {
  double sum = 0;
  for (int i = -radius; i <= radius; ++i)
    sum += taps[i + radius] = static_cast<float>(std::exp(-0.5 * i * i / (sigma_px * sigma_px)));
  for (int i = 0; i <= 2 * radius; ++i) taps[i] *= static_cast<float>(1 / sum);
  return sum;
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
  double weights[kFlipTerms], of_channel[3]{};
  for (int t = 0; t < kFlipTerms; ++t) {
    const auto& [channel, a, b] = kGaussians[t];
    // exp(-pi^2 x^2 / b) is a Gaussian of sigma sqrt(b / 2) / pi degrees.
    const double sigma_px = std::sqrt(b / 2) / std::numbers::pi * kFlipPixelsPerDegree;
    FlipFilters::Term& term = filters.colour[t];
    const double sum = flip_gaussian(sigma_px, kFlipColourRadius, term.taps);
    term.channel = channel;
    weights[t] =
        a * std::sqrt(std::numbers::pi / b) * sum * sum;  // the sum of the kernel over x and y
    of_channel[channel] += weights[t];
  }
  for (int t = 0; t < kFlipTerms; ++t)
    filters.colour[t].weight =
        static_cast<float>(weights[t] / of_channel[filters.colour[t].channel]);

  // Section 4.2. Kernels are scaled so that their positive and their negative parts each sum to 1.
  constexpr double kFeatureWidth_deg = 0.082,
                   kSigma_px = 0.5 * kFeatureWidth_deg * kFlipPixelsPerDegree;
  flip_gaussian(kSigma_px, kFlipFeatureRadius, filters.smooth);
  const auto derivative = [&](float* taps, const auto& factor) {
    double positive = 0, negative = 0;
    for (int i = 0; i < kFlipFeatureTaps; ++i) {
      taps[i] = filters.smooth[i] * static_cast<float>(factor(i - kFlipFeatureRadius));
      (taps[i] > 0 ? positive : negative) += static_cast<double>(taps[i]);
    }
    for (int i = 0; i < kFlipFeatureTaps; ++i)
      taps[i] =
          static_cast<float>(static_cast<double>(taps[i]) / (taps[i] > 0 ? positive : -negative));
  };
  derivative(filters.first, [](int x) { return -x; });
  derivative(filters.second, [](int x) { return x * x / (kSigma_px * kSigma_px) - 1; });

  using Math = NumberMath<double>;
  constexpr double kGreen[] = {0, 1, 0}, kBlue[] = {0, 0, 1};
  double green[3], blue[3];
  flip_hunt_lab<Math>(kGreen, green);
  flip_hunt_lab<Math>(kBlue, blue);
  filters.largest = std::pow(flip_hyab<Math>(green, blue), kFlipColourExponent);
  return filters;
}

/// Returns the Hunt-adjusted L*a*b* of a pixel from its opponent channels after the filters.
template <class M>
REDRIVE_LANES void flip_lab(const typename M::Real* opponent, typename M::Real* lab) {
  using Real = typename M::Real;
  const Real y = (opponent[0] + M::constant(16)) * M::constant(1.0 / 116);
  const Real xyz[3] = {(y + opponent[1] * M::constant(1.0 / 500)) * M::constant(kFlipWhite[0]),
                       y * M::constant(kFlipWhite[1]),
                       (y - opponent[2] * M::constant(1.0 / 200)) * M::constant(kFlipWhite[2])};
  Real linear[3];
  flip_product<M>(kFlipRgbFromXyz, xyz, linear);
  for (int c = 0; c < 3; ++c) linear[c] = flip_clamped<M>(linear[c]);
  flip_hunt_lab<M>(linear, lab);
}

/// A pixel of one image after the filters; edges and points are magnitudes of Y.
template <class M>
struct FlipPixel {
  typename M::Real lab[3], edges, points;
};

/// Returns the FLIP error of a pixel in [0, 1], 0 for equal pixels. largest: FlipFilters::largest.
template <class M>
REDRIVE_LANES typename M::Real flip_difference(double largest, const FlipPixel<M>& a,
                                               const FlipPixel<M>& b) {
  using Real = typename M::Real;
  const double knee = kFlipKneeAt * largest, above = (1 - kFlipKneeValue) / (largest - knee);
  const Real one = M::constant(1);
  const Real value = flip_power<M>(flip_hyab<M>(a.lab, b.lab), M::constant(kFlipColourExponent));
  const Real colour =
      M::select(value < M::constant(knee), value * M::constant(kFlipKneeValue / knee),
                M::constant(kFlipKneeValue - knee * above) + value * M::constant(above));
  const Real feature =
      M::max(flip_distance<M>(a.edges, b.edges), flip_distance<M>(a.points, b.points)) *
      M::constant(1 / (116 * std::numbers::sqrt2));
  return flip_power<M>(colour, one - M::sqrt(M::min(one, feature)));
}

}  // namespace redrive
