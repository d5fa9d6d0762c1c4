// SPDX-License-Identifier: Apache-2.0
// Frames of drives whose images have times instead of numbers.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/trajectory.h"

namespace redrive {

struct TimedImages {
  std::string camera;
  std::int64_t offset_ns = 0;     ///< CameraCalibration::time_offset_ns
  std::vector<FrameFile> images;  ///< frame_id: time in ns, after join_frames the frame
};

/// Sets the offset of each camera: the median of the times of its images after the images of the
/// first camera that are nearest to them. `same_trigger_ns`: images further apart do not count.
void set_time_offsets(std::int64_t same_trigger_ns, std::vector<TimedImages>* cameras);

/// Cameras fire as the laser passes them, so a trigger of all of them repeats to a millisecond, and
/// triggers are 50 ms apart or more. A car at 15 m/s moves by 7 cm in this time.
constexpr std::int64_t kOneFrame_ns = 5'000'000;

/// Cameras with times of their own that agree to this share a frame: a car at 15 m/s moves by 1.5
/// cm.
constexpr std::int64_t kSameImage_ns = 1'000'000;

/// Makes frames of the images whose times minus their cameras' offsets agree to `same_ns`, numbered
/// by time. A frame has the pose at the time of its earliest image minus the offset. An image at
/// the time of another one of its camera is left out and damaged; `file` is for messages.
std::vector<FramePose> join_frames(const std::vector<FramePose>& poses,
                                   const std::filesystem::path& file,
                                   std::vector<TimedImages>* cameras,
                                   std::vector<DamagedRecord>* damaged,
                                   std::int64_t same_ns = kOneFrame_ns);

/// Returns the frame that is nearest in time; `frames`: at least one.
const FramePose& nearest_frame(const std::vector<FramePose>& frames, std::int64_t t_ns);

/// Adds cameras whose images have frames in `recording`. `calibrations`: all cameras', keyed by
/// name. InputError if no image is left.
void add_posed_cameras(std::vector<TimedImages> cameras,
                       const std::map<std::string, CameraCalibration>& calibrations,
                       Recording* recording);

/// Adds frames and cameras of a rig of any kind: cameras that are triggered together share frames,
/// others run freely, each image with a frame of its own. Frames further than 0.25 s from a pose
/// are left out. `calibrations`: all cameras', keyed by name. `same_ns`: as join_frames has it.
/// `file`, `fields`: the poses', for messages. InputError if no image is left.
void add_timed_cameras(const std::vector<FramePose>& poses, const std::filesystem::path& file,
                       const PoseFields& fields, std::vector<TimedImages> cameras,
                       const std::map<std::string, CameraCalibration>& calibrations,
                       std::int64_t same_ns, Recording* recording);

/// Adds the scans of a LiDAR, each to the frame nearest to its middle. `scans`: frame_id is the
/// time of the middle in ns. A finding counts those without an image within 0.1 s.
void add_timed_scans(std::vector<FrameFile> scans, const std::string& lidar, Recording* recording);

}  // namespace redrive
