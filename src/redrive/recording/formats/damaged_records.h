// SPDX-License-Identifier: Apache-2.0
// Records that cannot be used: files of images, masks, scans and boxes that are damaged, and poses
// and times that cannot be, which readers leave out. Each costs itself alone where they are few.
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

  FrameRange frames = {};                     ///< looks at their records; the step does not count
  std::vector<std::string> cameras = {};      ///< of these few may be damaged; empty: of all
  double most_percent = kMostDamagedPercent;  ///< 0 to 100
  std::size_t whole = 0;  ///< records of each sensor that are read from end to end, spread over it
};

/// Reads the head of an image's file or its mask's; all of it if `whole`, or where the head is
/// unusual or the file does not end as its kind does. InputError if it is damaged or has another
/// size than the calibration says.
void check_image(const std::filesystem::path& file, const CameraCalibration& camera, bool whole);

/// Leaves out images, scans and boxes whose files are damaged, and adds them to
/// Recording::damaged. Looks at the head and the end of each file: an image has to have the size of
/// the calibration, a scan as many returns as it says, text to be readable. An image goes with its
/// mask. A finding for each sensor counts and names what is left out, the readers' part, too.
/// Returns the sensors of which more than `most_percent` and more than one record is damaged.
std::vector<Finding> leave_out_damaged(const DamageCheck& check, Recording* recording);

/// As leave_out_damaged. InputError for sensors of which too much is damaged, and where no image is
/// left.
void require_few_damaged(const DamageCheck& check, Recording* recording);

/// Adds records that are left out already, of the recording's frames, to Recording::damaged, and a
/// finding about them. InputError if they are too many.
void require_few_left_out(const DamageCheck& check, const std::vector<DamagedRecord>& damaged,
                          Recording* recording);

/// A finding about records of a sensor that turned out to be damaged when they were read.
/// InputError if they are more of its `all` records than the recording allows. Nothing without any.
std::optional<Finding> judge_damaged(const Recording& recording,
                                     const std::vector<DamagedRecord>& damaged, std::size_t all);

}  // namespace redrive
