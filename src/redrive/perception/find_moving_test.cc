// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/find_moving.h"

#include <cmath>
#include <limits>
#include <optional>
#include <random>

#include <gtest/gtest.h>

#include "redrive/scene/lidar/lidar_testing.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

using Eigen::AlignedBox3d;
using Eigen::Vector3d;

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr std::int64_t kBegin_ns = 1'000'000'000;

/// Distance along a unit direction to an axis-parallel box, by the slab test.
double distance_to(const AlignedBox3d& box, const Vector3d& from, const Vector3d& direction) {
  double enter = 0, leave = kInfinity;
  for (int k = 0; k < 3; ++k) {
    const double a = (box.min()[k] - from[k]) / direction[k],
                 b = (box.max()[k] - from[k]) / direction[k];
    enter = std::max(enter, std::min(a, b));
    leave = std::min(leave, std::max(a, b));
  }
  return enter <= leave && enter > 0 ? enter : kInfinity;
}

/// A street on the plane z = 0 with house fronts along it, poles, and a hedge that stops three
/// rays of ten in each half metre. A car drives along x at 8 m/s with a LiDAR of 32 beams.
class Street {
 public:
  std::vector<AlignedBox3d> fixed = {
      {Vector3d(-50, 8, 0), Vector3d(90, 9, 12)},     // fronts
      {Vector3d(-50, -9, 0), Vector3d(90, -8, 12)},   //
      {Vector3d(20, 4, 0), Vector3d(20.1, 4.1, 5)},   // poles
      {Vector3d(30, -4, 0), Vector3d(30.1, -3.9, 5)}  //
  };
  AlignedBox3d hedge{Vector3d(35, 3, 0), Vector3d(50, 5, 2)};
  std::optional<AlignedBox3d> car;  ///< at 0 s
  Vector3d car_m_per_s = Vector3d::Zero();
  double seconds = 2.5;

  AlignedBox3d car_at(double t_s) const { return car->translated(t_s * car_m_per_s); }

  LidarReturns returns() const {
    constexpr int kBeams = 32, kSteps = 720;
    std::mt19937 random(1);
    std::uniform_real_distribution<double> unit(0, 1);
    std::normal_distribution<double> noise(0, 0.02);
    std::vector<MeasuredPoint> hits;
    for (int turn = 0; turn < static_cast<int>(10 * seconds); ++turn)
      for (int step = 0; step < kSteps; ++step)
        for (int beam = 0; beam < kBeams; ++beam) {
          const double t_s = 0.1 * (turn + double(step) / kSteps),
                       azimuth = 2 * M_PI * (step + 0.5) / kSteps,
                       elevation = (-24 + 28.0 * beam / kBeams) * M_PI / 180;
          const Vector3d from(8 * t_s, -1, 1.7),
              direction(std::cos(elevation) * std::cos(azimuth),
                        std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
          double range_m = direction.z() < 0 ? -from.z() / direction.z() : kInfinity;
          for (const AlignedBox3d& box : fixed)
            range_m = std::min(range_m, distance_to(box, from, direction));
          if (car) range_m = std::min(range_m, distance_to(car_at(t_s), from, direction));
          if (range_m > 100) continue;
          for (double in_m = distance_to(hedge, from, direction); in_m < range_m; in_m += 0.5)
            if (hedge.contains(Vector3d(from + (in_m + 1e-6) * direction)) && unit(random) < 0.3)
              range_m = in_m;
          hits.push_back(
              {from + (range_m + noise(random)) * direction, kBegin_ns + std::llround(1e9 * t_s)});
        }
    return returns_of(scene(), hits, {0, -1, 1.7});
  }
  static Scene scene() {
    Scene scene;
    for (const double t_s : {0.0, 100.0})
      scene.add_frame({static_cast<int>(t_s), kBegin_ns + std::llround(1e9 * t_s),
                       Rigid3d(Eigen::Translation3d(8 * t_s, 0, 0))});
    return scene;
  }
};

std::vector<MovingObject> found_in(const LidarReturns& returns) {
  ThreadPool pool(2);
  return find_moving_objects(Street::scene(), returns, {}, pool);
}

TEST(FindMoving, FindsNothingWhereNothingMoves) {
  Street street;
  EXPECT_TRUE(found_in(street.returns()).empty());
  street.car = AlignedBox3d(Vector3d(18, 1, 0.2), Vector3d(22, 2.8, 1.5));
  EXPECT_TRUE(found_in(street.returns()).empty()) << "a parked car";
  EXPECT_TRUE(found_in({}).empty());
}

// The car is seen from behind at first, 11 m ahead. Its rear and its left side are enclosed.
TEST(FindMoving, EnclosesWhatIsSeenOfAMovingCar) {
  Street street;
  street.car = AlignedBox3d(Vector3d(12, -2, 0.2), Vector3d(16, -0.2, 1.5));
  street.car_m_per_s = Vector3d(10, 0, 0);
  const LidarReturns returns = street.returns();
  const auto found = found_in(returns);
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].id, -1);
  EXPECT_EQ(found[0].type, "FOUND");
  EXPECT_NEAR(found[0].size_m.y(), 1.8, 0.3);
  EXPECT_GE(found[0].keys.size(), 15u);
  const MovingObjects objects(found);
  std::size_t on_car = 0, covered = 0, beside = 0;
  const Scene scene = Street::scene();
  LidarPoses poses(scene, returns);
  for (std::size_t i = 0; i < returns.n; ++i) {
    const Vector3d p = poses.in_world(i);
    const double t_s = 1e-9 * static_cast<double>(returns.t_ns[i] - 1'000'000'000);
    if (t_s < 0.6 || t_s > 1.9) continue;
    const auto boxes = objects.at(returns.t_ns[i]);
    const bool inside = !boxes.empty() && boxes[0].contains(p);
    if (street.car_at(t_s).exteriorDistance(p) < 0.1) {
      ++on_car;
      covered += inside;
    } else {
      // The margin holds some of the road.
      beside += inside && p.z() > 0.3;
    }
  }
  EXPECT_GT(on_car, 300u);
  EXPECT_GT(static_cast<double>(covered), 0.98 * static_cast<double>(on_car));
  EXPECT_EQ(beside, 0u);
  for (std::size_t k = 3; k + 3 < found[0].keys.size(); ++k)  // more of its side is seen by and by
    EXPECT_NEAR(found[0].keys[k].velocity_in_world_m_per_s.x(), 10, 2) << k;
  for (std::size_t k = 3; k + 3 < found[0].keys.size(); ++k) {
    const MovingObject::Key& key = found[0].keys[k];
    EXPECT_NEAR(key.world_from_box.translation().y(), -1.1, 0.15);
    EXPECT_GT(key.world_from_box.linear()(0, 0), std::cos(3 * M_PI / 180)) << "it drives along x";
  }
}

// What a box misses stays near it: nobody needs a second object there.
TEST(FindMoving, FindsNothingAtThePlaceOfAnAnnotatedObject) {
  Street street;
  street.car = AlignedBox3d(Vector3d(12, -2, 0.2), Vector3d(16, -0.2, 1.5));
  street.car_m_per_s = Vector3d(10, 0, 0);
  const LidarReturns returns = street.returns();
  MovingObject annotated;
  annotated.size_m = {4, 1.8, 1.3};
  for (const double t_s : {0.0, 0.5, 1.0, 1.5, 2.0, 2.5}) {
    MovingObject::Key key{1'000'000'000 + std::llround(1e9 * t_s), Rigid3d::Identity(),
                          street.car_m_per_s};
    key.world_from_box.translation() = street.car_at(t_s).center();
    annotated.keys.push_back(key);
  }
  ThreadPool pool(2);
  EXPECT_EQ(find_moving_objects(Street::scene(), returns, {}, pool).size(), 1u);
  EXPECT_TRUE(
      find_moving_objects(Street::scene(), returns, MovingObjects({annotated}), pool).empty());
}

MovingObject along_x(double from_m, double y_m, double first_s, double last_s) {
  MovingObject object;
  object.size_m = {4, 2, 1.5};
  for (double t_s = first_s; t_s < last_s + 0.05; t_s += 0.1) {
    MovingObject::Key key{std::llround(1e9 * t_s), Rigid3d::Identity(), {10, 0, 0}};
    key.world_from_box.translation() = Vector3d(from_m + 10 * t_s, y_m, 0);
    object.keys.push_back(key);
  }
  return object;
}

// Parts of a drive overlap: the object at y = 1 was found in both.
TEST(FindMoving, JoinsWhatTwoPartsOfADriveFound) {
  std::vector<MovingObject> objects;
  join_found({along_x(0, 1, 0, 2), along_x(0, 8, 0, 1)}, &objects);
  MovingObject again = along_x(0.5, 1.2, 1.5, 4);
  again.size_m = {3, 2.5, 1.5};
  join_found({along_x(0, 4, 1.5, 4), again}, &objects);
  ASSERT_EQ(objects.size(), 3u);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(objects[i].id, -1 - i);
  EXPECT_EQ(objects[0].size_m, Vector3d(4, 2.5, 1.5));
  ASSERT_EQ(objects[0].keys.size(), 41u);
  for (std::size_t k = 0; k < 41; ++k) {
    EXPECT_NEAR(1e-9 * static_cast<double>(objects[0].keys[k].t_ns), 0.1 * k, 1e-6);
    EXPECT_NEAR(objects[0].keys[k].world_from_box.translation().x(), k < 21 ? k : k + 0.5, 1e-5);
  }
  EXPECT_NEAR(objects[2].keys[0].world_from_box.translation().y(), 4, 1e-9);
}

TEST(FindMoving, DoesNotDependOnThreads) {
  Street street;
  street.car = AlignedBox3d(Vector3d(40, 1, 0.2), Vector3d(44, 2.8, 1.5));
  street.car_m_per_s = Vector3d(-9, 0, 0);
  const LidarReturns returns = street.returns();
  ThreadPool one(1);
  const auto a = find_moving_objects(Street::scene(), returns, {}, one), b = found_in(returns);
  ASSERT_GE(a.size(), 1u);
  ASSERT_EQ(a.size(), b.size());
  EXPECT_LT(a[0].keys[a[0].keys.size() / 2].velocity_in_world_m_per_s.x(), -7) << "oncoming";
  for (std::size_t i = 0; i < a.size(); ++i) {
    ASSERT_EQ(a[i].keys.size(), b[i].keys.size());
    for (std::size_t k = 0; k < a[i].keys.size(); ++k)
      EXPECT_EQ(a[i].keys[k].world_from_box.matrix(), b[i].keys[k].world_from_box.matrix());
  }
}

TEST(FindMoving, JoinsFoundObjectsAndAnnotatedOnes) {
  MovingObject annotated, found;
  annotated.id = 4;
  annotated.type = "CAR";
  found.id = -1;
  found.type = "FOUND";
  const MovingObjects all = MovingObjects(std::vector{annotated}).with({found});
  ASSERT_EQ(all.objects().size(), 2u);
  ASSERT_EQ(found_objects(all).size(), 1u);
  EXPECT_EQ(found_objects(all)[0].id, -1);
}

}  // namespace
}  // namespace redrive
