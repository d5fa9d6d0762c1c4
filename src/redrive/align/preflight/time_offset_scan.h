// SPDX-License-Identifier: Apache-2.0
// Error of a camera's images over hypothetical time offsets, its minimum, and the minimum's
// standard deviation.
#pragma once

#include <vector>

namespace redrive {

/// Least number of points for an error.
constexpr int kMinPoints = 100;

struct ScanPoint {
  double offset_ms = 0, error_px = 0;
};

/// The error of each point at each offset; offsets are evenly spaced and ascending.
struct OffsetErrors {
  std::vector<double> offsets_ms;
  std::vector<std::vector<double>> px;  ///< [offsets, points]; NaN where there is no pose
  std::vector<int> pair;  ///< [points], ascending from 0: points of the same two images
};

/// Median of a non-empty vector, which it reorders.
double median_of(std::vector<double>* values);

/// Median error at each offset over all points but the points of the pair `without`, for offsets at
/// which at least kMinPoints have poses.
std::vector<ScanPoint> error_scan(const OffsetErrors& errors, int without = -1);

/// The minimum of a non-empty scan. Its error is the least one. Its offset is the vertex of a
/// parabola fitted to the squared errors of the two neighbours and of the points around it whose
/// errors are at most an eighth larger: errors of poses and of a time offset add in squares.
ScanPoint scan_minimum(const std::vector<ScanPoint>& scan);

/// Standard deviation of that offset by the jackknife over pairs of images (Efron & Tibshirani
/// 1993, equation 11.5), since the points of two images share the errors of those images' poses;
/// infinite for less than four pairs.
double scan_minimum_sigma_ms(const OffsetErrors& errors);

}  // namespace redrive
