// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/kitti/velodyne_scans.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <tuple>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/kitti/kitti_write.h"
#include "redrive/recording/formats/kitti360/kitti360.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kOtherTime_ns = 1'000'000;    // a difference above this is reported
constexpr std::int64_t kSameFrame_ns = 200'000'000;  // as readers have it
constexpr double kMostCoordinate_m = 1000;           // as readers have it

struct Scan {
  FrameFile file;
  const FrameFile* before = nullptr;  ///< scan whose points may be repeated
  std::int64_t id = 0, middle_ns = 0;
  std::uint16_t most_intensity = 0;
};

struct Counts {
  std::size_t repeated = 0, far = 0, unseen = 0;
  std::int64_t most_ns = 0;  ///< largest change of a point's time
};

/// Keeps for each frame the scan with the least time `off_ns(scan)` from it. Returns how many
/// others there were.
template <class OffNs>
std::size_t keep_nearest(const OffNs& off_ns, std::vector<Scan>* scans) {
  std::vector<Scan> nearest;
  for (const Scan& scan : *scans)
    if (nearest.empty() || nearest.back().id != scan.id)
      nearest.push_back(scan);
    else if (off_ns(scan) < off_ns(nearest.back()))
      nearest.back() = scan;
  scans->swap(nearest);
  return nearest.size() - scans->size();
}

/// A point of a scan as it is written.
struct Record {
  std::uint8_t ring = kNoRing;
  Eigen::Vector4f values;                ///< x, y, z, intensity
  double below_rad = 0, turned_rad = 0;  ///< what order_by_rings sorts by

  double elevation_rad() const {
    return std::atan2(values.z(), std::hypot(values.x(), values.y()));
  }
  /// From ahead to the left, 0..2 pi.
  double turn_rad() const {
    const double azimuth_rad = std::atan2(values.y(), values.x());
    return azimuth_rad < 0 ? azimuth_rad + 2 * std::numbers::pi : azimuth_rad;
  }
};

/// Orders records as KITTI's files have them: ring after ring, the highest first, each from ahead
/// to the left. Where a point has no ring, they stay in order of time.
void order_by_rings(std::vector<Record>* records) {
  if (std::ranges::any_of(*records, [](const Record& r) { return r.ring == kNoRing; })) return;
  std::map<std::uint8_t, std::pair<double, int>> sums;  // elevation and number of points
  for (const Record& record : *records) {
    sums[record.ring].first += record.elevation_rad();
    ++sums[record.ring].second;
  }
  for (Record& record : *records) {
    const auto& [sum_rad, count] = sums.at(record.ring);
    record.below_rad = -sum_rad / count;
    record.turned_rad = record.turn_rad();
  }
  std::ranges::stable_sort(*records, {}, [](const Record& record) {
    return std::tuple(record.below_rad, record.ring, record.turned_rad);
  });
}

/// Puts the points' records where the points were seen at the time of their azimuth.
std::string make_scan(const std::vector<LidarPoint>& points, const kitti::ScanTime& time,
                      const std::vector<FramePose>& drive_frames,
                      const std::vector<FramePose>& frames, const Rigid3d& body_from_velodyne,
                      float full_scale, Counts* counts) {
  constexpr int kIterations = 6;  // the car moves far less than the points are away
  const std::int64_t column_ns = 1 + (time.end_ns - time.start_ns) / kitti::kScanColumns;
  std::vector<Record> records;
  for (const LidarPoint& point : points) {
    const Eigen::Vector3d in_global =
        pose_at(drive_frames, point.t_ns) * point.in_body_m.cast<double>();
    std::int64_t t_ns = point.t_ns, off_ns = 1;
    Eigen::Vector3d in_velodyne;
    for (int i = 0; i < kIterations && off_ns != 0; ++i) {
      in_velodyne =
          (pose_at(frames, t_ns) * body_from_velodyne).inverse(Eigen::Isometry) * in_global;
      const std::int64_t seen_ns = kitti::time_of_point(time, in_velodyne.x(), in_velodyne.y());
      off_ns = std::abs(seen_ns - t_ns);
      t_ns = seen_ns;
    }
    // Between two columns the time may alternate. Where a revolution ends and the next begins, a
    // turning car leaves directions into which the scanner never looks.
    if (off_ns > column_ns) {
      ++counts->unseen;
      continue;
    }
    if (!(in_velodyne.cwiseAbs().maxCoeff() <= kMostCoordinate_m)) {
      ++counts->far;
      continue;
    }
    counts->most_ns = std::max(counts->most_ns, std::abs(t_ns - point.t_ns));
    records.push_back(
        {point.ring,
         {static_cast<float>(in_velodyne.x()), static_cast<float>(in_velodyne.y()),
          static_cast<float>(in_velodyne.z()), static_cast<float>(point.intensity) / full_scale}});
  }
  order_by_rings(&records);
  std::string bytes;
  for (const Record& record : records)
    bytes.append(reinterpret_cast<const char*>(record.values.data()), kitti::kScanRecordBytes);
  return bytes;
}

/// Notes what happened to the points of all scans.
void note_changes(const std::vector<Counts>& counts, DriveNotes* notes) {
  Counts sum;
  for (const Counts& own : counts) {
    sum.repeated += own.repeated, sum.far += own.far;
    sum.unseen += own.unseen;
    sum.most_ns = std::max(sum.most_ns, own.most_ns);
  }
  if (sum.most_ns > kOtherTime_ns)
    notes->changed.push_back("LiDAR points have the time of their azimuth, up to " +
                             std::to_string(sum.most_ns / 1'000'000) +
                             " ms off their own; each stays where it is in the world");
  if (sum.repeated > 0)
    notes->left_out.push_back(counted(sum.repeated, "LiDAR point") +
                              " that a revolution repeats of the one before");
  if (sum.far > 0)
    notes->left_out.push_back(counted(sum.far, "LiDAR point") + " further than 1000 m away");
  if (sum.unseen > 0)
    notes->left_out.push_back(counted(sum.unseen, "LiDAR point") +
                              " behind the car, where one revolution ends and the next begins");
}

}  // namespace

std::map<std::int64_t, kitti::ScanTime> write_velodyne_scans(
    const fs::path& folder, const Recording& drive, const std::vector<FramePose>& frames,
    std::int64_t earlier_ids, ThreadPool& pool, const std::atomic<bool>& stop, DriveNotes* notes) {
  if (drive.lidars.empty() || drive.lidar_files.empty()) return {};
  std::vector<Scan> scans;
  std::size_t left_out = 0;
  const std::vector<FrameFile> files = drive.scans_of(0);
  for (const FrameFile& file : files) {
    const std::int64_t id = file.frame_id - earlier_ids;
    if (!std::ranges::binary_search(frames, id, {}, &FramePose::id)) {
      ++left_out;
      continue;
    }
    const FrameFile* before = &file == files.data() ? nullptr : &file - 1;
    scans.push_back({file, before, id, 0});
  }
  std::vector<Counts> counts(scans.size());
  Progress progress("writing LiDAR", 2 * std::ssize(scans));
  pool.run(static_cast<int>(scans.size()), [&](int s) {
    if (stop) throw Interrupted();
    Scan& scan = scans[static_cast<std::size_t>(s)];
    const auto frame = std::ranges::lower_bound(frames, scan.id, {}, &FramePose::id);
    const std::vector<LidarPoint> points = new_points(drive, scan.file, scan.before);
    scan.middle_ns = middle_ns(points).value_or(frame->t_ns);
    for (const LidarPoint& point : points)
      scan.most_intensity = std::max(scan.most_intensity, point.intensity);
    progress.count();
  });
  const auto off_ns = [&](const Scan& scan) {
    const auto frame = std::ranges::lower_bound(frames, scan.id, {}, &FramePose::id);
    return std::abs(scan.middle_ns - frame->t_ns);
  };
  left_out += std::erase_if(scans, [&](const Scan& scan) { return off_ns(scan) > kSameFrame_ns; });
  if (left_out > 0)
    notes->left_out.push_back(counted(left_out, "LiDAR revolution") +
                              " without a pose, or 0.2 s off the images of its frame");
  if (const std::size_t others = keep_nearest(off_ns, &scans); others > 0)
    notes->left_out.push_back(counted(others, "LiDAR revolution") +
                              " of a frame to which another one is nearer");
  if (scans.empty()) return {};
  const auto scale = static_cast<float>(
      intensity_scale(std::ranges::max(scans, {}, &Scan::most_intensity).most_intensity));
  std::vector<std::pair<std::int64_t, std::int64_t>> times;
  for (const Scan& scan : scans) times.emplace_back(scan.id, scan.middle_ns);
  make_folders(folder / "data");
  const fs::path times_file = folder / "timestamps.txt";
  write_file(times_file, kitti::make_timestamps(times));
  const std::int64_t revolution_ns = kitti360::revolution_ns(kitti::Timestamps(times_file));

  std::map<std::int64_t, kitti::ScanTime> revolutions;
  for (const Scan& scan : scans)
    revolutions[scan.id] = kitti360::scan_at(scan.middle_ns, revolution_ns);
  const Rigid3d body_from_velodyne = spinning_axes(drive.lidars[0].body_from_lidar);
  pool.run(static_cast<int>(scans.size()), [&](int s) {
    if (stop) throw Interrupted();
    const Scan& scan = scans[static_cast<std::size_t>(s)];
    Counts& own = counts[static_cast<std::size_t>(s)];
    write_file(
        folder / "data" / kitti::file_name(scan.id, ".bin"),
        make_scan(new_points(drive, scan.file, scan.before, &own.repeated), revolutions.at(scan.id),
                  drive.frames, frames, body_from_velodyne, scale, &own));
    progress.count();
  });
  note_changes(counts, notes);
  return revolutions;
}

}  // namespace redrive
