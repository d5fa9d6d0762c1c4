// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/fill_ground.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "redrive/base/error.h"

namespace redrive {
namespace {

// The ground is searched this far below and above the body's origin, wherever a format puts that.
constexpr double kLowest_m = -3, kHighest_m = 1;
constexpr double kSameGround_m = 0.5;  // covers a kerb, or a slope to the side
// A filled point counts this little, relative to an image's.
constexpr float kFilledWeight = 1e-6f;

using Column = std::array<int, 2>;  // x, y; ordered, so that results do not depend on hashes

/// Height of the ground and its colour, which are continued into gaps.
using Ground = Eigen::Vector4d;

constexpr Column kNeighbours[] = {{-1, -1}, {-1, 0}, {-1, 1}, {0, -1},
                                  {0, 1},   {1, -1}, {1, 0},  {1, 1}};
Column operator+(const Column& a, const Column& b) { return {a[0] + b[0], a[1] + b[1]}; }

/// Returns the body's height at each column of the corridor in which the volume has blocks: the
/// height at the nearest position.
std::map<Column, double> corridor(std::span<const Eigen::Vector3d> driven,
                                  const TsdfVolume& volume) {
  const double voxel_m = volume.voxel_m();
  std::set<Column> of_blocks;  // their first columns
  for (const auto& block : volume.blocks()) of_blocks.insert({block->first.x(), block->first.y()});
  const auto has_block = [&](const Column& column) {
    constexpr int kSide = TsdfBlock::kSide;
    return of_blocks.contains({column[0] & -kSide, column[1] & -kSide});  // rounds down
  };
  struct Nearest {
    double distance_squared, height;
  };
  std::map<Column, Nearest> nearest;
  const int reach = static_cast<int>(kGroundCorridor_m / voxel_m);
  const auto add = [&](const Eigen::Vector3d& position) {
    const Column centre = {static_cast<int>(std::lround(position.x() / voxel_m)),
                           static_cast<int>(std::lround(position.y() / voxel_m))};
    for (int i = -reach; i <= reach; ++i)
      for (int j = -reach; j <= reach; ++j) {
        const double squared = static_cast<double>(i) * i + static_cast<double>(j) * j;
        const Column column = centre + Column{i, j};
        if (squared > static_cast<double>(reach) * reach || !has_block(column)) continue;
        Nearest& here = nearest.try_emplace(column, Nearest{1e30, 0}).first->second;
        if (squared < here.distance_squared) here = {squared, position.z()};
      }
  };
  constexpr double kStep_m = 0.5;
  Eigen::Vector3d last = driven.front();
  add(last);
  for (const Eigen::Vector3d& position : driven) {
    const Eigen::Vector3d from = last;
    const int parts = static_cast<int>((position - from).norm() / kStep_m);  // 0: the car stands
    for (int part = 1; part <= parts; ++part) {
      last = from + part * (position - from) / parts;
      add(last);
    }
  }
  std::map<Column, double> heights;
  for (const auto& [column, here] : nearest) heights[column] = here.height;
  return heights;
}

/// Returns the surfaces of a column that face up, between two heights, lowest first.
std::vector<Ground> surfaces(const TsdfVolume& volume, const Column& column, double low_m,
                             double high_m) {
  std::vector<Ground> found;
  TsdfVolume::Point below{nullptr, 0};
  for (int z = static_cast<int>(std::floor(low_m / volume.voxel_m()));
       z * volume.voxel_m() <= high_m; ++z) {
    const TsdfVolume::Point here = volume.find({column[0], column[1], z});
    if (here.known() && below.known() && below.distance_m() < 0 && here.distance_m() >= 0) {
      const double fraction = static_cast<double>(below.distance_m()) /
                              static_cast<double>(below.distance_m() - here.distance_m());
      const auto& rgb = here.block->rgb[here.offset];
      found.emplace_back((z - 1 + fraction) * volume.voxel_m(), rgb[0], rgb[1], rgb[2]);
    }
    below = here;
  }
  return found;
}

std::map<Column, Ground> find_ground(const TsdfVolume& volume,
                                     const std::map<Column, double>& body_m) {
  std::map<Column, std::vector<Ground>> candidates;
  std::vector<double> lowest_m;  // surfaces of columns, above the body
  for (const auto& [column, height] : body_m) {
    std::vector<Ground> found = surfaces(volume, column, height + kLowest_m, height + kHighest_m);
    if (found.empty()) continue;
    lowest_m.push_back(found.front()[0] - height);
    candidates.emplace(column, std::move(found));
  }
  std::map<Column, Ground> ground;
  if (lowest_m.empty()) return ground;
  const auto middle = lowest_m.begin() + static_cast<std::ptrdiff_t>(lowest_m.size() / 2);
  std::ranges::nth_element(lowest_m, middle);
  for (const auto& [column, found] : candidates) {
    const double expected = body_m.at(column) + *middle;
    const Ground& nearest = *std::ranges::min_element(
        found, {}, [&](const Ground& g) { return std::abs(g[0] - expected); });
    if (std::abs(nearest[0] - expected) <= kSameGround_m) ground.emplace(column, nearest);
  }
  return ground;
}

/// Returns the mean of the neighbours that are in `ground`, if there are any.
std::optional<Ground> mean_around(const Column& column, const std::map<Column, Ground>& ground) {
  Ground sum = Ground::Zero();
  int n = 0;
  for (const Column& to : kNeighbours)
    if (const auto found = ground.find(column + to); found != ground.end()) {
      sum += found->second;
      ++n;
    }
  if (n == 0) return std::nullopt;
  return sum / n;
}

/// Repeatedly replaces the columns' ground by the mean of their neighbours.
void relax(const std::vector<Column>& columns, int times, std::map<Column, Ground>* ground) {
  struct Around {
    Ground* own;
    std::vector<const Ground*> neighbours;
  };
  std::vector<Around> all;
  for (const Column& column : columns) {
    Around& around = all.emplace_back(Around{&ground->at(column), {}});
    for (const Column& to : kNeighbours)
      if (const auto found = ground->find(column + to); found != ground->end())
        around.neighbours.push_back(&found->second);
  }
  for (int n = 0; n < times; ++n)
    for (const Around& around : all) {
      Ground sum = Ground::Zero();
      for (const Ground* neighbour : around.neighbours) sum += *neighbour;
      *around.own = sum / static_cast<double>(around.neighbours.size());
    }
}

/// Adds the closing of the ground by a square of 2 `radius` + 1 columns. Returns what was added.
std::vector<Column> close_gaps(int radius, std::map<Column, Ground>* ground) {
  std::map<Column, Ground> wider = *ground;
  std::set<Column> edge;  // columns of `wider` that were added last
  const auto free_around = [&](const Column& column, std::set<Column>* free) {
    for (const Column& to : kNeighbours)
      if (!wider.contains(column + to)) free->insert(column + to);
  };
  std::set<Column> next;
  for (const auto& [column, of] : *ground) free_around(column, &next);
  for (int n = 0; n < radius; ++n) {
    edge.swap(next);
    std::vector<std::pair<Column, Ground>> layer;
    for (const Column& column : edge) layer.emplace_back(column, *mean_around(column, wider));
    wider.insert(layer.begin(), layer.end());
    next.clear();
    for (const Column& column : edge) free_around(column, &next);
  }
  // Erosion: `next` has the columns outside.
  for (int n = 0; n < radius; ++n) {
    std::set<Column> inside;
    for (const Column& column : next)
      for (const Column& to : kNeighbours)
        if (wider.contains(column + to)) inside.insert(column + to);
    for (const Column& column : inside) wider.erase(column);
    next.swap(inside);
  }
  std::vector<Column> added;
  for (const auto& [column, of] : wider)
    if (!ground->contains(column)) added.push_back(column);
  for (const Column& column : added) ground->emplace(column, wider.at(column));
  relax(added, 4 * radius, ground);
  return added;
}

/// Completes a column around its ground. A gap gets the union with the ground: an image that looked
/// through it, at a reflection in a puddle, was wrong.
void write_ground(bool gap, const Column& column, const Ground& ground, TsdfVolume* volume) {
  const double voxel_m = volume->voxel_m(), truncation_m = volume->truncation_m();
  for (int z = static_cast<int>(std::ceil((ground[0] - truncation_m) / voxel_m));
       z * voxel_m <= ground[0] + truncation_m; ++z) {
    const TsdfVolume::Point point = volume->add({column[0], column[1], z});
    const auto distance_m = static_cast<float>(z * voxel_m - ground[0]);
    if (point.known() && !(gap && distance_m < point.distance_m())) continue;
    point.block->distance_m[point.offset] = distance_m;
    point.block->weight[point.offset] = kFilledWeight;
    for (int c = 0; c < 3; ++c)
      point.block->rgb[point.offset][c] = static_cast<float>(ground[c + 1]);
    point.block->rgb_weight[point.offset] = kFilledWeight;
  }
}

}  // namespace

std::size_t fill_ground(std::span<const Eigen::Vector3d> driven, TsdfVolume* volume) {
  REDRIVE_CHECK(!driven.empty());
  std::map<Column, Ground> ground = find_ground(*volume, corridor(driven, *volume));
  const int radius = static_cast<int>(std::ceil(0.5 * kGroundGap_m / volume->voxel_m()));
  const std::vector<Column> added = close_gaps(radius, &ground);
  const std::set<Column> gaps(added.begin(), added.end());
  for (const auto& [column, of] : ground) write_ground(gaps.contains(column), column, of, volume);
  return added.size();
}

}  // namespace redrive
