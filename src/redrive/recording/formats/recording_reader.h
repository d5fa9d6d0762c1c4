// SPDX-License-Identifier: Apache-2.0
// Interface of a recording format beyond the metadata in Recording: reads LiDAR and boxes, and
// writes poses and calibration. The function that opens a recording sets Recording::reader; no
// other code knows the folders of a data set.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "redrive/recording/core/box.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// Poses and calibration as files: text keyed by name, relative to their folder.
using PoseFiles = std::map<std::filesystem::path, std::string>;

/// Poses and calibration of a recording, and the files they come from, for messages.
struct CalibratedPoses {
  std::vector<FramePose> frames;           ///< sorted by id
  std::vector<CameraCalibration> cameras;  ///< sorted by name
  double lidar_elevation_rad = 0;          ///< RecordedLidar::elevation_rad of the first
  std::filesystem::path frames_file, cameras_file;
};

/// A point of the static world.
struct StaticPoint {
  Eigen::Vector3d in_global;         ///< the recording's global frame
  std::vector<std::int64_t> frames;  ///< frames of the recording whose images show the point
  bool has_track = false;            ///< whether its file says which images show it
};

/// The base class serves formats without LiDAR and boxes unchanged. Its pose files, which serve
/// every format, are egomotion.json (recording/formats/egomotion_json.h) and calibration.json
/// (recording/formats/calibration_json.h). A reader keeps what its files need beyond themselves,
/// such as extrinsics and the times of scans; it is called from several threads.
class RecordingReader {
 public:
  virtual ~RecordingReader() = default;

  /// Returns the points of one of Recording::lidar_files as recorded (Recording::read_lidar). Adds
  /// unusable ones to `left_out`, if that is given. InputError for a damaged file.
  virtual std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                             std::size_t* left_out = nullptr) const;
  /// Number of points that read_lidar returns at most, without reading them; 0 if the file is
  /// damaged.
  virtual std::uint64_t lidar_point_count(const FrameFile& file) const;
  /// Points of Recording::points_file, which must not be empty: by default a PLY in the body axes
  /// of the first frame, without tracks. InputError for a damaged file.
  virtual std::vector<StaticPoint> read_points(const Recording& recording) const;
  /// Boxes of one of Recording::box_files, each object once. InputError for a damaged file.
  virtual std::vector<Box> read_boxes(const FrameFile& file) const;
  /// Findings about single boxes that read_boxes left out of the files that were read so far.
  virtual std::vector<Finding> box_findings() const { return {}; }

  /// Names of the files that make_pose_files returns: poses, calibration.
  virtual std::vector<std::filesystem::path> pose_file_names() const;
  /// Returns `frames`, `cameras` and the elevation of the first LiDAR in the format of `recording`;
  /// times come back to 1 ms.
  virtual PoseFiles make_pose_files(const Recording& recording,
                                    const std::vector<FramePose>& frames,
                                    const std::vector<CameraCalibration>& cameras) const;
  /// Poses that cannot be go to `damaged`; without it they are errors. InputError for damaged
  /// files; `folder`, where they stand, is for messages.
  CalibratedPoses parse_pose_files(const PoseFiles& files, const std::filesystem::path& folder,
                                   const DamagedList* damaged = nullptr) const;
};

/// Returns RecordedLidar::elevation_rad of the first LiDAR; 0 without one.
double first_elevation_rad(const Recording& recording);

}  // namespace redrive
