// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/seen_through.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <unordered_map>
#include <unordered_set>

#include "redrive/base/progress.h"
#include "redrive/math/voxel_grid.h"

namespace redrive {
namespace {

using Eigen::Vector3f;

constexpr float kLeastHeight_m = 0.3f, kMostHeight_m = 3.5f;  // above the ground
constexpr float kMostRange_m = 60, kLeastRange_m = 2;
// A ray passes through a point within this distance of it: half of that to the next ray, within
// bounds.
constexpr float kLeastThrough_m = 0.1f, kMostThrough_m = 0.25f;
constexpr float kEnded_m = 0.15f;  // a point farther from a ray's end than this was not hit by it
constexpr float kAlong_m = 0.5f;  // tolerance along a ray between its end and the point that it hit
// A ray along a wall, 0.1 m before it and at 2 degrees, ends on it 2.9 m behind the point.
constexpr float kBeyond_m = 3;
constexpr std::size_t kMostRays = 40'000;  // rays of a scan, at most; more take time
// Scans before and after that count, 0.4 s to 8 s away: slow objects leave their place later.
constexpr std::array<int, 12> kOffsets = {4, 5, 6, 8, 10, 13, 17, 22, 29, 38, 55, 80};

// Indices of all scans of a long drive would be large: only the ones that a block looks at are
// kept.
constexpr int kBlock = 32;
constexpr std::size_t kMostGroundPoints = 4'000'000;

constexpr std::int64_t kMostSweeps = 1'000'000;  // one day; anything longer has gaps or wrong times

/// Returns and their rays in the world.
struct Scans {
  const LidarReturns& returns;
  LidarRays rays;

  Vector3f end(std::size_t i) const {
    return rays.origin_at(i) + returns.range_m[i] * rays.direction_at(i);
  }
};

/// Height of the ground on a grid of 1 m.
class Ground {
 public:
  explicit Ground(const Scans& scans) {
    constexpr double kLowest = 0.05;  // echoes from below the road are fewer
    const std::size_t n = scans.returns.n, step = 1 + n / kMostGroundPoints;
    std::vector<std::pair<std::uint64_t, float>> points;
    points.reserve(n / step + 1);
    for (std::size_t i = 0; i < n; i += step) {
      const Vector3f p = scans.end(i);
      points.emplace_back(cell(p.x(), p.y()), p.z());
    }
    std::ranges::sort(points);
    for (std::size_t begin = 0, end = 0; begin < points.size(); begin = end) {
      while (end < points.size() && points[end].first == points[begin].first) ++end;
      const auto low = static_cast<std::size_t>(kLowest * static_cast<double>(end - begin));
      lowest_[points[begin].first] = points[begin + low].second;
    }
  }

  /// The lowest of the cell and its neighbours: a car may cover a whole cell.
  float under(const Vector3f& p) const {
    float z = p.z();
    for (const float dx : {-1.0f, 0.0f, 1.0f})
      for (const float dy : {-1.0f, 0.0f, 1.0f})
        if (const auto found = lowest_.find(cell(p.x() + dx, p.y() + dy)); found != lowest_.end())
          z = std::min(z, found->second);
    return z;
  }

 private:
  static std::uint64_t cell(float x, float y) { return voxel_key(voxel_of(Vector3f(x, y, 0), 1)); }
  std::unordered_map<std::uint64_t, float> lowest_;
};

/// The rays of a scan, indexed by direction.
class RayIndex {
 public:
  static constexpr int kColumns = 360, kRows = 180;  // azimuth; elevation from -45 to 45 degrees
  static constexpr float kColumn_rad = 2 * std::numbers::pi_v<float> / kColumns;
  static constexpr float kRow_rad = std::numbers::pi_v<float> / 2 / kRows;

  RayIndex() = default;
  RayIndex(const Scans& scans, const std::vector<std::uint32_t>& of_sweep) {
    const std::size_t step = 1 + of_sweep.size() / kMostRays;
    std::vector<Vector3f> origins(kColumns, Vector3f::Zero());
    std::vector<int> counts(kColumns), cells;
    begin_.assign(kColumns * kRows + 1, 0);
    for (std::size_t k = 0; k < of_sweep.size(); k += step) {
      const Vector3f origin = scans.rays.origin_at(of_sweep[k]);
      const auto [column, row] = cell(scans.rays.direction_at(of_sweep[k]));
      origins[column] += origin;
      ++counts[column];
      mean_ += origin;
      cells.push_back(std::clamp(row, 0, kRows - 1) * kColumns + column);
      ++begin_[cells.back() + 1];
    }
    if (cells.empty()) return;
    constexpr float kView = 2 * std::numbers::pi_v<float> * 0.5f;  // steradians of usual sensors
    spacing_rad_ = std::sqrt(kView / static_cast<float>(cells.size()));
    mean_ /= static_cast<float>(cells.size());
    for (int c = 0; c < kColumns; ++c)
      origins_.push_back(counts[c] > 0 ? Vector3f(origins[c] / static_cast<float>(counts[c]))
                                       : mean_);
    for (std::size_t c = 1; c < begin_.size(); ++c) begin_[c] += begin_[c - 1];
    std::vector<std::uint32_t> next(begin_.begin(), begin_.end() - 1);
    rays_.resize(cells.size());
    for (std::size_t k = 0; k < cells.size(); ++k) rays_[next[cells[k]]++] = of_sweep[k * step];
  }

  bool empty() const { return rays_.empty(); }

  /// Counts the scan's rays at the point.
  void look(const Scans& scans, SweepPoint* point) const {
    const Vector3f& p = point->in_world;
    // The sensor moves while it turns: finds where it was when it looked at the point.
    Vector3f towards = p - mean_;
    for (int k = 0; k < 3; ++k) towards = p - origins_[cell(towards).first];
    const float range_m = towards.norm();
    if (range_m < kLeastRange_m || range_m > kMostRange_m) return;
    constexpr float kMoved_m = 0.1f;  // motion of the sensor up to which rays are the same
    const float through_m = std::clamp(spacing_rad_ * range_m / 2, kLeastThrough_m, kMostThrough_m),
                ended_m = through_m + kEnded_m, across_rad = (ended_m + kMoved_m) / range_m,
                level = std::max(towards.head<2>().norm() / range_m, 0.2f);
    const auto [column, row] = cell(towards);
    const int columns = 1 + static_cast<int>(across_rad / (level * kColumn_rad)),
              rows = 1 + static_cast<int>(across_rad / kRow_rad);
    bool through = false;
    for (int r = std::max(row - rows, 0); r <= std::min(row + rows, kRows - 1); ++r)
      for (int c = column - columns; c <= column + columns; ++c) {
        const int k = r * kColumns + (c + kColumns) % kColumns;
        for (std::uint32_t i = begin_[k]; i < begin_[k + 1]; ++i) {
          const std::uint32_t ray = rays_[i];
          const Vector3f d = scans.rays.direction_at(ray), from = p - scans.rays.origin_at(ray);
          const float along_m = from.dot(d), across_m = (from - along_m * d).norm(),
                      beyond_m = scans.returns.range_m[ray] - along_m;
          if (across_m < ended_m && std::abs(beyond_m) < kAlong_m) {
            ++point->ended;
            return;
          }
          through |= across_m < through_m && beyond_m > kBeyond_m;
        }
      }
    point->through += through;
  }

 private:
  static std::pair<int, int> cell(const Vector3f& direction) {
    const float azimuth = std::atan2(direction.y(), direction.x()) + std::numbers::pi_v<float>,
                elevation = std::atan2(direction.z(), direction.head<2>().norm());
    return {std::min(static_cast<int>(azimuth / kColumn_rad), kColumns - 1),
            static_cast<int>(std::floor(elevation / kRow_rad)) + kRows / 2};
  }

  Vector3f mean_ = Vector3f::Zero();
  float spacing_rad_ = 0;             ///< angle between rays
  std::vector<Vector3f> origins_;     ///< origins of the rays of each column
  std::vector<std::uint32_t> begin_;  ///< into rays_, by cell
  std::vector<std::uint32_t> rays_;   ///< indices of returns
};

std::vector<SweepPoint> thinned(const Scans& scans, const std::vector<std::uint32_t>& of_sweep,
                                const Ground& ground) {
  std::vector<SweepPoint> points;
  std::unordered_set<std::uint64_t> taken;
  for (const std::uint32_t i : of_sweep) {
    const float range_m = scans.returns.range_m[i];
    if (range_m < kLeastRange_m || range_m > kMostRange_m) continue;
    const Vector3f p = scans.end(i);
    if (!taken.insert(voxel_key(voxel_of(p, kThinning_m))).second) continue;
    const float ground_m = ground.under(p);
    if (p.z() - ground_m < kLeastHeight_m || p.z() - ground_m > kMostHeight_m) continue;
    points.push_back({p, scans.rays.origin_at(i), scans.returns.t_ns[i], ground_m});
  }
  points.shrink_to_fit();
  return points;
}

}  // namespace

std::uint64_t search_bytes(std::uint64_t returns, std::uint64_t revolutions) {
  // bytes of a vector that grew by doubling; bytes of a ground point with a hash table cell of its
  // own
  constexpr std::uint64_t kIndex = 2 * sizeof(std::uint32_t), kRay = 6 * sizeof(float),
                          kGroundPoint = 16 + 40;
  const std::uint64_t indices = std::min<std::uint64_t>(revolutions, kBlock + 2 * kOffsets.back());
  return returns * (kIndex + kRay + sizeof(SweepPoint)) +
         std::min<std::uint64_t>(returns, kMostGroundPoints) * kGroundPoint +
         indices * (sizeof(std::uint32_t) * (kMostRays + RayIndex::kColumns * RayIndex::kRows) +
                    sizeof(Vector3f) * RayIndex::kColumns);
}

std::int64_t search_looks(std::int64_t sweeps) {
  std::int64_t looks = 0;
  for (const int offset : kOffsets) looks += 2 * std::max<std::int64_t>(sweeps - offset, 0);
  return looks;
}

std::vector<Sweep> seen_through(const Scene& scene, const LidarReturns& returns, ThreadPool& pool) {
  std::vector<Sweep> sweeps;
  if (returns.n == 0) return sweeps;
  const auto [first, last] = std::ranges::minmax(returns.t_ns);
  constexpr auto kSweep_ns = static_cast<std::int64_t>(1e9 * kSweep_s);
  if ((last - first) / kSweep_ns > kMostSweeps) return sweeps;
  sweeps.resize(static_cast<std::size_t>((last - first) / kSweep_ns) + 1);
  std::vector<std::vector<std::uint32_t>> rays(sweeps.size());
  for (std::size_t i = 0; i < returns.n; ++i)  // sweeps look at each other from one sensor's place
    if (returns.sensor_of(i) == 0)
      rays[static_cast<std::size_t>((returns.t_ns[i] - first) / kSweep_ns)].push_back(
          static_cast<std::uint32_t>(i));
  const Scans scans{returns, rays_in_world(scene, returns, pool)};
  const Ground ground(scans);
  std::vector<RayIndex> indices(sweeps.size());
  const int count = static_cast<int>(sweeps.size());
  const auto look = [&](int s) {
    std::vector<const RayIndex*> others;
    for (const int offset : kOffsets)
      for (const int other : {s - offset, s + offset})
        if (other >= 0 && other < count && !indices[other].empty())
          others.push_back(&indices[other]);
    for (SweepPoint& point : sweeps[s].points) {
      auto left = static_cast<int>(others.size());
      for (const RayIndex* other : others) {
        other->look(scans, &point);
        if (point.ended > point.through + --left) break;  // it stays, whatever the other scans see
      }
    }
  };
  int made = 0, dropped = 0;
  Progress progress("looking for moving objects in the LiDAR", count);
  for (int begin = 0; begin < count; begin += kBlock) {
    const int end = std::min(begin + kBlock, count),
              needed = std::min(end + kOffsets.back(), count);
    for (; dropped < begin - kOffsets.back(); ++dropped) indices[dropped] = {};
    pool.run(needed - made, [&](int k) {
      const int s = made + k;
      sweeps[s].points = thinned(scans, rays[s], ground);
      indices[s] = RayIndex(scans, rays[s]);
    });
    made = needed;
    pool.run(end - begin, [&](int k) {
      look(begin + k);
      progress.count();
    });
  }
  return sweeps;
}

}  // namespace redrive
