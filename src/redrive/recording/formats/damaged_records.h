// SPDX-License-Identifier: Apache-2.0
// Records that cannot be used: damaged files of images, masks, scans and boxes, and impossible
// poses and times, which readers drop. Each costs only itself where they are few.
#pragma once

#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

struct DamageCheck {
  static constexpr std::size_t kAll = std::numeric_limits<std::size_t>::max();

  FrameRange frames = {};  ///< range of the records to check; the step does not count
  std::vector<std::string> cameras = {};      ///< cameras of which few may be damaged; empty: all
  double most_percent = kMostDamagedPercent;  ///< 0 to 100
  std::size_t whole = 0;  ///< records of each sensor that are read from end to end, spread over it
};

/// Reads the head of an image's file or its mask's; all of it if `whole`, or where the head is
/// unusual or the file does not end as its kind does. InputError if it is damaged or has another
/// size than the calibration says.
void check_image(const std::filesystem::path& file, const CameraCalibration& camera, bool whole);

/// Drops images, scans and boxes whose files are damaged, and adds them to Recording::damaged.
/// Looks at the head and the end of each file: an image must have the calibration's size, a scan as
/// many returns as it claims, text must be readable. An image goes with its mask. A finding for
/// each sensor counts and names what is dropped, including the readers' part. Returns the sensors
/// with more than `most_percent` and more than one damaged record.
std::vector<Finding> leave_out_damaged(const DamageCheck& check, Recording* recording);

/// The same, with InputError for sensors with too much damage, and where no image is left.
void require_few_damaged(const DamageCheck& check, Recording* recording);

/// Adds records that are left out already, of the recording's frames, to Recording::damaged, and a
/// finding about them. InputError if they are too many.
void require_few_left_out(const DamageCheck& check, const std::vector<DamagedRecord>& damaged,
                          Recording* recording);

/// Returns a finding about a sensor's records that turned out to be damaged when they were read.
/// InputError if they are more of its `all` records than the recording allows. Nothing without any.
std::optional<Finding> judge_damaged(const Recording& recording,
                                     const std::vector<DamagedRecord>& damaged, std::size_t all);

}  // namespace redrive
