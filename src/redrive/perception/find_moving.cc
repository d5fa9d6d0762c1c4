// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/find_moving.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <optional>

#include "redrive/base/progress.h"
#include "redrive/perception/moving_file.h"
#include "redrive/perception/seen_through.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector3f;

constexpr float kNeighbours_m = 0.5f;
constexpr std::size_t kLeastPoints = 3;  // points of a cluster, at least
// Beams of a sparse LiDAR are up to 3 degrees apart.
constexpr float kLink_m = 0.6f, kLinkPerRange = 0.03f;
constexpr float kLongest_m = 15;  // length of a cluster, at most: a bus

constexpr double kFastest_m_per_s = 40;
constexpr double kGate_m = 1.5;  // largest distance between a predicted position and a cluster
constexpr int kLostAfter = 4;    // scans without a cluster after which a track ends
constexpr std::size_t kLeastKeys = 5, kLeastTrackPoints = 25;
constexpr double kLeastTime_s = 0.4, kLeastWay_m = 1.5;
constexpr double kLeastStraight = 0.5;  // least displacement over the way from cluster to cluster
constexpr double kUsual = 0.8;          // quantile of a track's sizes that is its object's size
constexpr double kLeastSize_m = 0.4;

struct Cluster {
  std::vector<const SweepPoint*> points;
  Vector3d centre = Vector3d::Zero();
  std::int64_t t_ns = 0;
  int sweep = 0;
};

float link_of(const SweepPoint& point) {
  return kLink_m + kLinkPerRange * (point.in_world - point.sensor_in_world).norm();
}

/// Returns vanishing points most of whose neighbours vanish, too.
std::vector<const SweepPoint*> vanishing(const Sweep& sweep) {
  std::vector<const SweepPoint*> of_interest, vanish;
  for (const SweepPoint& point : sweep.points)
    if (point.vanishes() || point.stays()) of_interest.push_back(&point);
  for (const SweepPoint* point : of_interest) {
    if (!point->vanishes()) continue;
    int vanishes = 0, stays = 0;
    for (const SweepPoint* other : of_interest)
      if ((other->in_world - point->in_world).squaredNorm() < kNeighbours_m * kNeighbours_m)
        ++(other->vanishes() ? vanishes : stays);
    if (vanishes > stays) vanish.push_back(point);
  }
  return vanish;
}

std::vector<Cluster> clusters_of(const Sweep& sweep, int index) {
  std::vector<const SweepPoint*> rest = vanishing(sweep);
  std::vector<Cluster> clusters;
  while (!rest.empty()) {
    Cluster cluster{{rest.back()}, Vector3d::Zero(), 0, index};
    rest.pop_back();
    for (std::size_t k = 0; k < cluster.points.size(); ++k) {
      const SweepPoint& from = *cluster.points[k];
      const auto linked = std::partition(rest.begin(), rest.end(), [&](const SweepPoint* other) {
        return (other->in_world - from.in_world).norm() > link_of(from);
      });
      cluster.points.insert(cluster.points.end(), linked, rest.end());
      rest.erase(linked, rest.end());
    }
    if (cluster.points.size() < kLeastPoints) continue;
    Eigen::AlignedBox3f box;
    double t_ns = 0;
    for (const SweepPoint* point : cluster.points) {
      box.extend(point->in_world);
      t_ns += static_cast<double>(point->t_ns - cluster.points[0]->t_ns);
    }
    if (box.sizes().maxCoeff() > kLongest_m) continue;
    // Middle of the extent, which depends less than a mean on which beams hit.
    cluster.centre = box.center().cast<double>();
    cluster.t_ns =
        cluster.points[0]->t_ns + std::llround(t_ns / static_cast<double>(cluster.points.size()));
    clusters.push_back(std::move(cluster));
  }
  return clusters;
}

struct Track {
  std::vector<Cluster> clusters;

  double seconds_to(std::int64_t t_ns) const {
    return 1e-9 * static_cast<double>(t_ns - clusters.back().t_ns);
  }
  /// Velocity over its last clusters; none for a single one.
  std::optional<Vector3d> velocity_m_per_s() const {
    if (clusters.size() < 2) return std::nullopt;
    const Cluster& from = clusters[clusters.size() - std::min<std::size_t>(clusters.size(), 5)];
    return Vector3d((clusters.back().centre - from.centre) / seconds_from(from));
  }
  double seconds_from(const Cluster& from) const {
    return std::max(1e-9 * static_cast<double>(clusters.back().t_ns - from.t_ns), 1e-3);
  }
  /// Returns a cluster's distance from its predicted place, relative to the largest accepted
  /// distance.
  double distance(const Cluster& to) const {
    const double t_s = seconds_to(to.t_ns);
    if (t_s <= 0) return 2;
    const auto velocity = velocity_m_per_s();
    if (!velocity) return (to.centre - clusters.back().centre).norm() / (kFastest_m_per_s * t_s);
    return (to.centre - clusters.back().centre - t_s * *velocity).norm() / kGate_m;
  }
};

/// Joins clusters of scans, each to the track whose prediction is nearest.
std::vector<Track> join(const std::vector<std::vector<Cluster>>& sweeps) {
  std::vector<Track> ended, open;
  for (int s = 0; s < static_cast<int>(sweeps.size()); ++s) {
    for (std::size_t k = 0; k < open.size();) {
      if (s - open[k].clusters.back().sweep > kLostAfter) {
        ended.push_back(std::move(open[k]));
        open.erase(open.begin() + static_cast<std::ptrdiff_t>(k));
      } else {
        ++k;
      }
    }
    struct Pair {
      double distance;
      std::size_t track, cluster;
    };
    std::vector<Pair> pairs;
    for (std::size_t t = 0; t < open.size(); ++t)
      for (std::size_t c = 0; c < sweeps[s].size(); ++c)
        if (const double distance = open[t].distance(sweeps[s][c]); distance < 1)
          // Tracks with a velocity first.
          pairs.push_back({distance + (open[t].clusters.size() > 1 ? 0 : 1), t, c});
    std::ranges::stable_sort(pairs, {}, &Pair::distance);
    std::vector<std::uint8_t> track_has(open.size()), cluster_has(sweeps[s].size());
    for (const Pair& pair : pairs) {
      if (track_has[pair.track] || cluster_has[pair.cluster]) continue;
      track_has[pair.track] = cluster_has[pair.cluster] = 1;
      open[pair.track].clusters.push_back(sweeps[s][pair.cluster]);
    }
    for (std::size_t c = 0; c < sweeps[s].size(); ++c)
      if (!cluster_has[c]) open.push_back({{sweeps[s][c]}});
  }
  ended.insert(ended.end(), open.begin(), open.end());
  return ended;
}

bool moves_steadily(const Track& track) {
  const std::vector<Cluster>& clusters = track.clusters;
  if (clusters.size() < kLeastKeys) return false;
  std::size_t points = 0;
  for (const Cluster& cluster : clusters) points += cluster.points.size();
  if (points < kLeastTrackPoints) return false;
  const auto mean = [&](std::size_t begin) {
    return Vector3d((clusters[begin].centre + clusters[begin + 1].centre) / 2);
  };
  const double seconds = track.seconds_from(clusters.front());
  const double way_m = (mean(clusters.size() - 2) - mean(0)).norm();
  double walked_m = 0;
  for (std::size_t k = 1; k < clusters.size(); ++k)
    walked_m += (clusters[k].centre - clusters[k - 1].centre).norm();
  return seconds >= kLeastTime_s && way_m >= kLeastWay_m &&
         way_m >= kMovingSpeed_m_per_s * seconds && way_m >= kLeastStraight * walked_m;
}

/// Returns the points of a scan around a place where most do not stay; none where they are too few.
std::optional<Cluster> cluster_at(const Vector3d& centre, const Vector3d& half, const Sweep& sweep,
                                  int index) {
  Cluster cluster{{}, centre, 0, index};
  std::size_t stay = 0;
  double t_ns = 0;
  for (const SweepPoint& point : sweep.points) {
    if (((point.in_world.cast<double>() - centre).cwiseAbs() - half).maxCoeff() > 0) continue;
    if (point.stays()) {
      ++stay;
      continue;
    }
    cluster.points.push_back(&point);
    t_ns += static_cast<double>(point.t_ns - cluster.points[0]->t_ns);
  }
  if (cluster.points.size() < kLeastPoints || cluster.points.size() < 2 * stay) return std::nullopt;
  cluster.t_ns =
      cluster.points[0]->t_ns + std::llround(t_ns / static_cast<double>(cluster.points.size()));
  return cluster;
}

/// Adds clusters before the first or after the last one where the track would continue: rays of
/// other times did not reach all places often enough to decide.
void extend(const std::vector<Sweep>& sweeps, bool later, std::vector<Cluster>* clusters) {
  constexpr int kMostAdded = 10;
  constexpr double kMargin_m = 0.5;
  const std::size_t last = clusters->size() - 1, from = std::min<std::size_t>(last, 5);
  const Cluster end = later ? clusters->back() : clusters->front();
  const Cluster& inner = (*clusters)[later ? last - from : from];
  const Vector3d m_per_ns =
      (end.centre - inner.centre) / static_cast<double>(end.t_ns - inner.t_ns);
  Eigen::AlignedBox3d box;
  for (const SweepPoint* point : end.points) box.extend(point->in_world.cast<double>());
  const Vector3d half = box.sizes() / 2 + Vector3d::Constant(kMargin_m);
  for (int k = 1; k <= kMostAdded; ++k) {
    const int s = end.sweep + (later ? k : -k);
    if (s < 0 || s >= static_cast<int>(sweeps.size()) || sweeps[s].points.empty()) return;
    const double ns = (later ? k : -k) * 1e9 * kSweep_s;
    auto cluster = cluster_at(end.centre + ns * m_per_ns, half, sweeps[s], s);
    if (!cluster) return;
    // Places belong to the cluster's own time.
    cluster->centre = end.centre + static_cast<double>(cluster->t_ns - end.t_ns) * m_per_ns;
    clusters->insert(later ? clusters->end() : clusters->begin(), *cluster);
  }
}

/// Extent of a cluster in axes of its heading.
struct Extent {
  Eigen::AlignedBox3d box;  ///< x along the heading, y to its left, z up
  Vector3d sensor;
};

Eigen::Matrix3d world_from_heading(double yaw_rad) {
  return Eigen::AngleAxisd(yaw_rad, Vector3d::UnitZ()).matrix();
}

/// Returns the heading at cluster k from those around it.
double heading_rad(const std::vector<Cluster>& clusters, std::size_t k) {
  constexpr std::size_t kAround = 4;
  const std::size_t from = k - std::min(k, kAround),
                    to = std::min(k + kAround, clusters.size() - 1);
  const Vector3d way = clusters[to].centre - clusters[from].centre;
  return std::atan2(way.y(), way.x());
}

/// Encloses the cluster, the other points of the scan on it, and the points below them.
Extent extent_of(const Cluster& cluster, const Sweep& sweep, double yaw_rad) {
  const Eigen::Matrix3d heading_from_world = world_from_heading(yaw_rad).transpose();
  Extent extent;
  float ground_m = cluster.points[0]->ground_m;
  const auto add = [&](const SweepPoint& point) {
    extent.box.extend(heading_from_world * point.in_world.cast<double>());
    ground_m = std::min(ground_m, point.ground_m);
  };
  for (const SweepPoint* point : cluster.points) add(*point);
  for (const SweepPoint& point : sweep.points) {
    if (point.stays()) continue;
    const float near_m = std::min(link_of(point), 1.0f);
    if (std::ranges::any_of(cluster.points, [&](const SweepPoint* other) {
          return (other->in_world - point.in_world).squaredNorm() < near_m * near_m;
        }))
      add(point);
  }
  extent.box.min().z() = ground_m;
  extent.sensor = heading_from_world * Vector3d(cluster.points[0]->sensor_in_world.cast<double>());
  return extent;
}

double usual(std::vector<double> values) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(kUsual * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Returns the interval of length `size` that holds [low, high], or its middle, and otherwise lies
/// behind it as seen from `sensor`.
double centre_away(double low, double high, double size, double sensor) {
  if (high - low >= size || (sensor > low && sensor < high)) return (low + high) / 2;
  return sensor <= low ? low + size / 2 : high - size / 2;
}

/// Fits a line through the points around time `at_s`, in which outliers hardly count; returns its
/// point and slope there.
std::pair<Vector3d, Vector3d> line_at(const std::vector<double>& times_s,
                                      const std::vector<Vector3d>& points, double at_s) {
  constexpr double kAround_s = 0.6, kOutlier_m = 0.2;
  constexpr int kRounds = 4;
  Vector3d point = Vector3d::Zero(), slope = Vector3d::Zero();
  for (int round = 0; round < kRounds; ++round) {
    double sum = 0, sum_t = 0, sum_tt = 0;
    Vector3d sum_p = Vector3d::Zero(), sum_tp = Vector3d::Zero();
    for (std::size_t k = 0; k < points.size(); ++k) {
      const double t_s = times_s[k] - at_s, part = std::abs(t_s) / kAround_s;
      if (part >= 1) continue;
      double weight = std::pow(1 - part * part * part, 3);
      if (round > 0)
        weight /= 1 + (points[k] - point - t_s * slope).squaredNorm() / (kOutlier_m * kOutlier_m);
      sum += weight;
      sum_t += weight * t_s;
      sum_tt += weight * t_s * t_s;
      sum_p += weight * points[k];
      sum_tp += weight * t_s * points[k];
    }
    const double determinant = sum * sum_tt - sum_t * sum_t;
    slope = determinant > 1e-9 * sum * sum ? Vector3d((sum * sum_tp - sum_t * sum_p) / determinant)
                                           : Vector3d::Zero();
    point = (sum_p - sum_t * slope) / sum;
  }
  return {point, slope};
}

/// Puts boxes where lines through the neighbouring boxes are, and aligns them with these.
void smooth(MovingObject* object) {
  std::vector<double> times_s;
  std::vector<Vector3d> centres;
  for (const MovingObject::Key& key : object->keys) {
    times_s.push_back(1e-9 * static_cast<double>(key.t_ns - object->keys[0].t_ns));
    centres.push_back(key.world_from_box.translation());
  }
  for (std::size_t k = 0; k < times_s.size(); ++k) {
    const auto [centre, velocity] = line_at(times_s, centres, times_s[k]);
    Rigid3d& pose = object->keys[k].world_from_box;
    pose.translation() = centre;
    if (velocity.head<2>().norm() > kMovingSpeed_m_per_s / 2)
      pose.linear() = world_from_heading(std::atan2(velocity.y(), velocity.x()));
  }
}

/// Drops boxes at the place of an annotated object.
void leave_to(const MovingObjects& annotated, MovingObject* object) {
  constexpr double kBeside_m = 0.5;
  std::erase_if(object->keys, [&](const MovingObject::Key& key) {
    return std::ranges::any_of(annotated.at(key.t_ns), [&](MovingBox box) {
      box.half_size_m.array() += kBeside_m;
      return box.contains(key.world_from_box.translation());
    });
  });
}

/// Whether two objects are at the same place at most of their common times.
bool is_same(const MovingObject& a, const MovingObject& b) {
  constexpr double kApart_m = 1.5;
  std::size_t common = 0, near = 0;
  for (const MovingObject::Key& key : b.keys)
    if (const auto other = a.world_from_box(key.t_ns)) {
      ++common;
      near += (other->translation() - key.world_from_box.translation()).norm() < kApart_m;
    }
  return common > 0 && 2 * near > common;
}

void number(std::vector<MovingObject>* objects) {
  for (std::size_t i = 0; i < objects->size(); ++i)
    (*objects)[i].id = -1 - static_cast<std::int64_t>(i);
}

MovingObject object_of(const Track& track, const std::vector<Sweep>& sweeps) {
  const std::vector<Cluster>& clusters = track.clusters;
  std::vector<Extent> extents;
  std::vector<double> sizes[3], yaws_rad;
  for (std::size_t k = 0; k < clusters.size(); ++k) {
    yaws_rad.push_back(heading_rad(clusters, k));
    extents.push_back(extent_of(clusters[k], sweeps[clusters[k].sweep], yaws_rad[k]));
    const Vector3d size = extents[k].box.sizes();
    for (int d = 0; d < 3; ++d) sizes[d].push_back(size[d]);
  }
  MovingObject object;
  object.type = kFound;
  for (int d = 0; d < 3; ++d) object.size_m[d] = std::max(usual(sizes[d]), kLeastSize_m);
  for (std::size_t k = 0; k < clusters.size(); ++k) {
    const Eigen::AlignedBox3d& box = extents[k].box;
    Vector3d centre;
    for (int d = 0; d < 2; ++d)
      centre[d] = centre_away(box.min()[d], box.max()[d], object.size_m[d], extents[k].sensor[d]);
    centre.z() = box.min().z() + object.size_m.z() / 2;
    MovingObject::Key key{clusters[k].t_ns, Rigid3d::Identity(), Vector3d::Zero()};
    key.world_from_box.linear() = world_from_heading(yaws_rad[k]);
    key.world_from_box.translation() = key.world_from_box.linear() * centre;
    object.keys.push_back(key);
  }
  smooth(&object);
  return object;
}

}  // namespace

std::vector<MovingObject> find_moving_objects(const Scene& scene, const LidarReturns& returns,
                                              const MovingObjects& annotated, ThreadPool& pool) {
  const Progress progress("following what moves in the LiDAR");
  const std::vector<Sweep> sweeps = seen_through(scene, returns, pool);
  std::vector<std::vector<Cluster>> clusters(sweeps.size());
  pool.run(static_cast<int>(sweeps.size()),
           [&](int s) { clusters[s] = clusters_of(sweeps[s], s); });
  std::vector<MovingObject> objects;
  for (Track& track : join(clusters)) {
    if (!moves_steadily(track)) continue;
    for (const bool later : {false, true}) extend(sweeps, later, &track.clusters);
    MovingObject object = object_of(track, sweeps);
    leave_to(annotated, &object);
    set_velocities(&object);
    if (object.keys.size() >= kLeastKeys) objects.push_back(std::move(object));
  }
  number(&objects);
  return objects;
}

void join_found(std::vector<MovingObject> later, std::vector<MovingObject>* objects) {
  for (MovingObject& object : later) {
    const auto same = std::ranges::find_if(
        *objects, [&](const MovingObject& before) { return is_same(before, object); });
    if (same == objects->end()) {
      objects->push_back(std::move(object));
      continue;
    }
    same->size_m = same->size_m.cwiseMax(object.size_m);
    const std::int64_t last_ns = same->keys.back().t_ns;
    std::ranges::copy_if(object.keys, std::back_inserter(same->keys),
                         [&](const MovingObject::Key& key) { return key.t_ns > last_ns; });
    set_velocities(&*same);
  }
  number(objects);
}

std::vector<MovingObject> found_objects(const MovingObjects& moving) {
  std::vector<MovingObject> found;
  std::ranges::copy_if(moving.objects(), std::back_inserter(found),
                       [](const MovingObject& object) { return object.type == kFound; });
  return found;
}

}  // namespace redrive
