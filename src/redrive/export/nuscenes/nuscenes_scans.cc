// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/nuscenes/nuscenes_scans.h"

#include <algorithm>
#include <tuple>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"

namespace redrive::nuscenes {
namespace {

/// A box in the global frame that moves at constant velocity.
struct CountingBox {
  Rigid3d box_from_global;
  Eigen::Vector3d velocity_m_per_s, half_m;
  std::int64_t t_ns = 0;
  std::size_t n = 0;
  double sum_ns = 0;  ///< times after t_ns, added up
  /// Direction from the LiDAR in the plane, the return nearest to it and its time.
  Eigen::Vector2d toward;
  double most_along = -2;
  std::int64_t passed_ns = 0;

  CountingBox(const Box& box, const std::vector<FramePose>& frames,
              const Rigid3d& global_from_lidar)
      : box_from_global(global_from_box_at(box, frames, box.t_ns).inverse(Eigen::Isometry)),
        velocity_m_per_s(velocity_in_global(box, frames)),
        half_m(0.5 * box.size_m),
        t_ns(box.t_ns),
        toward((global_from_lidar.inverse(Eigen::Isometry) *
                global_from_box_at(box, frames, box.t_ns).translation())
                   .head<2>()
                   .normalized()),
        passed_ns(box.t_ns) {}

  void count(const Eigen::Vector3d& in_global, const Eigen::Vector2d& in_lidar,
             std::int64_t point_ns) {
    if (const double along = toward.dot(in_lidar); along > most_along * in_lidar.norm()) {
      most_along = along / in_lidar.norm();
      passed_ns = point_ns;
    }
    const auto later_ns = static_cast<double>(point_ns - t_ns);
    const Eigen::Vector3d in_box =
        box_from_global * (in_global - 1e-9 * later_ns * velocity_m_per_s);
    if ((in_box.cwiseAbs().array() > half_m.array()).any()) return;
    ++n;
    sum_ns += later_ns;
  }
  ObjectReturns returns() const {
    return {n, n == 0 ? passed_ns : t_ns + std::llround(sum_ns / double(n))};
  }
};

}  // namespace

std::vector<Scan> list_scans(const Recording& drive, const std::vector<FrameFile>& files,
                             ThreadPool& pool, const std::atomic<bool>& stop, DriveNotes* notes) {
  std::vector<Scan> scans(files.size());
  pool.run(static_cast<int>(files.size()), [&](int s) {
    if (stop) throw Interrupted();
    Scan& scan = scans[static_cast<std::size_t>(s)];
    scan.file = files[static_cast<std::size_t>(s)];
    scan.before = s == 0 ? nullptr : &files[static_cast<std::size_t>(s) - 1];
    for (const LidarPoint& point : drive.read_lidar(scan.file)) {
      scan.end_ns = std::max(scan.end_ns, point.t_ns);
      scan.most_intensity = std::max(scan.most_intensity, point.intensity);
    }
  });
  constexpr std::int64_t kBeyond_ns = 200'000'000;
  const std::size_t left_out = std::erase_if(scans, [&](const Scan& scan) {
    return scan.end_ns == kNoPoint_ns || scan.end_ns < drive.frames.front().t_ns - kBeyond_ns ||
           scan.end_ns > drive.frames.back().t_ns + kBeyond_ns;
  });
  if (left_out > 0)
    notes->left_out.push_back(counted(left_out, "LiDAR revolution") +
                              " without points or without a pose");
  std::ranges::stable_sort(scans, {}, &Scan::end_ns);
  return scans;
}

Rigid3d body_from_lidar_top(const Recording& drive) {
  Rigid3d forward_from_file = Rigid3d::Identity();
  forward_from_file.linear() << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  return spinning_axes(drive.lidars[0].body_from_lidar) * forward_from_file;
}

std::vector<ObjectReturns> write_scan(const std::filesystem::path& file, const Recording& drive,
                                      const Scan& scan, std::int64_t end_ns, float full_scale,
                                      const std::vector<Box>& boxes) {
  std::vector<LidarPoint> points = new_points(drive, scan.file, scan.before);
  std::ranges::stable_sort(
      points, {}, [](const LidarPoint& point) { return std::tuple(point.t_ns, point.ring); });
  const Rigid3d global_from_lidar =
                    pose_at(drive.frames, end_ns) * spinning_axes(drive.lidars[0].body_from_lidar),
                lidar_from_global = global_from_lidar.inverse(Eigen::Isometry);
  std::vector<CountingBox> moving;
  for (const Box& box : boxes) moving.emplace_back(box, drive.frames, global_from_lidar);
  std::vector<LidarRecord> records;
  std::int64_t posed_ns = 0;
  Rigid3d global_from_body = pose_at(drive.frames, posed_ns);
  for (const LidarPoint& point : points) {
    if (point.t_ns != posed_ns) global_from_body = pose_at(drive.frames, posed_ns = point.t_ns);
    const Eigen::Vector3d in_global = global_from_body * point.in_body_m.cast<double>();
    LidarRecord record{lidar_from_global * in_global, point.t_ns,
                       std::min(1.0f, static_cast<float>(point.intensity) / full_scale)};
    record.ring = point.ring;
    records.push_back(record);
    for (CountingBox& box : moving) box.count(in_global, record.position_m.head<2>(), point.t_ns);
  }
  write_file(file, make_scan(records));
  std::vector<ObjectReturns> returns;
  for (const CountingBox& box : moving) returns.push_back(box.returns());
  return returns;
}

}  // namespace redrive::nuscenes
