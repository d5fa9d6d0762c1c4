// SPDX-License-Identifier: Apache-2.0
// Excerpts of drives: lists of poses, scans and boxes often cover other frames than the images do.
#pragma once

#include "redrive/recording/core/recording.h"

namespace redrive {

/// Leaves out the frames of a drive that no camera has an image of and no scan that can be used: a
/// finding counts them. A drive's point cloud, which is in the axes of its first frame, goes with
/// that, and a finding says so. Photographs keep all, and so does a drive that has neither.
void leave_out_empty_frames(Recording* recording);

/// Adds findings of a drive about images that frames lack, frames that have scans alone, and scans
/// and boxes that belong to no frame.
void report_gaps(Recording* recording);

/// Drops the point cloud of a drive if it is in the axes of a frame that is not `first`, the first
/// one from now on. A finding says so.
void drop_foreign_points(const FramePose& first, Recording* recording);

}  // namespace redrive
