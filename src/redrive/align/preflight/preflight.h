// SPDX-License-Identifier: Apache-2.0
// Checks before training whether calibration, poses and times agree with the images. Point
// correspondences of each camera (correspondences.h) are compared with the recorded motion, and
// with the motion that would be recorded after each of the usual mistakes. Time offsets also come
// from the contrast of LiDAR intensities and images (lidar/contrast.h), since at constant velocity
// images alone do not determine them. Edges of the LiDAR's depth are scored by the images' edges
// (lidar/depth_edges.h).
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/align/lidar/contrast.h"
#include "redrive/align/lidar/depth_edges.h"
#include "redrive/align/preflight/correspondences.h"
#include "redrive/align/preflight/time_offset_scan.h"
#include "redrive/align/rig/rig_images.h"

namespace redrive {

struct ContrastPoint {
  double offset_ms = 0, correlation = 0;
};

enum class Verdict { kGood, kUsable, kWrong, kCannotTell };
const char* verdict_name(Verdict verdict);  ///< "good", "usable", "wrong", "cannot tell"

/// A mistake in the recording, as named in --json.
enum class Fault {
  kNone,
  kInvertedExtrinsic,  ///< RT_body_from_sensor holds its inverse
  kSwappedCameras,     ///< the extrinsics are another camera's
  kAxesConvention,     ///< its camera or body axes are of another convention
  kWrongRate,          ///< images have another rate than their poses
  kUnsynchronised,     ///< images are exposed at another time
  kUnexplained         ///< errors that none of these explains
};
const char* fault_name(Fault fault);  ///< "", "inverted_extrinsic", "swapped_cameras", ...

/// A change of the recorded calibration or times, and the error of the images with it.
struct Hypothesis {
  Fault fault = Fault::kNone;
  std::string what;     ///< "as recorded", "the extrinsic is inverted (sensor_from_body)", ...
  double error_px = 0;  ///< median of correspondence_error_px
};

/// An estimate of a camera's time offset.
struct TimeOffsetEstimate {
  double offset_ms = 0,
         sigma_ms =
             0;  ///< relative to the recorded offset; one standard deviation, infinite if unknown
  bool by_lidar = false;  ///< whether the LiDAR's contrast gave it; otherwise the images
};

/// Two images whose points agree far less with the poses than in most pairs.
struct OddPair {
  std::int64_t first_id = 0, last_id = 0;  ///< ids of the first and the last frame
  double error_px = 0;                     ///< median
};

struct CameraCheck {
  std::string name;
  Verdict verdict = Verdict::kCannotTell;
  Fault fault = Fault::kNone;
  std::string why;     ///< reason, a sentence
  int points = 0;      ///< number of compared points
  double flow_px = 0;  ///< median displacement of the points
  int scale = 1;  ///< factor by which images are downscaled; all pixels are of the smaller image
  std::vector<OddPair> odd_pairs;  ///< sorted by frame
  std::vector<Hypothesis> tried;   ///< "as recorded" first, then in ascending order of error
  std::vector<ScanPoint> scan;     ///< over time offsets relative to the recorded one
  double offset_ms = 0;            ///< position of the scan's minimum, from a parabola
  double offset_error_px = 0;      ///< error there
  /// sigma of offset_ms, from the jackknife over pairs of images; infinite for less than four
  double offset_sigma_ms = 0;
  bool offset_observable = false;  ///< whether the scan has a minimum, which needs turns or bumps
  std::vector<ContrastPoint> contrast;  ///< with the LiDAR, over time offsets relative to the
                                        ///< recorded one; empty: not computed
  std::optional<TimeOffsetEstimate> by_lidar;  ///< the contrast's peak, if observable
  std::optional<EdgeScore> edges;  ///< edges of LiDAR depth; nothing without a dense LiDAR

  /// The scan's minimum, observable or not.
  TimeOffsetEstimate by_images() const { return {offset_ms, offset_sigma_ms, false}; }
  /// The estimate with the smaller standard deviation of scan and LiDAR; nothing where neither is
  /// observable.
  std::optional<TimeOffsetEstimate> time_offset() const;
};

/// Whether the times of frames and LiDAR points come from the same clock.
struct ClockCheck {
  Verdict verdict = Verdict::kCannotTell;
  double frame_seconds_per_lidar_second = 1;
  std::string why;
};

/// A check that concerns all cameras: "motion", "lidar".
struct SharedCheck {
  std::string name;
  Verdict verdict = Verdict::kCannotTell;
  std::string why;
};

struct Preflight {
  std::vector<CameraCheck> cameras;  ///< as Recording::cameras
  ClockCheck clock;
  std::vector<SharedCheck> shared;
  bool passes() const;  ///< whether nothing is wrong, so that training makes sense
  std::string headline()
      const;  ///< the result in a sentence, with the cameras that could not be checked
};

/// Describes the best hypothesis and up to two more whose errors are at most a quarter larger: "A,
/// or B: then half of the points agree to 0.40 or 0.44 px, as ...". `tried`: as in CameraCheck,
/// with at least one besides "as recorded".
std::string explanation_of(const std::vector<Hypothesis>& tried);

/// Checks a drive (Recording::metric); the verdict on photographs is kCannotTell. `images`: the
/// same recording's; a width of 640 pixels is enough. `lidar`: its returns for time offsets; may be
/// empty.
Preflight check_recording(const Recording& recording, const RigImages& images,
                          const std::vector<LidarSample>& lidar, ThreadPool& pool,
                          const CorrespondenceOptions& options = {});

/// Compares the times of LiDAR scans with the times of the frames that they are named after.
ClockCheck check_clock(const Recording& recording);

}  // namespace redrive
