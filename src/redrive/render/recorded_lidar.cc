// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/recorded_lidar.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {
namespace {

/// Returns the file of the LiDAR's revolution of the frame whose middle is nearest to the frame;
/// null if there is none.
const FrameFile* nearest_revolution(const Recording& recording, std::int64_t frame_id,
                                    std::size_t lidar) {
  const auto frame = std::ranges::lower_bound(recording.frames, frame_id, {}, &FramePose::id);
  if (frame == recording.frames.end() || frame->id != frame_id) return nullptr;
  std::vector<const FrameFile*> files;
  for (const FrameFile& file : recording.lidar_files)
    if (file.frame_id == frame_id && file.lidar == lidar) files.push_back(&file);
  if (files.size() < 2) return files.empty() ? nullptr : files[0];
  const FrameFile* nearest = nullptr;
  std::int64_t least_ns = 0;
  for (const FrameFile* file : files) {
    const auto middle = middle_ns(recording.read_lidar(*file));
    if (!middle) continue;
    const std::int64_t off_ns = std::abs(*middle - frame->t_ns);
    if (!nearest || off_ns < least_ns) nearest = file, least_ns = off_ns;
  }
  return nearest;
}

/// Returns the ring of each of the `returns`, which are some of the points in their order.
std::vector<std::uint8_t> rings_of(const std::vector<LidarPoint>& points,
                                   const LidarReturns& returns) {
  const Rigid3d sensor_from_body =
      returns.sensors[returns.sensor_of(0)].body_from_sensor.inverse(Eigen::Isometry);
  std::vector<std::uint8_t> rings;
  for (const LidarPoint& point : points) {
    const std::size_t i = rings.size();
    if (i == returns.n) break;
    const Eigen::Vector3d in_sensor = sensor_from_body * point.in_body_m.cast<double>();
    constexpr double kSame_m = 1e-3;  // ranges are floats
    if (point.t_ns == returns.t_ns[i] && (in_sensor - returns.in_sensor(i)).norm() < kSame_m)
      rings.push_back(point.ring);
  }
  rings.resize(returns.n, kNoRing);
  return rings;
}

}  // namespace

std::optional<LidarFirings> recorded_firings(const Recording& recording, const Scene& scene,
                                             std::int64_t frame_id, ThreadPool& pool,
                                             std::size_t lidar) {
  const FrameFile* const file = nearest_revolution(recording, frame_id, lidar);
  if (!file) return std::nullopt;
  Recording revolution;
  revolution.frames = recording.frames;
  revolution.lidars = recording.lidars;
  revolution.reader = recording.reader;
  revolution.lidar_files = {*file};
  const LidarReturns returns = load_lidar_returns(
      revolution, scene, MovingObjects({}, recording.frames, scene.global_from_world), pool,
      {{}, /*repeated=*/true});
  if (returns.n == 0) return std::nullopt;
  LidarFirings out;
  out.t_ns = returns.t_ns;
  out.range_m = returns.range_m;
  for (std::size_t i = 0; i < returns.n; ++i)
    out.direction.push_back(returns.direction_in_sensor(i).normalized());
  out.ring = rings_of(recording.read_lidar(*file), returns);
  return out;
}

std::optional<ScanStructure> recorded_structure(const Recording& recording, std::string* why,
                                                std::size_t lidar) {
  const std::vector<FrameFile> files = recording.scans_of(lidar);
  std::vector<std::vector<LidarPoint>> scans;
  const std::size_t middle = files.size() / 2;
  for (std::size_t i = middle; i < std::min(middle + 2, files.size()); ++i) try {
      scans.push_back(recording.read_lidar(files[i]));
    } catch (const InputError&) {  // named where all scans are read
    }
  return estimate_structure(scans, recording.lidars[lidar].body_from_lidar, why);
}

}  // namespace redrive
