// SPDX-License-Identifier: Apache-2.0
// Excerpts of drives: lists of poses, scans and boxes often cover other frames than the images.
#pragma once

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Drops the frames of a drive with neither an image nor a usable scan: a finding counts them. With
/// a frame goes a drive's point cloud in its axes, and a finding says so. Photographs keep all, and
/// so does a drive that has neither.
void leave_out_empty_frames(Recording* recording);

/// Adds findings about images that frames of a drive lack, frames that have only scans, and scans
/// and boxes that belong to no frame.
void report_gaps(Recording* recording);

/// Drops the point cloud of a drive if it is in the axes of a frame other than `first`, the new
/// first frame. A finding says so.
void drop_foreign_points(const FramePose& first, Recording* recording);

}  // namespace redrive
