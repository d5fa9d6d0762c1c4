// SPDX-License-Identifier: Apache-2.0
// What a drive is, whatever format it came in: cameras with their calibration, the body's pose per
// frame, image files, and what was odd about them. Nothing is decoded here but the metadata. A set
// of photographs is one, too: its body is the camera.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "redrive/camera/calibration.h"
#include "redrive/math/rigid3.h"

namespace redrive {

/// The body's pose at one frame.
struct FramePose {
  std::int64_t id = 0;
  std::int64_t t_ns = 0;     ///< host clock
  Rigid3d global_from_body;  ///< metres; ECEF magnitudes (6.4e6) are normal. Recording::metric says
                             ///< where it is otherwise
};

/// What a sensor recorded of one frame.
struct FrameFile {
  std::int64_t frame_id = 0;
  std::filesystem::path path;
};

/// A picture as large as an image that says which of its pixels are left out.
struct MaskFile {
  std::filesystem::path path;   ///< empty: there is none
  bool black_is_masked = true;  ///< false: black is used and all the rest is left out
};

/// What a camera recorded of one frame.
struct ImageFile : FrameFile {
  MaskFile mask;
  bool held_out = false;  ///< by the recording's own split: not for training
};

/// Where the scene of a bounded recording is: |x - center| <= half_side along each axis.
struct BoundingCube {
  Eigen::Vector3d center;
  double half_side = 0;
};

/// Something worth telling the user that does not stop the work.
struct Finding {
  std::string subject;  ///< camera, sensor or file
  std::string what;     ///< what is missing or odd, and what is done about it
};

struct RecordedCamera {
  CameraCalibration calibration;
  std::vector<ImageFile> images;  ///< by frame id; only frames that have a pose
};

/// Truth or request for views that were never driven: novel/<name>/poses.json.
struct NovelSet {
  std::string name;
  std::filesystem::path poses_file;
};

struct Recording {
  std::filesystem::path root;
  std::string format;                   ///< "aimotive", "blender", "transforms"
  std::vector<RecordedCamera> cameras;  ///< by name; only those with images
  std::vector<FramePose> frames;        ///< by id
  std::vector<std::string> other_sensors;
  std::optional<Rigid3d> body_from_lidar;      ///< of the sensor that lidar_files come from
  std::vector<NovelSet> novel;                 ///< by name
  std::vector<FramePose> ground_truth_frames;  ///< exact poses by id, where a made recording ships
                                               ///< them; `frames` may carry errors
  std::vector<FrameFile> lidar_files;  ///< by frame id, with or without a pose: las.h reads them
  std::vector<FrameFile> box_files;    ///< by frame id, with or without a pose: boxes.h reads them
  std::filesystem::path points_file;   ///< static point cloud, in place of lidar_files; ply.h reads
                                       ///< it; empty if there is none
  /// True: a drive, in metres and ECEF, by a clock. False: pictures in a frame and unit of their
  /// own, which take the place of ECEF and metre everywhere; the body's axes are those of a camera
  /// that looks along body x, and t_ns only counts, 1 s a frame.
  bool metric = true;
  std::optional<BoundingCube>
      bounds;                     ///< in the frame of the poses (ECEF's place); nothing: unbounded
  std::vector<Finding> findings;  ///< frames dropped for want of a pose, images missing, ...

  const RecordedCamera* find_camera(const std::string& name) const;
};

/// What a made recording ships twice: as a program is given it, with realistic errors, and exact.
enum class PoseSource { kRecorded, kGroundTruth };

/// Opens a recording of any known format (recording/registry.cc: one line per format). InputError
/// otherwise, and where the truth is asked for that it does not ship.
Recording open_recording(const std::filesystem::path& root,
                         PoseSource source = PoseSource::kRecorded);

}  // namespace redrive
