// SPDX-License-Identifier: Apache-2.0
#include "redrive/scene/lidar/lidar_returns.h"

#include <algorithm>
#include <cstdio>
#include <iterator>
#include <tuple>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/lidar/lost_rays.h"
#include "redrive/scene/lidar/cloud_returns.h"

namespace redrive {
namespace {

constexpr std::int64_t kMaxBeyond_ns =
    60'000'000;  // half a revolution at 10 Hz and the frame's distance from its middle

// Bounding box of the ego vehicle in body axes (origin on the ground under the rear axle).
const Eigen::AlignedBox3d kEgo_m(Eigen::Vector3d(-1.5, -1.15, 0.2),
                                 Eigen::Vector3d(4.2, 1.15, 2.2));

auto identity(const LidarPoint& p) {
  return std::tuple(p.t_ns, p.in_body_m.x(), p.in_body_m.y(), p.in_body_m.z());
}

/// A return, as LidarReturns has it.
struct Return {
  Eigen::Vector3f direction;
  float range_m;
  std::int64_t t_ns;
  std::uint16_t intensity;
  std::uint8_t ring;
};

/// Whether one of the boxes, of the time of the return, has it; counts it if so.
bool is_on_moving(const std::vector<MovingBox>& boxes, const Eigen::Vector3d& in_world,
                  const Return& one, LidarReturns* out) {
  const auto box =
      std::ranges::find_if(boxes, [&](const MovingBox& other) { return other.contains(in_world); });
  if (box == boxes.end()) return false;
  ++out->on_moving;
  const Eigen::Vector3d in_box = box->box_from_world * in_world;
  if (is_on_object(*box, in_box))
    out->on_objects.push_back({box->id, one.t_ns, in_box.cast<float>(), one.direction, one.range_m,
                               one.intensity, one.ring});
  return true;
}

/// Makes returns of one revolution; adds those on moving objects to `out` and counts dropped ones.
std::vector<Return> returns_of(const std::vector<LidarPoint>& points,
                               const std::vector<LidarPoint>& before, const Recording& recording,
                               const Rigid3d& sensor_from_body, const Scene& scene,
                               const MovingObjects& moving, LidarReturns* out) {
  const std::vector<std::uint8_t> repeated = mark_repeated(points, before);
  const std::int64_t first_ns = recording.frames.front().t_ns - kMaxBeyond_ns,
                     last_ns = recording.frames.back().t_ns + kMaxBeyond_ns;
  std::vector<Return> returns;
  returns.reserve(points.size());
  Rigid3d world_from_body = Rigid3d::Identity();
  std::vector<MovingBox> boxes;
  std::int64_t placed_ns =
      points.empty() ? 0 : points[0].t_ns - 1;  // a packet's points share their time
  for (std::size_t i = 0; i < points.size(); ++i) {
    const LidarPoint& point = points[i];
    const Eigen::Vector3d in_body = point.in_body_m.cast<double>();
    if (repeated[i]) {
      ++out->repeated;
      continue;
    }
    if (point.t_ns < first_ns || point.t_ns > last_ns) {
      ++out->beyond_trajectory;
      continue;
    }
    const Eigen::Vector3d in_sensor = sensor_from_body * in_body;
    const double range_m = in_sensor.norm();
    if (kEgo_m.contains(in_body)) {
      ++out->on_ego;
      if (range_m > 0) out->sensors[0].on_ego.push_back((in_sensor / range_m).cast<float>());
      continue;
    }
    if (placed_ns != point.t_ns) {
      placed_ns = point.t_ns;
      boxes = moving.at(placed_ns);
      if (!boxes.empty()) world_from_body = scene.world_from_body(placed_ns, Poses::kRecorded);
    }
    if (!(range_m > 0)) {
      ++out->unusable;
      continue;
    }
    const Return one{(in_sensor / range_m).cast<float>(), static_cast<float>(range_m), point.t_ns,
                     point.intensity, point.ring};
    if (!boxes.empty() && is_on_moving(boxes, world_from_body * in_body, one, out)) continue;
    returns.push_back(one);
  }
  return returns;
}

/// Adds the rays of a revolution that had no return. Files may overlap in time: rays that the one
/// before has, too, are left out.
void add_lost(const std::vector<LidarPoint>& points, const std::vector<LidarPoint>& before,
              const Recording& recording, const Rigid3d& body_from_lidar,
              const ScanStructure& structure, LidarReturns* out) {
  std::int64_t first_ns = recording.frames.front().t_ns - kMaxBeyond_ns;
  const std::int64_t last_ns = recording.frames.back().t_ns + kMaxBeyond_ns;
  for (const LidarPoint& point : before) first_ns = std::max(first_ns, point.t_ns + 1);
  const LostRays lost = lost_rays(points, body_from_lidar, structure);
  for (std::size_t i = 0; i < lost.size(); ++i)
    if (lost.t_ns[i] >= first_ns && lost.t_ns[i] <= last_ns)
      out->lost.push_back({lost.direction[i], lost.t_ns[i]});
}

/// Estimates the beams of a LiDAR from a few of its scans; nothing where they cannot be known.
std::optional<ScanStructure> structure_of(const std::vector<const FrameFile*>& files,
                                          const std::vector<std::vector<LidarPoint>>& points,
                                          std::size_t lidar, const Rigid3d& body_from_lidar) {
  constexpr std::size_t kScans = 4;
  std::vector<std::size_t> read;
  for (std::size_t f = 0; f < points.size(); ++f)
    if (files[f]->lidar == lidar && !points[f].empty()) read.push_back(f);
  std::vector<std::vector<LidarPoint>> some;
  for (std::size_t k = 0; k < std::min(kScans, read.size()); ++k)
    some.push_back(points[read[k * read.size() / std::min(kScans, read.size())]]);
  std::string why;
  return estimate_structure(some, body_from_lidar, &why);
}

/// Returns the points of the recording's cloud, each with the first of its frames that the scene
/// has; not points that only other frames see.
std::vector<CloudPoint> read_cloud(const Recording& recording, const Scene& scene) {
  const Rigid3d world_from_global = scene.global_from_world.inverse();
  std::vector<CloudPoint> cloud;
  for (const StaticPoint& point : recording.reader->read_points(recording)) {
    CloudPoint out{world_from_global * point.in_global};
    for (const std::int64_t id : point.frames)
      if (out.seen_from < 0) out.seen_from = scene.frame_index(id);
    if (out.seen_from >= 0 || !point.has_track) cloud.push_back(out);
  }
  return cloud;
}

/// Returns the points of a drive without scans, as seen from the nearest of its frames.
LidarReturns returns_of_cloud(const Recording& recording, const Scene& scene, ThreadPool& pool) {
  constexpr float kLeastRange_m = 0.5f;  // nearer points are on the car
  const Rigid3d& body_from_sensor = scene.rig[0].body_from_sensor;
  std::vector<CloudOrigin> origins;
  for (const PosedFrame& frame : scene.posed_frames())
    origins.push_back({frame.world_from_body * body_from_sensor, frame.t_ns});
  LidarReturns returns = cloud_returns(read_cloud(recording, scene), origins,
                                       recording.metric ? kLeastRange_m : 0, pool);
  returns.sensors = {{body_from_sensor}};
  return returns;
}

/// Takes the returns of all files, one after the other; returns->n is known.
void join_files(const std::vector<std::vector<Return>>& of_files, LidarReturns* returns) {
  returns->direction.resize(3 * returns->n);
  returns->range_m.reserve(returns->n);
  returns->t_ns.reserve(returns->n);
  returns->intensity.reserve(returns->n);
  returns->ring.reserve(returns->n);
  for (const std::vector<Return>& of_file : of_files)
    for (const Return& one : of_file) {
      const std::size_t i = returns->range_m.size();
      for (int d = 0; d < 3; ++d)
        returns->direction[std::size_t(d) * returns->n + i] = one.direction[d];
      returns->range_m.push_back(one.range_m);
      returns->t_ns.push_back(one.t_ns);
      returns->intensity.push_back(one.intensity);
      returns->ring.push_back(one.ring);
    }
}

/// Adds what a scan has besides its static returns. `sensor`: index in Recording::lidars.
void add_other(const LidarReturns& scan, std::size_t sensor, LidarReturns* all) {
  all->unusable += scan.unusable;
  all->repeated += scan.repeated;
  all->beyond_trajectory += scan.beyond_trajectory;
  all->on_ego += scan.on_ego;
  all->on_moving += scan.on_moving;
  std::ranges::copy(scan.on_objects, std::back_inserter(all->on_objects));
  std::ranges::copy(scan.lost, std::back_inserter(all->lost));
  std::ranges::copy(scan.sensors[0].on_ego, std::back_inserter(all->sensors[sensor].on_ego));
}

}  // namespace

bool is_on_object(const MovingBox& box, const Eigen::Vector3d& in_box) {
  constexpr double kBeside_m = 0.1, kAboveGround_m = 0.12;
  const Eigen::Vector3d half = box.half_size_m - Eigen::Vector3d::Constant(kBoxMargin_m);
  return (in_box.cwiseAbs().array() <= half.array() + kBeside_m).all() &&
         in_box.z() >= kAboveGround_m - half.z();
}

std::vector<std::uint8_t> mark_repeated(const std::vector<LidarPoint>& points,
                                        const std::vector<LidarPoint>& before) {
  std::vector<decltype(identity(points[0]))> known;
  known.reserve(before.size());
  for (const LidarPoint& point : before) known.push_back(identity(point));
  std::sort(known.begin(), known.end());
  std::vector<std::uint8_t> repeated;
  repeated.reserve(points.size());
  for (const LidarPoint& point : points)
    repeated.push_back(std::binary_search(known.begin(), known.end(), identity(point)));
  return repeated;
}

LidarReturns load_lidar_returns(const Recording& recording, const Scene& scene,
                                const MovingObjects& moving, ThreadPool& pool,
                                const LidarSelection& selection) {
  if (recording.lidar_files.empty() && !recording.points_file.empty())
    return returns_of_cloud(recording, scene, pool);
  LidarReturns returns;
  if (recording.lidars.empty()) return returns;
  returns.sensors.clear();
  for (const RecordedLidar& lidar : recording.lidars)
    returns.sensors.push_back(
        {lidar.body_from_lidar, static_cast<float>(lidar.gain), lidar.beam_gains, lidar.blind});
  std::vector<const FrameFile*> files;
  for (const FrameFile& file : recording.lidar_files)
    if (file.frame_id >= scene.frames.front().id && file.frame_id <= scene.frames.back().id &&
        file.lidar == selection.lidar.value_or(file.lidar))
      files.push_back(&file);
  const int count = static_cast<int>(files.size());
  const auto selected = [&](int f) {
    return !selection.frame || selection.frame(files[f]->frame_id);
  };
  // A file that is not selected is still read, to find which points the next one repeats.
  Progress progress("reading LiDAR", 2 * count);
  std::vector<std::vector<LidarPoint>> points(files.size());
  std::vector<LidarReturns> counts(files.size());
  std::vector<std::string> damaged(files.size());
  pool.run(count, [&](int f) {
    progress.count();
    if (!selected(f) && (selection.repeated || f + 1 == count || !selected(f + 1))) return;
    try {
      std::size_t unusable = 0;
      points[f] = recording.read_lidar(*files[f], &unusable);
      if (selected(f)) counts[f].unusable = unusable;
    } catch (const InputError& error) {
      damaged[f] = error.what();
    }
  });
  std::vector<DamagedRecord> left_out;
  std::set<std::filesystem::path> paths;  // a file may have scans of several LiDARs
  for (int f = 0; f < count; ++f)
    if (paths.insert(files[f]->path).second && !damaged[f].empty())
      left_out.push_back({"lidar", files[f]->frame_id, damaged[f]});
  returns.damaged = judge_damaged(recording, left_out, paths.size());

  std::vector<std::vector<Return>> of_files(files.size());
  const std::vector<LidarPoint> none;
  std::vector<std::optional<ScanStructure>> structures(recording.lidars.size());
  for (std::size_t k = 0; selection.lost && k < structures.size(); ++k)
    structures[k] = structure_of(files, points, k, recording.lidars[k].body_from_lidar);
  pool.run(count, [&](int f) {
    progress.count();
    if (!selected(f)) return;
    const std::size_t lidar = files[f]->lidar;
    const bool has_before = f > 0 && files[f - 1]->lidar == lidar && !selection.repeated;
    const std::vector<LidarPoint>& before = has_before ? points[f - 1] : none;
    const Rigid3d& body_from_lidar = recording.lidars[lidar].body_from_lidar;
    of_files[f] = returns_of(points[f], before, recording, body_from_lidar.inverse(Eigen::Isometry),
                             scene, moving, &counts[f]);
    if (structures[lidar])
      add_lost(points[f], before, recording, body_from_lidar, *structures[lidar], &counts[f]);
  });

  for (int f = 0; f < count; ++f) {
    returns.files += selected(f) && damaged[f].empty();
    returns.n += of_files[f].size();
    add_other(counts[f], files[f]->lidar, &returns);
    if (selected(f) && damaged[f].empty())
      returns.scan_ends.push_back(
          {returns.n, returns.on_objects.size(), returns.lost.size(), files[f]->lidar});
  }
  join_files(of_files, &returns);
  return returns;
}

std::size_t LidarReturns::sensor_of(std::size_t i) const {
  if (sensors.size() == 1 || scan_ends.empty()) return 0;
  return std::ranges::upper_bound(scan_ends, i, {}, &ScanEnd::returns)->sensor;
}

std::vector<float> LidarReturns::full_intensities() const {
  std::vector<std::uint16_t> largest(sensors.size());
  for (std::size_t i = 0; i < n; ++i) {
    std::uint16_t& of_sensor = largest[sensor_of(i)];
    of_sensor = std::max(of_sensor, intensity[i]);
  }
  std::vector<float> full;
  for (std::size_t k = 0; k < sensors.size(); ++k)
    full.push_back(static_cast<float>(intensity_scale(largest[k])) * sensors[k].gain);
  return full;
}

float LidarReturns::intensity_of(std::size_t i, const std::vector<float>& full) const {
  const std::size_t sensor = sensor_of(i);
  const float beam = gain_of_ring(sensors[sensor].beam_gains, ring_of(i));
  return static_cast<float>(intensity[i]) / (full[sensor] * beam);
}

bool LidarReturns::same_ray(std::size_t i) const {
  return t_ns[i] == t_ns[i - 1] &&
         (direction_in_sensor(i) - direction_in_sensor(i - 1)).norm() < kSameRay_rad;
}

LidarReturns::Ray LidarReturns::ray_at(std::size_t first, std::size_t last) const {
  Ray ray{first, first + 1, first};
  for (; ray.end < last && same_ray(ray.end); ++ray.end)
    if (intensity[ray.end] > intensity[ray.strongest]) ray.strongest = ray.end;
  return ray;
}

const Rigid3d& LidarPoses::at(std::size_t i) {
  const std::size_t sensor = returns_.sensor_of(i);
  if (t_ns_ != returns_.t_ns[i] || sensor_ != sensor) {
    t_ns_ = returns_.t_ns[i];
    sensor_ = sensor;
    world_from_sensor_ =
        scene_.world_from_body(*t_ns_, which_) * returns_.sensors[sensor].body_from_sensor;
  }
  return world_from_sensor_;
}

LidarRays rays_in_world(const Scene& scene, const LidarReturns& returns, ThreadPool& pool,
                        Poses which) {
  const std::size_t n = returns.n;
  LidarRays rays{std::vector<float>(3 * n), std::vector<float>(3 * n)};
  for (std::size_t begin = 0, end = 0; begin < n; begin = end) {
    const std::size_t sensor = returns.sensor_of(begin);
    end = n;
    if (returns.sensors.size() > 1)
      end = std::ranges::upper_bound(returns.scan_ends, begin, {}, &LidarReturns::ScanEnd::returns)
                ->returns;
    const LidarRays part = fire(
        std::span(returns.t_ns).subspan(begin, end - begin),
        [&](std::size_t i) { return returns.direction_in_sensor(begin + i); },
        [&](std::int64_t t_ns) {
          return scene.world_from_body(t_ns, which) * returns.sensors[sensor].body_from_sensor;
        },
        &pool);
    for (std::size_t k = 0; k < 3; ++k) {
      const auto row = [&](const std::vector<float>& of) {
        return of.begin() + static_cast<std::ptrdiff_t>(k * (end - begin));
      };
      const auto count = static_cast<std::ptrdiff_t>(end - begin),
                 to = static_cast<std::ptrdiff_t>(k * n + begin);
      std::copy_n(row(part.origin), count, rays.origin.begin() + to);
      std::copy_n(row(part.direction), count, rays.direction.begin() + to);
    }
  }
  return rays;
}

std::optional<Finding> lost_returns(const LidarReturns& returns) {
  constexpr float kLeastMedian_m = 0.5f, kMostMedian_m = 300;
  const std::size_t lost = returns.beyond_trajectory + returns.on_ego,
                    all = returns.n + lost + returns.on_moving;
  char what[320];
  if (2 * lost > all) {
    std::snprintf(
        what, sizeof what,
        "%zu of %zu returns are not used: %zu are more than 60 ms before the first pose or "
        "after the last (do their times count on the clock of the frames?), %zu within the "
        "vehicle (are their lengths metres?)",
        lost, all, returns.beyond_trajectory, returns.on_ego);
    return Finding{"lidar", what};
  }
  if (returns.n == 0) return std::nullopt;
  std::vector<float> ranges_m = returns.range_m;
  const auto middle = ranges_m.begin() + static_cast<std::ptrdiff_t>(ranges_m.size() / 2);
  std::ranges::nth_element(ranges_m, middle);
  if (*middle >= kLeastMedian_m && *middle <= kMostMedian_m) return std::nullopt;
  std::snprintf(what, sizeof what,
                "half of the returns are %s than %g m: are their lengths metres?",
                *middle < kLeastMedian_m ? "nearer" : "further", double(*middle));
  return Finding{"lidar", what};
}

std::optional<Finding> unusable_returns(const LidarReturns& returns) {
  if (returns.unusable == 0) return std::nullopt;
  return Finding{"lidar", counted(returns.unusable, "return") + " of " +
                              counted(returns.files, "scan") +
                              " left out: no numbers, at the sensor, or values that cannot be"};
}

LidarReturns sample_returns(const Recording& recording, const Scene& scene, ThreadPool& pool) {
  constexpr std::size_t kSample = 4;
  const std::vector<FrameFile>& files = recording.lidar_files;
  if (recording.lidars.empty() || files.empty()) return {};
  std::set<std::int64_t> sample;
  for (std::size_t i = 0; i < kSample; ++i)
    sample.insert(files[(2 * i + 1) * files.size() / (2 * kSample)].frame_id);
  const LidarSelection selection{.frame = [&](std::int64_t id) { return sample.contains(id); },
                                 .repeated = true};
  return load_lidar_returns(recording, scene, MovingObjects(), pool, selection);
}

void take_out(const Scene& scene, const MovingObjects& moving, LidarReturns* returns) {
  if (moving.objects().empty()) return;
  LidarReturns& r = *returns;
  std::vector<MovingBox> boxes;
  std::vector<std::size_t> kept;
  LidarPoses poses(scene, r, Poses::kRecorded);
  const std::vector<LidarReturns::OnObject> before = std::exchange(r.on_objects, {});
  std::size_t i = 0, known = 0;
  const auto take_scan = [&](std::size_t end, std::size_t end_of_known) {
    r.on_objects.insert(r.on_objects.end(), before.begin() + std::ptrdiff_t(known),
                        before.begin() + std::ptrdiff_t(end_of_known));
    known = end_of_known;
    for (; i < end; ++i) {
      if (i == 0 || r.t_ns[i] != r.t_ns[i - 1]) boxes = moving.at(r.t_ns[i]);
      const Return one{r.direction_in_sensor(i).cast<float>(), r.range_m[i], r.t_ns[i],
                       r.intensity[i], r.ring_of(i)};
      if (boxes.empty() || !is_on_moving(boxes, poses.in_world(i), one, returns)) kept.push_back(i);
    }
  };
  for (LidarReturns::ScanEnd& scan : r.scan_ends) {
    take_scan(scan.returns, scan.on_objects);
    scan = {kept.size(), r.on_objects.size(), scan.lost, scan.sensor};
  }
  take_scan(r.n, before.size());
  const auto keep = [&](auto& of, std::size_t rows) {
    for (std::size_t row = 0; row < rows; ++row)  // in place: each number moves to the front
      for (std::size_t k = 0; k < kept.size(); ++k)
        of[row * kept.size() + k] = of[row * r.n + kept[k]];
    of.resize(rows * kept.size());
  };
  keep(r.direction, 3);
  keep(r.range_m, 1);
  keep(r.t_ns, 1);
  keep(r.intensity, 1);
  if (!r.ring.empty()) keep(r.ring, 1);
  r.n = kept.size();
}

std::set<std::int64_t> held_out_frames(const Scene& scene) {
  std::set<std::int64_t> frames;
  for (const View& view : scene.views)
    if (view.held_out) frames.insert(scene.frames[view.frame].id);
  return frames;
}

}  // namespace redrive
