// SPDX-License-Identifier: Apache-2.0
// Scans of a drive for formats that compensate them for the motion until one time, and which
// returns lie on objects.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <limits>
#include <vector>

#include "redrive/export/drive.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {

/// A LiDAR revolution.
struct ScanOfDrive {
  FrameFile file;
  const FrameFile* before = nullptr;  ///< scan whose points may be repeated
  /// Times of its first and its last point.
  std::int64_t first_ns = std::numeric_limits<std::int64_t>::max(),
               last_ns = std::numeric_limits<std::int64_t>::min();
  std::uint16_t most_intensity = 0;
};

/// Returns the scans that have points within the poses, in order of their last points. `files`:
/// Recording::scans_of, which must outlive them. Names others in `notes`.
std::vector<ScanOfDrive> list_scans(const Recording& drive, const std::vector<FrameFile>& files,
                                    ThreadPool& pool, const std::atomic<bool>& stop,
                                    DriveNotes* notes);
/// Full scale of their intensities.
std::uint16_t full_scale_of(const std::vector<ScanOfDrive>& scans);

/// The returns of a scan on one object.
struct ObjectReturns {
  std::size_t n = 0;
  std::int64_t t_ns = 0;  ///< their mean time; without any the scan passed the box then
};

/// Counts returns on boxes that move at constant velocity.
class ReturnsOnObjects {
 public:
  /// `lidar_from_global`: at any time of the scan.
  ReturnsOnObjects(const std::vector<Box>& boxes, const std::vector<FramePose>& frames,
                   const Rigid3d& lidar_from_global);
  void count(const Eigen::Vector3d& in_global, std::int64_t t_ns);
  /// Returns what each box has.
  std::vector<ObjectReturns> returns() const;

 private:
  struct CountingBox {
    Rigid3d box_from_global;  ///< at t_ns
    Eigen::Vector3d velocity_m_per_s, half_m;
    std::int64_t t_ns = 0;
    std::size_t n = 0;
    double sum_ns = 0;  ///< times after t_ns, added up
    /// Direction from the LiDAR in the plane; time of the return that is nearest to it.
    Eigen::Vector2d toward;
    double most_along = -2;
    std::int64_t passed_ns = 0;
  };
  Rigid3d lidar_from_global_;
  std::vector<CountingBox> boxes_;
};

/// Returns the boxes of the file whose frame is nearest to a time; none beyond 0.3 s.
std::vector<Box> boxes_near(const Recording& drive, std::int64_t t_ns);

/// Calls `use(position in the global frame, point)` for points in order of time.
template <class Use>
void for_each_in_global(const std::vector<LidarPoint>& points, const std::vector<FramePose>& frames,
                        const Use& use) {
  std::int64_t posed_ns = 0;
  Rigid3d global_from_body = pose_at(frames, posed_ns);
  for (const LidarPoint& point : points) {
    if (point.t_ns != posed_ns) global_from_body = pose_at(frames, posed_ns = point.t_ns);
    use(Eigen::Vector3d(global_from_body * point.in_body_m.cast<double>()), point);
  }
}

}  // namespace redrive
