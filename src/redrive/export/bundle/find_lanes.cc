// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/find_lanes.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <vector>

namespace redrive {
namespace {

constexpr double kStrip_m = 0.1, kPart_m = 4;
constexpr int kStrips = static_cast<int>(2 * kLanesReach_m / kStrip_m);
constexpr double kNearest_m = 0.8, kFarthest_m = 3.2, kNarrowest_m = 2.4, kWidest_m = 5;
constexpr double kWidestNeighbour_m = 4.5;
constexpr double kBrighter = 1.5, kLeastMarked = 0.25;
constexpr double kStep_m = 0.05, kLeastKerb = 0.5;
constexpr int kFewestParts = 5;
constexpr int kBeside = 3;  // strips from the middle of a marking to the ground beside it
constexpr int kAcrossStep = 2;
// Road has returns in this share of the parts, and is no brighter, darker or rougher than the
// driven lane.
constexpr double kLeastSeen = 0.5, kSameBrightness = 1.6, kRougher_m = 0.02;

using Shares = std::array<double, kStrips>;  ///< NaN: not known

double across_of(int strip) { return (strip + 0.5) * kStrip_m - kLanesReach_m; }
int strip_at(double across_m) {
  return static_cast<int>(std::floor((across_m + kLanesReach_m) / kStrip_m));
}

/// Returns the strips on a side (1: left, -1: right) whose middles are so far from the way,
/// outwards.
std::vector<int> strips_of(int side, double from_m, double to_m) {
  std::vector<int> strips;
  for (int k = 0; k < kStrips / 2; ++k) {
    const double at_m = (k + 0.5) * kStrip_m;
    if (at_m >= from_m && at_m <= to_m)
      strips.push_back(side > 0 ? kStrips / 2 + k : kStrips / 2 - 1 - k);
  }
  return strips;
}

/// Sums over the returns of the strips of a part of the way.
struct Part {
  std::array<double, kStrips> intensity{}, height{}, height_squared{};
  std::array<int, kStrips> count{};

  /// Mean of a strip with its neighbours; NaN where it has no return.
  double mean(const std::array<double, kStrips>& sums, int strip) const {
    double all = 0;
    int n = 0;
    for (int k = std::max(0, strip - 1); k <= std::min(kStrips - 1, strip + 1); ++k) {
      all += sums[k];
      n += count[k];
    }
    return n > 0 ? all / n : NAN;
  }
};

class Strips {
 public:
  explicit Strips(std::span<const WayReturn> returns) {
    for (const WayReturn& one : returns) {
      const int strip = strip_at(one.across_m);
      if (strip < 0 || strip >= kStrips) continue;
      Part& part = parts_[static_cast<int>(std::floor(one.along_m / kPart_m))];
      part.intensity[strip] += one.intensity;
      part.height[strip] += one.height_m;
      part.height_squared[strip] += one.height_m * one.height_m;
      ++part.count[strip];
    }
    markings_ = shares([](const Part& part, int strip) -> std::optional<bool> {
      const double left = part.mean(part.intensity, strip + kBeside),
                   right = part.mean(part.intensity, strip - kBeside);
      if (part.count[strip] == 0 || !(left > 0) || !(right > 0)) return std::nullopt;
      return part.intensity[strip] / part.count[strip] > kBrighter * std::max(left, right);
    });
    kerbs_ = shares([](const Part& part, int strip) -> std::optional<bool> {
      const double left = part.mean(part.height, strip + kAcrossStep),
                   right = part.mean(part.height, strip - kAcrossStep);
      if (std::isnan(left) || std::isnan(right)) return std::nullopt;
      return std::abs(left - right) > kStep_m;
    });
    for (int strip = 0; strip < kStrips; ++strip) look_at_surface(strip);
  }

  /// Returns the nearest marking, else kerb, on a side (1: left, -1: right) from `nearest_m` to
  /// `farthest_m`.
  std::optional<LaneEdge> edge(int side, double nearest_m, double farthest_m) const {
    const auto marking = nearest(markings_, kLeastMarked, side, nearest_m, farthest_m),
               kerb = nearest(kerbs_, kLeastKerb, side, nearest_m, farthest_m);
    if (marking && (!kerb || std::abs(*marking) <= std::abs(*kerb)))
      return LaneEdge{*marking, LaneEdge::Kind::kMarking};
    if (kerb) return LaneEdge{*kerb, LaneEdge::Kind::kKerb};
    return std::nullopt;
  }

  /// Returns how far the road goes on beyond an edge, up to `most_m`. `lane`: the driven one.
  double road_beyond(int side, double edge_m, double most_m, const Lanes& lane) const {
    const auto [brightness, roughness_m] = surface_between(lane);
    if (!(brightness > 0)) return 0;
    // A kerb between the way and an edge that is assumed ends the road, too.
    const double from_m = std::min(kNearest_m, std::abs(edge_m));
    for (const int strip : strips_of(side, from_m, std::abs(edge_m) + most_m)) {
      const double beyond_m = side * across_of(strip) - std::abs(edge_m);
      if (!(kerbs_[strip] < kLeastKerb)) return std::max(0.0, beyond_m);  // also where not known
      if (beyond_m < kStrip_m) continue;
      const double ratio = brightness_[strip] / brightness;
      const bool even = roughness_m_[strip] <= roughness_m + kRougher_m,
                 same = ratio <= kSameBrightness && ratio >= 1 / kSameBrightness;
      // Markings and what they brighten are passed over.
      if (seen_[strip] < kLeastSeen || !even || !(same || is_near_marking(strip))) return beyond_m;
    }
    return std::min(most_m, kLanesReach_m - std::abs(edge_m));
  }

 private:
  /// Returns the share of the parts that show a strip in which `holds`.
  template <class Holds>
  Shares shares(const Holds& holds) const {
    Shares out;
    out.fill(NAN);
    for (int strip = kBeside; strip < kStrips - kBeside; ++strip) {
      int seen = 0, all = 0;
      for (const auto& [place, part] : parts_)
        if (const std::optional<bool> one = holds(part, strip)) {
          ++seen;
          all += *one;
        }
      if (seen >= kFewestParts) out[strip] = static_cast<double>(all) / seen;  // else not known
    }
    return out;
  }

  static double median(std::vector<double> values) {
    if (values.empty()) return NAN;
    std::ranges::nth_element(values, values.begin() + std::ssize(values) / 2);
    return values[values.size() / 2];
  }

  void look_at_surface(int strip) {
    std::vector<double> brightness, roughness_m;
    for (const auto& [place, part] : parts_) {
      const int n = part.count[strip];
      if (n == 0) continue;
      const double mean = part.height[strip] / n;
      brightness.push_back(part.intensity[strip] / n);
      if (n > 2)
        roughness_m.push_back(
            std::sqrt(std::max(0.0, part.height_squared[strip] / n - mean * mean)));
    }
    seen_[strip] = static_cast<double>(brightness.size()) / std::max<double>(1, parts_.size());
    brightness_[strip] = median(brightness);
    roughness_m_[strip] = roughness_m.empty() ? 0 : median(roughness_m);
  }

  struct Surface {
    double brightness, roughness_m;
  };
  /// Medians over the strips between the edges of a lane.
  Surface surface_between(const Lanes& lane) const {
    std::vector<double> brightness, roughness_m;
    for (int strip = 0; strip < kStrips; ++strip) {
      if (across_of(strip) > lane.left.across_m || across_of(strip) < lane.right.across_m ||
          seen_[strip] < kLeastSeen)
        continue;
      brightness.push_back(brightness_[strip]);
      roughness_m.push_back(roughness_m_[strip]);
    }
    return {median(brightness), median(roughness_m)};
  }

  bool is_near_marking(int strip) const {
    const auto begin = markings_.begin() + std::max(0, strip - kBeside),
               end = markings_.begin() + std::min(kStrips, strip + kBeside + 1);
    return std::any_of(begin, end, [](double share) { return share >= kLeastMarked; });
  }

  static std::optional<double> nearest(const Shares& shares, double least, int side,
                                       double nearest_m, double farthest_m) {
    for (const int strip : strips_of(side, nearest_m, farthest_m)) {
      if (!(shares[strip] >= least)) continue;
      // The strips around it show it, too.
      double sum = 0, weights = 0;
      for (int k = strip - kBeside; k <= strip + kBeside; ++k) {
        if (k < 0 || k >= kStrips || std::isnan(shares[k])) continue;
        sum += shares[k] * across_of(k);
        weights += shares[k];
      }
      return sum / weights;
    }
    return std::nullopt;
  }

  std::map<int, Part> parts_;
  Shares markings_{}, kerbs_{};
  std::array<double, kStrips> seen_{}, brightness_{}, roughness_m_{};
};

std::optional<LaneEdge> find_neighbour(const Strips& strips, const Lanes& lanes, int side) {
  const LaneEdge& edge = side > 0 ? lanes.left : lanes.right;
  if (edge.kind == LaneEdge::Kind::kKerb) return std::nullopt;
  const double width_m = lanes.left.across_m - lanes.right.across_m,
               road_m = strips.road_beyond(side, edge.across_m, kWidestNeighbour_m, lanes);
  if (road_m < kNarrowest_m) return std::nullopt;
  const double from_m = std::abs(edge.across_m);
  if (const auto outer = strips.edge(side, from_m + kNarrowest_m,
                                     from_m + std::min(road_m + 2 * kStrip_m, kWidestNeighbour_m)))
    return outer;
  if (road_m < width_m) return std::nullopt;
  return LaneEdge{edge.across_m + side * width_m, LaneEdge::Kind::kAssumed};
}

}  // namespace

Lanes find_lanes(std::span<const WayReturn> returns) {
  const Strips strips(returns);
  Lanes lanes{{kAssumedLane_m / 2, {}}, {-kAssumedLane_m / 2, {}}, {}, {}};
  const auto left = strips.edge(1, kNearest_m, kFarthest_m),
             right = strips.edge(-1, kNearest_m, kFarthest_m);
  if (left && right && left->across_m - right->across_m >= kNarrowest_m &&
      left->across_m - right->across_m <= kWidest_m) {
    lanes.left = *left;
    lanes.right = *right;
  }
  lanes.left_neighbour = find_neighbour(strips, lanes, 1);
  lanes.right_neighbour = find_neighbour(strips, lanes, -1);
  return lanes;
}

}  // namespace redrive
