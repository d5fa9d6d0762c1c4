// SPDX-License-Identifier: Apache-2.0
// Before training: do calibration, poses and clocks agree with the images? Each camera's own images
// say how it moved (sights.h); what is recorded is compared with that, and so is what would be
// recorded if one of the usual mistakes had been made. Clocks are also asked of what is bright to a
// LiDAR and in an image (lidar_contrast.h): straight on at one speed the images alone do not tell
// them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "redrive/align/lidar/contrast.h"
#include "redrive/align/preflight/correspondences.h"
#include "redrive/align/preflight/time_offset_scan.h"
#include "redrive/align/rig/rig_images.h"

namespace redrive {

struct ContrastPoint {
  double offset_ms = 0, correlation = 0;
};

enum class Verdict { kGood, kUsable, kWrong, kCannotTell };
const char* verdict_name(Verdict verdict);  ///< "good", "usable", "wrong", "cannot tell"

/// What may be wrong, as --json names it.
enum class Fault {
  kNone,
  kInvertedExtrinsic,  ///< RT_body_from_sensor is its inverse
  kSwappedCameras,     ///< it is another camera's
  kAxesConvention,     ///< its camera or body axes are of another convention
  kWrongRate,          ///< images come faster or slower than the poses they are given
  kUnsynchronised,     ///< images are exposed at another time
  kUnexplained         ///< none of these
};
const char* fault_name(Fault fault);  ///< "", "inverted_extrinsic", "swapped_cameras", ...

/// What would have to be recorded, and how well images agree with it.
struct Hypothesis {
  Fault fault = Fault::kNone;
  std::string
      what;  ///< "as recorded", "extrinsic inverted", "has the extrinsic of M_FISHEYE_R", ...
  double error_px = 0;  ///< median of correspondence_error_px
};

/// What is known of when a camera exposes.
struct TimeOffsetEstimate {
  double
      offset_ms = 0,
      sigma_ms =
          0;  ///< added to the recorded one; one standard deviation, infinite where it is not known
  bool by_lidar = false;  ///< or by how the images move
};

struct CameraCheck {
  std::string name;
  Verdict verdict = Verdict::kCannotTell;
  Fault fault = Fault::kNone;
  std::string why;     ///< a sentence
  int points = 0;      ///< compared
  double flow_px = 0;  ///< median of how far the points have moved
  int scale = 1;  ///< all pixels are those of an image so many times smaller than the recorded one
  std::vector<Hypothesis> tried;  ///< as recorded first, then by error
  std::vector<ScanPoint> scan;    ///< over time offsets, added to the recorded one
  double offset_ms = 0;           ///< of the scan's minimum, by a parabola through it
  double offset_error_px = 0;     ///< there
  double offset_sigma_ms =
      0;  ///< of it, by the jackknife over the pairs of images; infinite for less than four
  bool offset_observable = false;       ///< the scan has a minimum: a drive without turns and bumps
                                        ///< looks the same at any time
  std::vector<ContrastPoint> contrast;  ///< with the LiDAR, over time offsets, added to the
                                        ///< recorded one; empty: not looked at
  std::optional<TimeOffsetEstimate> by_lidar;  ///< where that is highest, if it tells

  TimeOffsetEstimate by_images() const {
    return {offset_ms, offset_sigma_ms, false};
  }  ///< the scan's minimum, told or not
  /// The surer of what the scan and the LiDAR say; nothing where neither tells.
  std::optional<TimeOffsetEstimate> clock() const;
};

/// Whether frames and LiDAR points run by the same clock.
struct ClockCheck {
  Verdict verdict = Verdict::kCannotTell;
  double frame_seconds_per_lidar_second = 1;
  std::string why;
};

struct Preflight {
  std::vector<CameraCheck> cameras;  ///< as Recording::cameras
  ClockCheck clock;
  bool sensible() const;         ///< training makes sense: nothing is wrong
  std::string headline() const;  ///< what that means, and which cameras cannot be told
};

/// Of what was tried, as CameraCheck has it, with at least one beside "as recorded": what fits the
/// images best and beside it, where they fit nearly as well (an error at most a quarter larger),
/// the next two: "A, or B: then half of the points agree to 0.40 or 0.44 px, as ...".
std::string explanation_of(const std::vector<Hypothesis>& tried);

/// Of a drive (Recording::metric); of photographs it cannot tell. `images`: of the same recording,
/// 640 pixels wide and less are enough. `lidar`: its returns, for the clocks; none: the images
/// alone say what they can.
Preflight check_recording(const Recording& recording, const RigImages& images,
                          const std::vector<LidarSample>& lidar, ThreadPool& pool,
                          const CorrespondenceOptions& options = {});

/// Times of LiDAR revolutions against those of the frames they are named after.
ClockCheck check_clock(const Recording& recording);

}  // namespace redrive
