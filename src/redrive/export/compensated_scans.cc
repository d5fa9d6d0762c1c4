// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/compensated_scans.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/wording.h"

namespace redrive {

std::vector<ScanOfDrive> list_scans(const Recording& drive, const std::vector<FrameFile>& files,
                                    ThreadPool& pool, const std::atomic<bool>& stop,
                                    DriveNotes* notes) {
  std::vector<ScanOfDrive> scans(files.size());
  pool.run(static_cast<int>(files.size()), [&](int s) {
    if (stop) throw Interrupted();
    ScanOfDrive& scan = scans[static_cast<std::size_t>(s)];
    scan.file = files[static_cast<std::size_t>(s)];
    scan.before = s == 0 ? nullptr : &files[static_cast<std::size_t>(s) - 1];
    for (const LidarPoint& point : drive.read_lidar(scan.file)) {
      scan.first_ns = std::min(scan.first_ns, point.t_ns);
      scan.last_ns = std::max(scan.last_ns, point.t_ns);
      scan.most_intensity = std::max(scan.most_intensity, point.intensity);
    }
  });
  constexpr std::int64_t kBeyond_ns = 200'000'000;
  const std::size_t left_out = std::erase_if(scans, [&](const ScanOfDrive& scan) {
    return scan.last_ns < scan.first_ns || scan.last_ns < drive.frames.front().t_ns - kBeyond_ns ||
           scan.last_ns > drive.frames.back().t_ns + kBeyond_ns;
  });
  if (left_out > 0)
    notes->left_out.push_back(counted(left_out, "LiDAR revolution") +
                              " without points or without a pose");
  std::ranges::stable_sort(scans, {}, &ScanOfDrive::last_ns);
  return scans;
}

std::uint16_t full_scale_of(const std::vector<ScanOfDrive>& scans) {
  std::uint16_t most = 0;
  for (const ScanOfDrive& scan : scans) most = std::max(most, scan.most_intensity);
  return intensity_scale(most);
}

ReturnsOnObjects::ReturnsOnObjects(const std::vector<Box>& boxes,
                                   const std::vector<FramePose>& frames,
                                   const Rigid3d& lidar_from_global)
    : lidar_from_global_(lidar_from_global) {
  for (const Box& box : boxes) {
    CountingBox counting;
    const Rigid3d global_from_box = global_from_box_at(box, frames, box.t_ns);
    counting.box_from_global = global_from_box.inverse(Eigen::Isometry);
    counting.velocity_m_per_s = velocity_in_global(box, frames);
    counting.half_m = 0.5 * box.size_m;
    counting.t_ns = counting.passed_ns = box.t_ns;
    counting.toward = (lidar_from_global * global_from_box.translation()).head<2>().normalized();
    boxes_.push_back(counting);
  }
}

void ReturnsOnObjects::count(const Eigen::Vector3d& in_global, std::int64_t t_ns) {
  if (boxes_.empty()) return;
  const Eigen::Vector2d in_lidar = (lidar_from_global_ * in_global).head<2>();
  for (CountingBox& box : boxes_) {
    if (const double along = box.toward.dot(in_lidar); along > box.most_along * in_lidar.norm()) {
      box.most_along = along / in_lidar.norm();
      box.passed_ns = t_ns;
    }
    const auto later_ns = static_cast<double>(t_ns - box.t_ns);
    const Eigen::Vector3d in_box =
        box.box_from_global * (in_global - 1e-9 * later_ns * box.velocity_m_per_s);
    if ((in_box.cwiseAbs().array() > box.half_m.array()).any()) continue;
    ++box.n;
    box.sum_ns += later_ns;
  }
}

std::vector<ObjectReturns> ReturnsOnObjects::returns() const {
  std::vector<ObjectReturns> all;
  for (const CountingBox& box : boxes_)
    all.push_back(
        {box.n, box.n == 0 ? box.passed_ns : box.t_ns + std::llround(box.sum_ns / double(box.n))});
  return all;
}

std::vector<Box> boxes_near(const Recording& drive, std::int64_t t_ns) {
  constexpr std::int64_t kMostApart_ns = 300'000'000;
  const FrameFile* nearest = nullptr;
  std::int64_t least_ns = kMostApart_ns;
  for (const FrameFile& file : drive.box_files) {
    const auto frame = std::ranges::lower_bound(drive.frames, file.frame_id, {}, &FramePose::id);
    if (frame == drive.frames.end() || frame->id != file.frame_id) continue;
    if (const std::int64_t apart_ns = std::abs(frame->t_ns - t_ns); apart_ns < least_ns) {
      least_ns = apart_ns;
      nearest = &file;
    }
  }
  return nearest ? drive.reader->read_boxes(*nearest) : std::vector<Box>();
}

}  // namespace redrive
