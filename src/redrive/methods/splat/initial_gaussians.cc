// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/initial_gaussians.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>

#include <Eigen/Geometry>

#include "redrive/base/rng.h"
#include "redrive/methods/splat/gaussian_points.h"
#include "redrive/methods/splat/lidar/rays_beyond.h"
#include "redrive/methods/splat/visual_hull.h"
#include "redrive/perception/track_points.h"
#include "redrive/scene/lidar/lidar_points.h"

namespace redrive {
namespace {

/// Returns this high above the lowest camera are extruded, by up to kExtrusion_m.
constexpr float kExtrudedFrom_m = 0.5f, kExtrusion_m = 9;
constexpr float kFar = 6;             ///< radius of the sky, in distances of the scene's points
constexpr float kSkyBelow = 0.03f;    ///< the sky of a drive ends this far below the horizon (sine)
constexpr double kShareOfMost = 0.6;  ///< maximum share of max_gaussians for one kind of points
/// standard deviation, as a part of the distance to the nearest points
constexpr float kPointSize = 0.5f;
/// Opacity of points that may be floaters: points of image tracks near occlusion boundaries, and
/// points above returns. Training fits the background through them and removes them.
constexpr float kUncertainOpacity = 0.1f;
constexpr float kUnseenOpacity = 0.9f;   ///< opacity of returns that no image sees
constexpr float kTrackPointSize = 0.3f;  ///< smaller than kPointSize for the same reason

Points points_of(const PointCloud& cloud) {
  Points points(cloud.n);
  for (std::size_t i = 0; i < cloud.n; ++i)
    for (int k = 0; k < 3; ++k) {
      points[i].position[k] = cloud.position[k * cloud.n + i];
      points[i].rgb[k] = cloud.rgb[k * cloud.n + i];
      points[i].seen_from[k] = cloud.seen_from[k * cloud.n + i];
    }
  return points;
}

/// Finds the LiDAR returns that no image shows: they have no colour.
Points unseen_returns(const TrainingSet& data, const PointCloud& seen) {
  Points points;
  const std::vector<float> full = data.lidar.full_intensities();
  LidarPoses poses(data.scene, data.lidar);
  std::size_t next = 0;
  for (std::size_t i = 0; i < data.lidar.n; ++i) {
    if (next < seen.n && seen.source[next] == i) {
      ++next;
      continue;
    }
    points.push_back({poses.in_world(i).cast<float>(), Eigen::Vector3f::Constant(0.5f),
                      poses.at(i).translation().cast<float>(), data.lidar.intensity_of(i, full)});
  }
  return points;
}

/// Returns one point of each voxel, at most `most`: takes fewer and larger voxels rather than some
/// of the small ones with holes between them.
Points thinned(const Points& points, const NearestCamera& cameras, float voxel, double most,
               ThreadPool& pool) {
  Points kept = one_per_voxel(points, cameras, voxel, pool);
  while (static_cast<double>(kept.size()) > most) {
    voxel *= static_cast<float>(1.05 * std::sqrt(static_cast<double>(kept.size()) / most));
    kept = one_per_voxel(kept, cameras, voxel, pool);
  }
  return kept;
}

/// Sets what the scans' rays that pass the points tell; nothing for a cloud.
void set_beyond(const TrainingSet& data, ThreadPool& pool, Points* points) {
  if (data.lidar.scan_ends.empty()) return;
  std::vector<Eigen::Vector3f> positions;
  for (const Point& point : *points) positions.push_back(point.position);
  const std::vector<float> shares = shares_beyond(data.scene, data.lidar, positions, pool);
  for (std::size_t i = 0; i < points->size(); ++i) (*points)[i].beyond = shares[i];
}

/// Moves track points along their rays onto the planes of LiDAR returns around them: returns are
/// more exact, tracks denser. Points without returns nearby, or far from their plane, stay.
void move_onto_planes(const Points& returns, const NearestCamera& cameras, ThreadPool& pool,
                      Points* points) {
  constexpr std::size_t kPlaneReturns = 8;
  constexpr float kNear = 0.05f;      // part of the distance: the returns lie around the point
  constexpr float kMoved = 0.05f;     // largest part of the distance that it moves along the ray
  constexpr double kThickness = 0.1;  // thickness of a plane, as a part of its smaller extent
  if (returns.size() < kPlaneReturns) return;
  const PointSet set{returns};
  PointTree tree(3, set, nanoflann::KDTreeSingleIndexAdaptorParams(16));
  tree.buildIndex();
  pool.run_ranges(points->size(), kPointsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      Point& point = (*points)[i];
      const float distance = cameras.distance(point.position.data());
      std::array<std::uint32_t, kPlaneReturns> near;
      std::array<float, kPlaneReturns> squares;
      tree.knnSearch(point.position.data(), kPlaneReturns, near.data(), squares.data());
      if (squares.back() > std::pow(std::max(kNear * distance, 0.3f), 2)) continue;
      const PlaneFit plane = plane_of(returns, near);
      if (plane.variance[0] > kThickness * kThickness * plane.variance[1]) continue;
      const Eigen::Vector3f mean = plane.mean.cast<float>(), normal = plane.normal().cast<float>(),
                            ray = point.position - point.seen_from;
      const float along = normal.dot(ray);
      if (std::fabs(along) < 1e-3f * ray.norm()) continue;
      // as a part of the ray's length
      const float change = normal.dot(mean - point.position) / along;
      if (std::fabs(change) < kMoved) point.position += change * ray;
    }
  });
}

/// Returns some of the points high above the cameras once more, further up: facades and trees reach
/// above what the LiDAR hits.
Points extruded(const Points& points, const Scene& scene, float fraction, std::uint64_t key) {
  Points out;
  float lowest = std::numeric_limits<float>::max();
  for (const View& view : scene.views)
    lowest = std::min(lowest, static_cast<float>(scene.world_from_camera(view).translation().z()));
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (points[i].position.z() < lowest + kExtrudedFrom_m) continue;
    if (random_unit(key, 2 * i) >= fraction) continue;
    out.push_back(points[i]);
    out.back().position.z() += kExtrusion_m * random_unit(key, 2 * i + 1);
  }
  return out;
}

/// Returns points where an image shows none of `points`: in each empty cell one at the distance of
/// the nearest cell with points. Walls without texture have no tracks.
Points points_between(const TrainingSet& data, const Points& points, ThreadPool& pool) {
  constexpr int kCell = 16;  // pixels
  constexpr std::size_t kMostViews = 48;
  const std::size_t n = data.scene.views.size(), every = (n + kMostViews - 1) / kMostViews;
  std::vector<Points> of_view((n + every - 1) / every);
  pool.run(static_cast<int>(of_view.size()), [&](int chunk) {
    const std::size_t v = chunk * every;
    const View& view = data.scene.views[v];
    if (view.held_out) return;
    const Camera& camera = data.scene.rig[view.camera].camera;
    const Rigid3d world_from_camera = data.scene.world_from_camera(view),
                  camera_from_world = world_from_camera.inverse(Eigen::Isometry);
    const int across = (camera.width + kCell - 1) / kCell,
              down = (camera.height + kCell - 1) / kCell;
    const ImagePointer image = data.images[v];
    std::vector<float> distance(static_cast<std::size_t>(across) * down);  // 0: empty
    for (const Point& point : points) {
      const Eigen::Vector3d at = camera_from_world * point.position.cast<double>();
      const auto pixel = camera.project(at);
      if (!pixel || !static_pixel(*image, *pixel)) continue;
      float& nearest = distance[static_cast<int>(pixel->y() + 0.5) / kCell * across +
                                static_cast<int>(pixel->x() + 0.5) / kCell];
      const auto here = static_cast<float>(at.norm());
      if (nearest == 0 || here < nearest) nearest = here;
    }
    // Breadth first from the cells with points.
    std::vector<int> queue;
    for (int i = 0; i < across * down; ++i)
      if (distance[i] > 0) queue.push_back(i);
    for (std::size_t head = 0, seeds = queue.size(); head < queue.size(); ++head) {
      const int i = queue[head], x = i % across, y = i / across;
      const int next[4] = {x > 0 ? i - 1 : i, x + 1 < across ? i + 1 : i, y > 0 ? i - across : i,
                           y + 1 < down ? i + across : i};
      for (const int j : next)
        if (distance[j] == 0) {
          distance[j] = distance[i];
          queue.push_back(j);
        }
      if (head < seeds) continue;
      const Eigen::Vector2d pixel(std::min(x * kCell + kCell / 2, camera.width - 1),
                                  std::min(y * kCell + kCell / 2, camera.height - 1));
      const auto index = static_pixel(*image, pixel);
      const auto direction = camera.unproject(pixel);
      if (!index || !direction) continue;
      of_view[chunk].push_back(
          {(world_from_camera * (double(distance[i]) * *direction)).cast<float>(),
           colour_in(*image, *index), world_from_camera.translation().cast<float>()});
    }
  });
  Points all;
  for (const Points& part : of_view) all.insert(all.end(), part.begin(), part.end());
  return all;
}

/// Returns the colour of each point in the first training view that sees it, or nothing. The search
/// for point i starts at view i * step and wraps around.
std::vector<std::optional<Eigen::Vector3f>> colours_of(
    const TrainingSet& data, const std::vector<Eigen::Vector3f>& positions, std::size_t step,
    ThreadPool& pool) {
  const std::size_t n = data.scene.views.size(),
                    at_once = 4 * static_cast<std::size_t>(pool.threads());
  std::vector<std::optional<Eigen::Vector3f>> colours(positions.size());
  std::vector<std::vector<std::size_t>> of_first(n);  // points by their first view
  for (std::size_t i = 0; i < positions.size(); ++i) of_first[i * step % n].push_back(i);
  std::vector<std::size_t> left;  // begun and without a colour
  // Passes through the views twice, so that few images are needed at a time.
  std::vector<std::vector<std::pair<std::size_t, Eigen::Vector3f>>> seen(at_once);
  for (std::size_t turn = 0; turn < 2 * n; turn += at_once) {
    for (std::size_t v = turn; v < std::min(turn + at_once, n); ++v)
      left.insert(left.end(), of_first[v].begin(), of_first[v].end());
    pool.run(static_cast<int>(at_once), [&](int chunk) {
      seen[chunk].clear();
      const std::size_t here = turn + static_cast<std::size_t>(chunk);
      const View& view = data.scene.views[here % n];
      if (view.held_out || here >= 2 * n) return;
      const Camera& camera = data.scene.rig[view.camera].camera;
      const Rigid3d camera_from_world = data.scene.world_from_camera(view).inverse();
      ImagePointer image;  // loaded once it is needed
      for (const std::size_t i : left) {
        const std::size_t first = i * step % n;
        if (here < first || here >= first + n) continue;
        const auto pixel = camera.project(camera_from_world * positions[i].cast<double>());
        if (!pixel) continue;
        const auto index = pixel_index(camera.width, camera.height, *pixel);
        if (!index) continue;
        if (!image) image = data.images[here % n];
        if (is_static(*image, *index)) seen[chunk].emplace_back(i, colour_in(*image, *index));
      }
    });
    for (const auto& of_view : seen)
      for (const auto& [i, rgb] : of_view)
        if (!colours[i]) colours[i] = rgb;
    std::erase_if(left, [&](std::size_t i) { return colours[i].has_value(); });
  }
  return colours;
}

/// Returns the Gaussians that a view sees on a sphere around the scene. Fibonacci's lattice has n
/// places there.
GaussianList visible_sphere(const TrainingSet& data, const Eigen::Vector3f& centre, float radius,
                            int n, bool whole, ThreadPool& pool) {
  GaussianList list;
  const float lowest = whole ? -1 : -kSkyBelow;
  const float side = radius * std::sqrt(2 * float(M_PI) * (1 - lowest) / static_cast<float>(n));
  std::vector<Eigen::Vector3f> positions(n);
  for (int i = 0; i < n; ++i) {
    const double z = double(lowest) + (1 - double(lowest)) * (double(i) + 0.5) / n,
                 r = std::sqrt(std::max(0.0, 1 - z * z)),
                 turn = M_PI * (3 - std::sqrt(5.0)) * double(i);
    positions[i] =
        centre + radius * Eigen::Vector3d(r * std::cos(turn), r * std::sin(turn), z).cast<float>();
  }
  const auto colours = colours_of(data, positions, 7, pool);
  for (int i = 0; i < n; ++i) {
    if (!colours[i]) continue;
    const Point point{positions[i], *colours[i], centre};
    list.rows.resize(list.rows.size() + kGaussianRows);
    put_gaussian(point, Eigen::Vector3f::Constant(0.6f * side), Eigen::Quaternionf::Identity(),
                 kPointOpacity, radius / 4, &*(list.rows.end() - kGaussianRows));
  }
  return list;
}

/// Returns the sky's Gaussians, `most` at most.
GaussianList sky_of(const TrainingSet& data, const InitialGaussianOptions& options, float reach,
                    std::size_t most, ThreadPool& pool) {
  const Scene& scene = data.scene;
  if (scene.background != Background::kNone || options.sky == 0) return {};
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  for (const View& view : scene.views)
    centre += scene.world_from_camera(view).translation() / double(scene.views.size());
  const auto with = [&](int n) {
    return visible_sphere(data, centre.cast<float>(), kFar * reach, n, !scene.metric, pool);
  };
  int n = options.sky;
  GaussianList sky = with(n);
  while (sky.size() > most) {  // their number is nearly proportional to n
    n = static_cast<int>(0.95 * n * static_cast<double>(most) / static_cast<double>(sky.size()));
    sky = with(n);
  }
  return sky;
}

/// Appends Gaussians at random places of a cube around the origin, inside the visual hull of images
/// with transparency: Gaussians that begin outside fade slowly where few images look. Uses the
/// whole cube if the hull is empty, as with wrong poses.
void append_random(const TrainingSet& data, const NearestCamera& cameras, float half_side, int n,
                   std::uint64_t key, ThreadPool& pool, GaussianList* list) {
  constexpr std::size_t kTries = 256;  // tries for each; the hull is a small part of the cube
  const VisualHull hull(data);
  const auto wanted = static_cast<std::size_t>(n);
  Points points;
  std::size_t tried = 0;
  const std::size_t most = kTries * wanted;
  for (std::vector<std::uint8_t> inside(wanted);
       points.size() < wanted && (tried < most || points.empty()); tried += wanted) {
    const auto at = [&](std::size_t i) {
      Eigen::Vector3f position;
      for (int k = 0; k < 3; ++k)
        position[k] = half_side * (2 * random_unit(key, 6 * (tried + i) + k) - 1);
      return position;
    };
    pool.run_ranges(wanted, kPointsPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i)
        inside[i] = tried >= most || hull.contains(at(i).cast<double>());
    });
    for (std::size_t i = 0; i < wanted && points.size() < wanted; ++i) {
      if (!inside[i]) continue;
      points.emplace_back().position = at(i);
      for (int k = 0; k < 3; ++k) points.back().rgb[k] = random_unit(key, 6 * (tried + i) + 3 + k);
    }
  }
  // The side of a cube with one point, in the volume that the points fill.
  const float side = 2 * half_side / std::cbrt(static_cast<float>(tried));
  for (const Point& point : points) {
    list->rows.resize(list->rows.size() + kGaussianRows);
    put_gaussian(point, Eigen::Vector3f::Constant(0.5f * side), Eigen::Quaternionf::Identity(),
                 kRandomOpacity, cameras.distance(point.position.data()),
                 &*(list->rows.end() - kGaussianRows));
  }
}

}  // namespace

GaussianList initial_gaussians(const TrainingSet& data, const InitialGaussianOptions& options,
                               std::uint64_t seed, ThreadPool& pool, std::size_t* unseen) {
  *unseen = 0;
  const Scene& scene = data.scene;
  const NearestCamera cameras(scene);
  GaussianList list;
  std::vector<float> distances;
  const auto add = [&](const Points& points, float voxel, float size, float opacity) {
    Points kept = thinned(points, cameras, voxel, kShareOfMost * options.max_gaussians, pool);
    set_beyond(data, pool, &kept);
    append_discs(kept, cameras, size, opacity, pool, &list);
    for (const Point& point : kept) distances.push_back(cameras.distance(point.position.data()));
    return kept;
  };
  Points returns;  // thinned
  if (data.lidar.n > 0) {
    const PointCloud cloud = lidar_points(scene, data.images, data.lidar, pool);
    Points points = points_of(cloud);
    const std::vector<float> full = data.lidar.full_intensities();
    for (std::size_t i = 0; i < cloud.n; ++i)
      points[i].intensity = data.lidar.intensity_of(cloud.source[i], full);
    if (!data.lidar.scan_ends.empty() && options.max_unseen > 0) {
      Points kept = thinned(unseen_returns(data, cloud), cameras, options.voxel,
                            static_cast<double>(options.max_unseen), pool);
      set_beyond(data, pool, &kept);
      append_discs(kept, cameras, kPointSize, kUnseenOpacity, pool, &list);
      *unseen = list.size();
    }
    returns = add(points, options.voxel, kPointSize, kPointOpacity);
    if (scene.metric && options.extruded > 0) {
      Points up = extruded(points, scene, options.extruded, random_key(seed, kStreamInit, 1));
      std::vector<Eigen::Vector3f> positions;
      for (const Point& point : up) positions.push_back(point.position);
      const auto colours = colours_of(data, positions, 1, pool);
      for (std::size_t i = 0; i < up.size(); ++i)
        if (colours[i]) up[i].rgb = *colours[i];
      add(up, 3 * options.voxel, 0.4f, kUncertainOpacity);
    }
  }
  if (options.tracks) {
    Points tracks = points_of(track_points(scene, data.images, pool));
    move_onto_planes(returns, cameras, pool, &tracks);
    add(tracks, options.voxel, kTrackPointSize, kUncertainOpacity);
    if (!scene.metric && scene.background == Background::kNone && tracks.size() > 1000)
      add(points_between(data, tracks, pool), options.voxel, kPointSize, kUncertainOpacity);
  }
  float reach = scene.half_side ? static_cast<float>(*scene.half_side) : 100.0f;
  if (distances.size() > 100) {
    const auto far = distances.begin() + static_cast<std::ptrdiff_t>(distances.size() * 49 / 50);
    std::ranges::nth_element(distances, far);
    reach = std::max(reach, *far);
  }
  if (list.size() < 1000 && scene.half_side)
    append_random(data, cameras, static_cast<float>(*scene.half_side), options.random,
                  random_key(seed, kStreamInit, 2), pool, &list);
  const auto most = static_cast<std::size_t>(options.max_gaussians);
  const GaussianList sky = sky_of(data, options, reach, most / 2, pool);
  shuffle(most - sky.size() + *unseen, random_key(seed, kStreamInit, 3), &list);
  list.rows.insert(list.rows.end(), sky.rows.begin(), sky.rows.end());
  return list;
}

}  // namespace redrive
