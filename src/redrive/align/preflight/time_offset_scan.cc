// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/preflight/time_offset_scan.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Dense>

namespace redrive {
namespace {

constexpr std::size_t kMinForSigma = 4;  // pairs of images
// factor of the least error: wide enough for several points, narrow enough for a parabola
constexpr double kBottom = 1.12;

}  // namespace

double median_of(std::vector<double>* values) {
  const auto at = values->begin() + static_cast<std::ptrdiff_t>((values->size() - 1) / 2);
  std::nth_element(values->begin(), at, values->end());
  return *at;
}

std::vector<ScanPoint> error_scan(const OffsetErrors& errors, int without) {
  std::vector<ScanPoint> scan;
  std::vector<double> kept;
  for (std::size_t i = 0; i < errors.offsets_ms.size(); ++i) {
    kept.clear();
    for (std::size_t p = 0; p < errors.pair.size(); ++p)
      if (errors.pair[p] != without && !std::isnan(errors.px[i][p]))
        kept.push_back(errors.px[i][p]);
    if (static_cast<int>(kept.size()) >= kMinPoints)
      scan.push_back({errors.offsets_ms[i], median_of(&kept)});
  }
  return scan;
}

ScanPoint scan_minimum(const std::vector<ScanPoint>& scan) {
  const auto best = std::ranges::min_element(scan, {}, &ScanPoint::error_px);
  ScanPoint minimum = *best;
  if (best == scan.begin() || best == scan.end() - 1) return minimum;
  auto first = best - 1, last = best + 1;
  while (first != scan.begin() && first[-1].error_px <= kBottom * best->error_px) --first;
  while (last != scan.end() - 1 && last[1].error_px <= kBottom * best->error_px) ++last;
  Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (auto p = first; p <= last; ++p) {
    const double x = p->offset_ms - best->offset_ms;
    const Eigen::Vector3d row(1, x, x * x);
    normal += row * row.transpose();
    right += row * p->error_px * p->error_px;
  }
  const Eigen::Vector3d fit = normal.ldlt().solve(right);
  if (fit[2] > 0)
    minimum.offset_ms =
        std::clamp(best->offset_ms - fit[1] / (2 * fit[2]), first->offset_ms, last->offset_ms);
  return minimum;
}

double scan_minimum_sigma_ms(const OffsetErrors& errors) {
  const int pairs = errors.pair.empty() ? 0 : errors.pair.back() + 1;
  std::vector<double> without;
  for (int pair = 0; pair < pairs; ++pair)
    if (const auto scan = error_scan(errors, pair); !scan.empty())
      without.push_back(scan_minimum(scan).offset_ms);
  if (without.size() < kMinForSigma) return std::numeric_limits<double>::infinity();
  const double n = static_cast<double>(without.size());
  double mean = 0, squares = 0;
  for (const double offset_ms : without) mean += offset_ms / n;
  for (const double offset_ms : without) squares += (offset_ms - mean) * (offset_ms - mean);
  return std::sqrt((n - 1) / n * squares);
}

}  // namespace redrive
