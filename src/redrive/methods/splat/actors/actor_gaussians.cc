// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/actors/actor_gaussians.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <optional>
#include <span>
#include <utility>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/densify_gaussians.h"
#include "redrive/methods/splat/gaussian_points.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/scene/moving_objects.h"
#include "redrive/scene/point_cloud.h"

namespace redrive {
namespace {

constexpr std::size_t kSightedPerRange = 256;
/// with fewer returns than this, as many more are put on the box
constexpr std::size_t kFewReturns = 500;
/// a point is mirrored if no return is this near to its mirror image
constexpr float kMirrorApart_m = 0.15f;

/// A training view of the object and where its camera is then.
struct Sighting {
  std::size_t view;
  std::int64_t t_ns;
  Rigid3d actor_from_camera;
};

std::vector<Sighting> sightings_of(const Scene& scene, const MovingObject& actor) {
  std::vector<Sighting> sightings;
  for (std::size_t v = 0; v < scene.views.size(); ++v) {
    const View& view = scene.views[v];
    if (view.held_out) continue;
    const std::int64_t t_ns = scene.frames[view.frame].t_ns + scene.rig[view.camera].time_offset_ns;
    if (const auto world_from_actor = actor.world_from_box(t_ns))
      sightings.push_back(
          {v, t_ns, world_from_actor->inverse(Eigen::Isometry) * scene.world_from_camera(view)});
  }
  return sightings;
}

/// Returns the colour of a point in the image nearest to t_ns that shows it past the object's core.
std::optional<Eigen::Vector3f> colour_near(const TrainingSet& data,
                                           const std::vector<Sighting>& sightings,
                                           const MovingBox& core, const Eigen::Vector3f& point,
                                           std::int64_t t_ns) {
  std::vector<std::pair<std::int64_t, std::size_t>> nearest;  // a heap
  for (std::size_t i = 0; i < sightings.size(); ++i)
    nearest.emplace_back(std::abs(sightings[i].t_ns - t_ns), i);
  for (std::ranges::make_heap(nearest, std::greater<>()); !nearest.empty(); nearest.pop_back()) {
    std::ranges::pop_heap(nearest, std::greater<>());
    const Sighting& s = sightings[nearest.back().second];
    const Camera& camera = data.scene.rig[data.scene.views[s.view].camera].camera;
    const Eigen::Vector3d eye = s.actor_from_camera.translation();
    if (core.intersects(eye, point.cast<double>() - eye, 1)) continue;
    const auto pixel =
        camera.project(s.actor_from_camera.inverse(Eigen::Isometry) * point.cast<double>());
    if (!pixel) continue;
    const auto index = pixel_index(camera.width, camera.height, *pixel);
    if (!index) continue;
    const ImagePointer image = data.images[s.view];
    if (is_visible(*image, *index)) return colour_in(*image, *index);
  }
  return std::nullopt;
}

/// A point and the time at which it was seen.
struct TimedPoint {
  Point point;
  std::int64_t t_ns;
};

/// Adds the mirror images of points that have no return nearby.
void add_mirrored(std::vector<TimedPoint>* points) {
  Points positions;
  for (const TimedPoint& p : *points) positions.push_back(p.point);
  if (positions.empty()) return;
  const PointSet set{positions};
  PointTree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  tree.buildIndex();
  const std::size_t n = points->size();
  for (std::size_t i = 0; i < n; ++i) {
    TimedPoint mirrored = (*points)[i];
    mirrored.point.position.y() *= -1;
    std::uint32_t near;
    float square;
    tree.knnSearch(mirrored.point.position.data(), 1, &near, &square);
    if (square > kMirrorApart_m * kMirrorApart_m) points->push_back(mirrored);
  }
}

/// Gives points that no image shows the colours of the nearest points that one shows. Points at the
/// same height count more than points ahead and behind, as cars are painted.
void borrow_colours(const std::vector<std::uint8_t>& seen, std::vector<TimedPoint>* points) {
  const Eigen::Vector3f scale(0.3f, 1, 2);
  Points known;
  for (std::size_t i = 0; i < points->size(); ++i)
    if (seen[i]) {
      known.push_back((*points)[i].point);
      known.back().position = known.back().position.cwiseProduct(scale);
    }
  if (known.empty()) return;
  const PointSet set{known};
  PointTree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  tree.buildIndex();
  for (std::size_t i = 0; i < points->size(); ++i) {
    if (seen[i]) continue;
    const Eigen::Vector3f at = (*points)[i].point.position.cwiseProduct(scale);
    std::uint32_t near;
    float square;
    tree.knnSearch(at.data(), 1, &near, &square);
    (*points)[i].point.rgb = known[near].rgb;
  }
}

/// Returns a point at random on the sides and the top of a box.
Eigen::Vector3f on_box(const Eigen::Vector3f& half, std::uint64_t key, std::uint64_t i) {
  Eigen::Vector3f at;
  for (int k = 0; k < 3; ++k) at[k] = half[k] * (2 * random_unit(key, 4 * i + k) - 1);
  const float areas[3] = {2 * half.y() * half.z(), 2 * half.x() * half.z(), half.x() * half.y()};
  float chosen = random_unit(key, 4 * i + 3) * (areas[0] + areas[1] + areas[2]);
  int axis = 0;
  while (axis < 2 && chosen >= areas[axis]) chosen -= areas[axis++];
  at[axis] = axis == 2 || at[axis] > 0 ? half[axis] : -half[axis];
  return at;
}

/// Appends opaque Gaussians of one colour in the core of the box. They hide what is behind from the
/// first step on: without them the world and the object's far side shine through its near side and
/// take any colours to compensate.
void append_core(const MovingBox& core, const Eigen::Vector3f& rgb, const NearestCamera& cameras,
                 GaussianList* list) {
  constexpr int kAlong[3] = {6, 3, 3};
  constexpr float kCoreOpacity = 0.95f;
  const Eigen::Vector3f half = core.half_size_m.cast<float>(),
                        side = 2 * half.cwiseQuotient(Eigen::Vector3f(6, 3, 3));
  for (int i = 0; i < kAlong[0] * kAlong[1] * kAlong[2]; ++i) {
    const Eigen::Vector3f middle(float(i % kAlong[0]) + 0.5f,
                                 float(i / kAlong[0] % kAlong[1]) + 0.5f,
                                 float(i / (kAlong[0] * kAlong[1])) + 0.5f);
    const Point point{side.cwiseProduct(middle) - half, rgb, Eigen::Vector3f::Zero()};
    list->rows.resize(list->rows.size() + kGaussianRows);
    put_gaussian(point, 0.5f * side, Eigen::Quaternionf::Identity(), kCoreOpacity,
                 cameras.distance(point.position.data()), &*(list->rows.end() - kGaussianRows));
  }
}

/// Appends black, nearly transparent Gaussians on the road around the box. They become the shadow
/// and the light of headlights that move along; without them the road would absorb both.
void append_shadow(const Eigen::Vector3f& size_m, float ahead_m, const NearestCamera& cameras,
                   GaussianList* list) {
  constexpr float kSpacing_m = 0.4f, kFlat_m = 0.02f, kAboveRoad_m = 0.05f;
  constexpr float kShadowOpacity = 0.1f;
  const Eigen::Vector2f least = -size_m.head<2>() / 2 - Eigen::Vector2f::Constant(kShadow_m),
                        most = size_m.head<2>() / 2 + Eigen::Vector2f(ahead_m, kShadow_m);
  const Eigen::Vector2i n = ((most - least) / kSpacing_m).array().ceil().cast<int>();
  const Eigen::Vector2f side = (most - least).cwiseQuotient(n.cast<float>());
  for (int i = 0; i < n.prod(); ++i) {
    const Eigen::Vector2f at =
        least +
        Eigen::Vector2f(float(i % n.x()) + 0.5f, float(i / n.x()) + 0.5f).cwiseProduct(side);
    const Point point{{at.x(), at.y(), kAboveRoad_m - size_m.z() / 2},
                      Eigen::Vector3f::Zero(),
                      Eigen::Vector3f::Zero()};
    list->rows.resize(list->rows.size() + kGaussianRows);
    put_gaussian(point, {0.5f * side.x(), 0.5f * side.y(), kFlat_m}, Eigen::Quaternionf::Identity(),
                 kShadowOpacity, cameras.distance(point.position.data()),
                 &*(list->rows.end() - kGaussianRows));
  }
}

}  // namespace

GaussianList actor_gaussians(const TrainingSet& data, const MovingObject& actor, float voxel,
                             float ahead_m, std::uint64_t key, ThreadPool& pool) {
  GaussianList list;
  const std::vector<Sighting> sightings = sightings_of(data.scene, actor);
  if (sightings.empty()) return list;
  std::vector<float> centres;
  for (const Sighting& s : sightings)
    for (int k = 0; k < 3; ++k)
      centres.push_back(static_cast<float>(s.actor_from_camera.translation()[k]));
  const NearestCamera cameras(std::move(centres));

  std::vector<TimedPoint> points;
  for (const LidarReturns::OnObject& at : data.lidar.on_objects)
    if (at.id == actor.id)
      points.push_back({{at.in_box, Eigen::Vector3f::Zero(), Eigen::Vector3f::Zero()}, at.t_ns});
  const std::size_t returns = points.size();
  add_mirrored(&points);
  const std::size_t on_returns = points.size();
  // The random ones take the times of the views in turn.
  for (std::size_t i = returns; i < kFewReturns; ++i)
    points.push_back({{on_box(0.45f * actor.size_m.cast<float>(), key, i), Eigen::Vector3f::Zero(),
                       Eigen::Vector3f::Zero()},
                      sightings[i % sightings.size()].t_ns});
  std::vector<std::uint8_t> seen(points.size());
  std::vector<std::size_t> by_time(points.size());  // so that each image is read about once
  for (std::size_t i = 0; i < points.size(); ++i) by_time[i] = i;
  std::ranges::stable_sort(by_time, {}, [&](std::size_t i) { return points[i].t_ns; });
  // The returns on what deforms lie all over its box.
  const MovingBox core{actor.id, Rigid3d::Identity(), kind_of(actor.type).core * actor.size_m / 2};
  pool.run_ranges(points.size(), kSightedPerRange, [&](std::size_t begin, std::size_t end) {
    for (const std::size_t i : std::span(by_time).subspan(begin, end - begin)) {
      Point& point = points[i].point;
      Eigen::Vector3f mirrored = point.position;
      mirrored.y() *= -1;
      auto rgb = colour_near(data, sightings, core, point.position, points[i].t_ns);
      if (!rgb) rgb = colour_near(data, sightings, core, mirrored, points[i].t_ns);
      if (!rgb) continue;
      point.rgb = *rgb;
      seen[i] = 1;
    }
  });
  if (std::ranges::find(seen, 1) == seen.end()) return list;
  borrow_colours(seen, &points);
  Points measured, random;
  for (std::size_t i = 0; i < points.size(); ++i)
    (i < on_returns ? measured : random).push_back(points[i].point);
  append_discs(one_per_voxel(measured, cameras, voxel, pool), cameras, 0.5f, kPointOpacity, pool,
               &list);
  append_discs(random, cameras, 0.5f, kRandomOpacity, pool, &list);
  if (kind_of(actor.type).core > 0) {
    Eigen::Vector3f mean = Eigen::Vector3f::Zero();
    for (const TimedPoint& p : points) mean += p.point.rgb / static_cast<float>(points.size());
    append_core(core, mean, cameras, &list);
  }
  append_shadow(actor.size_m.cast<float>(), ahead_m, cameras, &list);
  return list;
}

}  // namespace redrive
