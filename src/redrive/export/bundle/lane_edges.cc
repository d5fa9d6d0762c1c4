// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/lane_edges.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

namespace redrive {
namespace {

constexpr double kStrip_m = 0.1, kPart_m = 4, kReach_m = 4;
constexpr int kStrips = static_cast<int>(2 * kReach_m / kStrip_m);
constexpr double kNearest_m = 0.8, kFarthest_m = 3.2, kNarrowest_m = 2.4, kWidest_m = 5;
constexpr double kBrighter = 1.5, kLeastShare = 0.25;
constexpr int kFewestParts = 5;
constexpr int kBeside = 3;  // strips from the middle of a marking to the ground beside it

/// Mean intensities of the strips of a part of the way.
struct Part {
  std::array<double, kStrips> sum{};
  std::array<int, kStrips> count{};

  /// Mean of a strip with its neighbours; 0 where it has no return.
  double mean(int strip) const {
    double all = 0;
    int n = 0;
    for (int k = std::max(0, strip - 1); k <= std::min(kStrips - 1, strip + 1); ++k) {
      all += sum[k];
      n += count[k];
    }
    return n > 0 ? all / n : 0;
  }
};

/// Returns the share of the parts in which a strip is brighter than both sides.
std::array<double, kStrips> shares_of_marked_parts(const std::map<int, Part>& parts) {
  std::array<double, kStrips> shares{};
  for (int strip = kBeside; strip < kStrips - kBeside; ++strip) {
    int seen = 0, marked = 0;
    for (const auto& [place, part] : parts) {
      const double left = part.mean(strip + kBeside), right = part.mean(strip - kBeside);
      if (part.count[strip] == 0 || left <= 0 || right <= 0) continue;
      ++seen;
      marked += part.sum[strip] / part.count[strip] > kBrighter * std::max(left, right);
    }
    if (seen >= kFewestParts) shares[strip] = static_cast<double>(marked) / seen;
  }
  return shares;
}

/// Returns the place of the nearest marking on a side (1: left, -1: right).
std::optional<double> nearest_marking(const std::array<double, kStrips>& shares, int side) {
  const auto across = [](int strip) { return (strip + 0.5) * kStrip_m - kReach_m; };
  for (double at = kNearest_m; at <= kFarthest_m; at += kStrip_m) {
    const int strip = static_cast<int>(std::floor((side * at + kReach_m) / kStrip_m));
    if (shares[strip] < kLeastShare) continue;
    // The marking's strips around it.
    double sum = 0, weights = 0;
    for (int k = strip - kBeside; k <= strip + kBeside; ++k) {
      if (k < 0 || k >= kStrips) continue;
      sum += shares[k] * across(k);
      weights += shares[k];
    }
    return sum / weights;
  }
  return std::nullopt;
}

}  // namespace

std::optional<LaneEdges> find_lane_edges(std::span<const WayReturn> returns) {
  std::map<int, Part> parts;
  for (const WayReturn& one : returns) {
    const int strip = static_cast<int>(std::floor((one.across_m + kReach_m) / kStrip_m));
    if (strip < 0 || strip >= kStrips) continue;
    Part& part = parts[static_cast<int>(std::floor(one.along_m / kPart_m))];
    part.sum[strip] += one.intensity;
    ++part.count[strip];
  }
  const std::array<double, kStrips> shares = shares_of_marked_parts(parts);
  const auto left = nearest_marking(shares, 1), right = nearest_marking(shares, -1);
  if (!left || !right || *left - *right < kNarrowest_m || *left - *right > kWidest_m)
    return std::nullopt;
  return LaneEdges{*left, *right};
}

}  // namespace redrive
