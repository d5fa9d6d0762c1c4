// SPDX-License-Identifier: Apache-2.0
// Shared by the KITTI raw and odometry readers.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/formats/kitti/kitti_calibration.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive::kitti {

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override;
  std::uint64_t lidar_point_count(const FrameFile& file) const override;
  std::vector<Box> read_boxes(const FrameFile& file) const override;

  Rigid3d body_from_velodyne = Rigid3d::Identity();
  std::map<std::int64_t, ScanTime> scans;          ///< key: frame; for Recording::lidar_files
  std::map<std::int64_t, std::vector<Box>> boxes;  ///< key: frame; for Recording::box_files
};

/// Times of a sensor: line n of the file belongs to frame n - 1.
struct Timestamps {
  std::filesystem::path file;
  std::vector<std::optional<std::int64_t>> by_line;

  explicit Timestamps(const std::filesystem::path& path, const DamagedList* damaged = nullptr);

  /// Returns nothing for an empty line, and after the last line. There a frame that is `needed`,
  /// which it is not where an excerpt has poses of the whole drive, goes to `damaged`; without it
  /// InputError.
  std::optional<std::int64_t> of(std::int64_t frame_id, bool needed,
                                 const DamagedList* damaged) const;
  /// Whether a time is at most 0.2 s off the time of the frame by another sensor, `other`. If not,
  /// adds a record to `damaged`; without it InputError.
  bool is_same(std::int64_t frame_id, std::int64_t t_ns, std::int64_t other_ns,
               const std::string& other, const DamagedList* damaged) const;
  [[noreturn]] void fail(std::int64_t frame_id, double off_s, const std::string& rule) const;
};

/// Returns the median of a camera's times minus the frames' times. A finding about `camera` counts
/// images that are more than 5 ms off it.
std::int64_t time_offset_ns(const Timestamps& times, const std::string& camera,
                            const std::vector<ImageFile>& images,
                            const std::vector<FramePose>& frames, std::vector<Finding>* findings,
                            const DamagedList* damaged);

/// Drops the scans of frames without a pose. A finding names them.
void drop_scans_behind(const std::vector<FramePose>& frames, std::vector<FrameFile>* scans,
                       std::vector<Finding>* findings);

/// Returns the calibration of a rectified camera. `size`: size of its images.
CameraCalibration calibration_of(const RectifiedCamera& camera, ImageSize size,
                                 const std::string& name, const Rigid3d& rectified_from_body);

}  // namespace redrive::kitti
