// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/find_lanes.h"

#include <cmath>
#include <functional>
#include <vector>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"

namespace redrive {
namespace {

using Kind = LaneEdge::Kind;

/// Brightness and height of the ground.
struct Place {
  double intensity = 0, height_m = 0;
};

/// Makes returns along 80 m, with the intensity of their place, give or take 30 %, and a height,
/// give or take 1 cm.
std::vector<WayReturn> returns_of(const std::function<Place(double along, double across)>& road) {
  std::vector<WayReturn> returns;
  for (std::uint64_t i = 0; i < 80'000; ++i) {
    const double along = 80.0 * random_unit(3, 4 * i),
                 across = 2 * kLanesReach_m * (random_unit(3, 4 * i + 1) - 0.5);
    const Place place = road(along, across);
    returns.push_back({along, across, place.height_m + 0.02 * (random_unit(3, 4 * i + 3) - 0.5),
                       place.intensity * (0.7 + 0.6 * random_unit(3, 4 * i + 2))});
  }
  return returns;
}

bool is_line(double across, double at) { return std::abs(across - at) < 0.08; }
bool is_dash(double along) { return std::fmod(along, 12) < 4; }

TEST(FindLanes, FindsLinesAndDashes) {
  const Lanes lanes = find_lanes(returns_of([](double along, double across) -> Place {
    return {is_line(across, 1.45) && is_dash(along)           ? 0.5
            : is_line(across, -1.95) || is_line(across, -2.8) ? 0.4
                                                              : 0.1};
  }));
  EXPECT_EQ(lanes.left.kind, Kind::kMarking);
  EXPECT_EQ(lanes.right.kind, Kind::kMarking);
  EXPECT_NEAR(lanes.left.across_m, 1.45, 0.06);
  EXPECT_NEAR(lanes.right.across_m, -1.95, 0.06);
}

TEST(FindLanes, TakesNothingElseForEdges) {
  EXPECT_FALSE(find_lanes({}).is_measured());
  const auto measured = [](const std::function<double(double across)>& intensity) {
    return find_lanes(
               returns_of([&](double, double across) -> Place { return {intensity(across)}; }))
        .is_measured();
  };
  EXPECT_FALSE(measured([](double) { return 0.2; }));
  // bright ground beside the road
  EXPECT_FALSE(measured([](double across) { return std::abs(across) > 1.8 ? 0.6 : 0.1; }));
  // a line on one side
  EXPECT_FALSE(measured([](double across) { return is_line(across, 1.5) ? 0.6 : 0.1; }));
  // lines too far apart
  EXPECT_FALSE(measured([](double across) { return is_line(std::abs(across), 2.9) ? 0.6 : 0.1; }));
}

/// Three lanes with a crown in the middle, a kerb on the right, a verge on the left.
Place street(double along, double across) {
  Place place{0.1, -0.025 * std::abs(across)};
  if ((is_line(across, 1.6) || is_line(across, -1.6)) && is_dash(along)) place.intensity = 0.5;
  if (is_line(across, 4.8)) place.intensity = 0.5;
  if (across < -5) place.height_m += 0.12;
  if (across > 5) place.intensity = 0.35;
  return place;
}

TEST(FindLanes, FindsNeighboursUpToMarkingsAndKerbs) {
  const Lanes lanes = find_lanes(returns_of(street));
  ASSERT_TRUE(lanes.is_measured());
  ASSERT_TRUE(lanes.left_neighbour);
  EXPECT_EQ(lanes.left_neighbour->kind, Kind::kMarking);
  EXPECT_NEAR(lanes.left_neighbour->across_m, 4.8, 0.06);
  ASSERT_TRUE(lanes.right_neighbour);
  EXPECT_EQ(lanes.right_neighbour->kind, Kind::kKerb);
  EXPECT_NEAR(lanes.right_neighbour->across_m, -5, 0.1);
}

TEST(FindLanes, AKerbIsAnEdgeWithoutALaneBeyond) {
  const Lanes lanes = find_lanes(returns_of([](double along, double across) {
    Place place = street(along, across);
    if (across < -2) place.height_m += 0.1;
    return place;
  }));
  EXPECT_EQ(lanes.right.kind, Kind::kMarking);
  EXPECT_FALSE(lanes.right_neighbour) << "a kerb 0.4 m beyond the line";
  const Lanes unmarked = find_lanes(returns_of([](double along, double across) {
    return Place{is_line(across, 1.6) && is_dash(along) ? 0.5 : 0.1, across < -1.8 ? 0.1 : 0};
  }));
  EXPECT_EQ(unmarked.right.kind, Kind::kKerb);
  EXPECT_NEAR(unmarked.right.across_m, -1.8, 0.1);
  EXPECT_FALSE(unmarked.right_neighbour);
  ASSERT_TRUE(unmarked.left_neighbour);
  EXPECT_EQ(unmarked.left_neighbour->kind, Kind::kAssumed) << "as wide as the driven one";
  EXPECT_NEAR(unmarked.left_neighbour->across_m, 1.6 + 3.4, 0.15);
}

// A pavement is no lane: behind a kerb where no edge was found on the other side, beside a line,
// and where the road is too short to tell kerbs.
TEST(FindLanes, NoLaneBehindAKerb) {
  const auto right = [](double kerb_m, double line_m, double most_m) {
    std::vector<WayReturn> returns = returns_of([&](double, double across) {
      return Place{is_line(across, line_m) ? 0.5 : 0.1, across < kerb_m ? 0.12 : 0};
    });
    std::erase_if(returns, [&](const WayReturn& one) { return one.along_m > most_m; });
    return find_lanes(returns).right_neighbour.has_value();
  };
  EXPECT_FALSE(right(-1.3, 5, 80));
  EXPECT_FALSE(right(-1.75, -1.6, 80));
  EXPECT_FALSE(right(-2.5, 5, 14)) << "three parts";
  EXPECT_TRUE(right(-7, 5, 80)) << "no kerb near";
}

TEST(FindLanes, OtherGroundIsNoLane) {
  const auto left = [](const Place& beyond, double rough_m) {
    return find_lanes(returns_of([&](double along, double across) {
             Place place = street(along, across);
             if (across > 1.8)
               place = {beyond.intensity, beyond.height_m + rough_m * std::sin(40 * along)};
             return place;
           }))
        .left_neighbour.has_value();
  };
  EXPECT_TRUE(left({0.1, 0}, 0)) << "road";
  EXPECT_FALSE(left({0.3, 0}, 0)) << "brighter";
  EXPECT_FALSE(left({0.1, 0}, 0.08)) << "rough, as grass";
  EXPECT_FALSE(find_lanes({}).left_neighbour);
}

}  // namespace
}  // namespace redrive
