// SPDX-License-Identifier: Apache-2.0
// A recording of any format: cameras with their calibration, the body's pose per frame, image
// files, and findings about missing or unusual data. Only metadata is decoded here. A set of
// photographs is a recording, too: its body is the camera.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/math/rigid3.h"
#include "redrive/recording/core/blind_directions.h"

namespace redrive {

class RecordingReader;  // recording/formats/recording_reader.h
struct LidarPoint;      // recording/core/lidar_point.h

/// Pose of the body at one frame. Body axes: x forward, y left, z up; the origin is on the ground
/// under the middle of the rear axle (perception/ego_outline.h).
struct FramePose {
  std::int64_t id = 0;
  std::int64_t t_ns = 0;  ///< since any epoch; images follow it by a constant per camera
  /// in the frame of Recording::global_frame; of ECEF magnitude (6.4e6 m) in drives
  Rigid3d global_from_body;
};

/// The reference frame of poses.
enum class GlobalFrame {
  kEcef,      ///< Earth-centred, Earth-fixed; metres
  kArbitrary  ///< the recording's own; in metres only if Recording::metric
};

/// A file that a sensor recorded of one frame.
struct FrameFile {
  std::int64_t frame_id = 0;
  std::filesystem::path path;
  std::size_t lidar = 0;  ///< index in Recording::lidars, for scans
};

/// A mask image with the size of its image.
struct MaskFile {
  std::filesystem::path path;   ///< empty: no mask
  bool black_is_masked = true;  ///< false: everything but black is masked
};

/// A camera's image of one frame.
struct ImageFile : FrameFile {
  MaskFile mask;
  bool held_out = false;  ///< held out by the recording's own split: not for training
};

/// Extent of a bounded scene: |x - center| <= half_side along each axis.
struct BoundingCube {
  Eigen::Vector3d center;
  double half_side = 0;
};

/// A remark for the user that does not stop the work.
struct Finding {
  std::string subject;  ///< camera, sensor or file
  std::string what;     ///< what is missing or unusual, and its consequence
};

/// Share of a sensor's records that may be damaged, in percent; one always may.
constexpr double kMostDamagedPercent = 5;

/// A record that cannot be used and is left out (recording/formats/damaged_records.h).
struct DamagedRecord {
  std::string sensor;          ///< a camera, or "lidar", "boxes", "poses", ...
  std::int64_t frame_id = -1;  ///< -1: not known
  std::string why;             ///< reason as InputError states it: file, field, value, rule
  bool breaks = false;         ///< a pose that is kept: the frames from it on are elsewhere
};

struct RecordedCamera {
  CameraCalibration calibration;
  std::vector<ImageFile> images;  ///< sorted by frame id; only frames that have a pose
};

/// Ratio of a beam's intensities to the mean of all beams, on the same surfaces.
struct BeamGain {
  float elevation_rad = 0, gain = 1;
  bool operator==(const BeamGain&) const = default;
};
/// Returns the gain of a beam; 1 where none is known. `beams`: by LidarPoint::ring.
inline float gain_of_ring(const std::vector<BeamGain>& beams, std::uint8_t ring) {
  return ring < beams.size() ? beams[ring].gain : 1;
}

/// A LiDAR of the rig; Recording::lidar_files with its index are its scans.
struct RecordedLidar {
  std::string name;
  Rigid3d body_from_lidar = Rigid3d::Identity();  ///< its origin is the origin of the rays
  double elevation_rad = 0;                       ///< added to the elevations of recorded returns
  double gain = 1;  ///< its intensities over the first LiDAR's of the same surface
  std::vector<BeamGain> beam_gains = {};  ///< a ring is an index; empty: not known
  BlindDirections blind = {};             ///< where the vehicle hides what it would see
};

/// Views that were never driven, with images as ground truth or to be rendered.
struct NovelSet {
  std::string name;
  std::filesystem::path poses_file;  ///< edit/view_requests.h
};

/// The base class of RecordingReader.
std::shared_ptr<const RecordingReader> basic_reader();

struct Recording {
  std::filesystem::path root;
  std::string format;  ///< "aimotive", "kitti", "transforms", ...: for messages
  std::shared_ptr<const RecordingReader> reader = basic_reader();  ///< never null
  std::vector<RecordedCamera> cameras;  ///< sorted by name; only cameras with images
  std::vector<FramePose> frames;        ///< sorted by id
  std::vector<std::string> other_sensors;
  /// LiDARs whose place on the body is known; lidar_files without one are not used
  std::vector<RecordedLidar> lidars;
  std::vector<NovelSet> novel;  ///< sorted by name
  /// exact poses sorted by id, where a made recording ships them; `frames` may carry errors
  std::vector<FramePose> ground_truth_frames;
  /// scans, sorted by LiDAR, then frame id, with or without a pose; for reader
  std::vector<FrameFile> lidar_files;
  std::vector<FrameFile> box_files;   ///< sorted by frame id, with or without a pose; for reader
  std::filesystem::path points_file;  ///< static point cloud instead of lidar_files, for
                                      ///< reader; empty: none
  GlobalFrame global_frame = GlobalFrame::kEcef;
  /// True: a drive, in metres and seconds. False: photographs in an arbitrary unit, which replaces
  /// the metre everywhere; the body's axes are the axes of a camera that looks along body x, and
  /// t_ns counts frames, 1 s each.
  bool metric = true;
  std::optional<BoundingCube> bounds;  ///< in the global frame; nothing: unbounded
  std::vector<Finding> findings;       ///< frames dropped without a pose, missing images, ...
  std::vector<DamagedRecord> damaged;  ///< records dropped from it, by readers and later
  double most_damaged_percent = kMostDamagedPercent;  ///< share of a sensor's records, in percent
  /// a file outside the recording's folder that its text names; empty: none
  std::filesystem::path outside_file;

  const RecordedCamera* find_camera(const std::string& name) const;
  /// Returns the scans of one of the LiDARs.
  std::vector<FrameFile> scans_of(std::size_t lidar) const;
  /// Returns RecordingReader::read_lidar with the elevations corrected.
  std::vector<LidarPoint> read_lidar(const FrameFile& file, std::size_t* left_out = nullptr) const;
};

/// Poses and calibration to open. Made recordings ship both: with realistic errors, and exact.
enum class PoseSource { kRecorded, kGroundTruth };

/// Opens a recording of any known format (recording/registry.cc). InputError if the format is
/// unknown, if ground truth is requested and it ships none, and without `outside_files` if its text
/// names files outside its folder: it may come from a stranger.
Recording open_recording(const std::filesystem::path& root,
                         PoseSource source = PoseSource::kRecorded, bool outside_files = false);

}  // namespace redrive
