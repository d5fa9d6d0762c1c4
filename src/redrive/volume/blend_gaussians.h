// SPDX-License-Identifier: Apache-2.0
// Blending of projected Gaussians in one pixel, front to back, and its adjoint (Kerbl et al. 2023,
// eq. 3): rgb = sum of w_i c_i + T background, w_i = T_i alpha_i, T_{i+1} = T_i - w_i, alpha_i =
// min(kMaxAlpha, alpha of the mean times exp(-1/2 d^T conic d)); what is below kMinAlpha is not
// blended. Kernels may end once T is below kMinTransmittance; this does not.
#pragma once

#include <array>
#include <cmath>
#include <vector>

#include "redrive/base/value_of.h"
#include "redrive/field/gaussian.h"

namespace redrive {

/// A projected Gaussian as a pixel sees it.
template <class T>
struct Splat2d {
  T mean[2], conic[3], alpha;
  std::array<T, 3> rgb;
  T distance;
  double slope[2] = {0, 0};  ///< change of log distance per pixel; counts as constant
};

/// Logarithm of the distance of a Gaussian on a pixel's ray, less the logarithm at its mean.
template <class T>
double log_distance_at(const Splat2d<T>& splat, double x, double y) {
  const double off = splat.slope[0] * (x - value_of(splat.mean[0])) +
                     splat.slope[1] * (y - value_of(splat.mean[1]));
  return std::fmin(std::fmax(off, -double(kMaxLogDistance)), double(kMaxLogDistance));
}

/// Alpha of a Gaussian at a pixel before its bounds.
template <class T>
T falloff_at(const Splat2d<T>& splat, double x, double y) {
  using std::exp;
  const T dx = T(x) - splat.mean[0], dy = T(y) - splat.mean[1];
  return splat.alpha * exp(T(-0.5) * (splat.conic[0] * dx * dx + T(2) * splat.conic[1] * dx * dy +
                                      splat.conic[2] * dy * dy));
}

/// depth: distance on the ray of the Gaussian at which the transmittance falls to 1/2, or of the
/// last one: the median, which does not depend on what lies far behind.
template <class T>
struct BlendedPixel {
  std::array<T, 3> rgb{T(0), T(0), T(0)};
  T transmittance = T(1), depth = T(0), range_error = T(0);
};

/// splats: by distance. log_range: logarithm of a measured range, or below -100: none.
template <class T>
BlendedPixel<T> blend_gaussians(const std::vector<Splat2d<T>>& splats, double x, double y,
                                const float* background, double log_range) {
  using std::abs, std::exp, std::log;
  BlendedPixel<T> out;
  for (const Splat2d<T>& splat : splats) {
    const T alpha = falloff_at(splat, x, y);
    if (!(value_of(alpha) > double(kMinAlpha))) continue;
    const T w =
        out.transmittance * (value_of(alpha) < double(kMaxAlpha) ? alpha : T(double(kMaxAlpha)));
    for (int c = 0; c < 3; ++c) out.rgb[c] = out.rgb[c] + w * splat.rgb[c];
    const T log_distance = log(splat.distance) + T(log_distance_at(splat, x, y));
    if (value_of(out.transmittance) > 0.5) out.depth = exp(log_distance);
    const T off = abs(log_distance - T(log_range));
    out.range_error =
        out.range_error +
        w * (value_of(off) < double(kMaxRangeError) ? off : T(double(kMaxRangeError)));
    out.transmittance = out.transmittance - w;
  }
  for (int c = 0; c < 3; ++c)
    out.rgb[c] = out.rgb[c] + out.transmittance * T(double(background[c]));
  // The background is infinitely far.
  out.range_error = out.range_error + out.transmittance * T(double(kMaxRangeError));
  return out;
}

/// Blending weights of the parts of the Gaussians in a pixel.
struct PartWeights {
  std::vector<double> visible;  ///< [parts] sums of w; part 0, the world, has the background, too
  std::vector<double> alone;    ///< [parts] sums if no other part were there
};

/// part: the part of each splat, below `parts`.
inline PartWeights blend_parts(const std::vector<Splat2d<double>>& splats,
                               const std::vector<std::size_t>& part, std::size_t parts, double x,
                               double y) {
  PartWeights out{std::vector<double>(parts), std::vector<double>(parts)};
  double t = 1;
  for (std::size_t i = 0; i < splats.size(); ++i) {
    const double full = falloff_at(splats[i], x, y);
    if (!(full > double(kMinAlpha))) continue;
    const double alpha = std::fmin(full, double(kMaxAlpha));
    out.visible[part[i]] += t * alpha;
    out.alone[part[i]] += (1 - out.alone[part[i]]) * alpha;
    t -= t * alpha;
  }
  out.visible[0] += t;
  return out;
}

/// Derivatives of a loss by a Gaussian as pixels see it, summed over them.
struct Splat2dGradient {
  double mean[2] = {0, 0}, conic[3] = {0, 0, 0}, log_alpha = 0, rgb[3] = {0, 0, 0}, distance = 0,
         error = 0;  ///< error: sum of w times the pixel's error
};

/// Derivatives of a loss by what a pixel shows. A transmittance below kMinTransmittance counts as
/// 0.
struct BlendedPixelGradient {
  const double* rgb;  ///< [3]
  double range_error, transmittance;
};

/// Adds the derivatives of the loss to `gradients`, by splat. error: the pixel's.
inline void blend_gaussians_adjoint(const std::vector<Splat2d<double>>& splats, double x, double y,
                                    const float* background, double log_range,
                                    const BlendedPixelGradient& d_pixel, double error,
                                    std::vector<Splat2dGradient>* gradients) {
  const BlendedPixel<double> all = blend_gaussians(splats, x, y, background, log_range);
  const double *const d_rgb = d_pixel.rgb, d_range = d_pixel.range_error;
  double t = 1, behind = d_range * all.range_error;
  if (all.transmittance > double(kMinTransmittance))
    behind += d_pixel.transmittance * all.transmittance;
  for (int c = 0; c < 3; ++c) behind += d_rgb[c] * all.rgb[c];
  for (std::size_t i = 0; i < splats.size(); ++i) {
    const Splat2d<double>& splat = splats[i];
    Splat2dGradient& d = (*gradients)[i];
    const double full = falloff_at(splat, x, y);
    if (!(full > double(kMinAlpha))) continue;
    const double alpha = std::fmin(full, double(kMaxAlpha)), w = t * alpha,
                 off = std::log(splat.distance) + log_distance_at(splat, x, y) - log_range;
    double d_w = d_range * std::fmin(std::fabs(off), double(kMaxRangeError));
    for (int c = 0; c < 3; ++c) {
      d_w += d_rgb[c] * splat.rgb[c];
      d.rgb[c] += w * d_rgb[c];
    }
    if (std::fabs(off) < double(kMaxRangeError))
      d.distance += d_range * w * (off < 0 ? -1 : 1) / splat.distance;
    d.error += w * error;
    behind -= w * d_w;
    t -= w;
    if (full >= double(kMaxAlpha)) continue;
    const double by_log = (t + w) * alpha * d_w - behind * alpha / (1 - alpha);
    const double dx = x - splat.mean[0], dy = y - splat.mean[1];
    d.log_alpha += by_log;
    d.mean[0] += by_log * (splat.conic[0] * dx + splat.conic[1] * dy);
    d.mean[1] += by_log * (splat.conic[1] * dx + splat.conic[2] * dy);
    d.conic[0] -= by_log * dx * dx / 2;
    d.conic[1] -= by_log * dx * dy;
    d.conic[2] -= by_log * dy * dy / 2;
  }
}

}  // namespace redrive
