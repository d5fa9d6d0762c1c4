// SPDX-License-Identifier: Apache-2.0
// How well a camera's images agree with the poses if they were exposed earlier or later than
// recorded, where that is best, and how sure.
#pragma once

#include <vector>

namespace redrive {

/// Fewer points say nothing.
constexpr int kMinPoints = 100;

struct ScanPoint {
  double offset_ms = 0, error_px = 0;
};

/// By offset, evenly spaced and ascending, the error of each point.
struct OffsetErrors {
  std::vector<double> offsets_ms;
  std::vector<std::vector<double>> px;  ///< [offsets, points]; NaN where there is no pose
  std::vector<int> pair;  ///< [points], ascending from 0: points of the same two images
};

/// Of values that are not empty; reorders them.
double median_of(std::vector<double>* values);

/// Medians by offset, of all points but those of the pair `without`; none for offsets at which less
/// than kMinPoints have poses.
std::vector<ScanPoint> error_scan(const OffsetErrors& errors, int without = -1);

/// Where a scan, not empty, is least: the error of its least point; the offset by a parabola fitted
/// to the squares of the errors around that point that are at most an eighth larger, and of the two
/// beside it. (Errors of the poses and of a time offset add up in squares.)
ScanPoint scan_minimum(const std::vector<ScanPoint>& scan);

/// Standard deviation of that offset by the jackknife over pairs of images (Efron & Tibshirani
/// 1993, equation 11.5), since the points of two images share the errors of those images' poses;
/// infinite for less than four pairs.
double scan_minimum_sigma_ms(const OffsetErrors& errors);

}  // namespace redrive
