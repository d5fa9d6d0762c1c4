// SPDX-License-Identifier: Apache-2.0
// Annotated objects of KITTI: label_02/<sequence>.txt of the tracking benchmark, a line for each
// object and frame, in the axes of the rectified camera 0; or tracklet_labels.xml of raw drives, in
// the axes of the Velodyne. Both give the centre of a box's bottom.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string_view>
#include <vector>

#include "redrive/recording/core/labels.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"

namespace redrive::kitti {

/// Parses lines of 17 values, or 18 with a score: frame, track, type, truncated, occluded, alpha,
/// left, top, right, bottom, height, width, length, x, y, z, rotation_y. Skips DontCare lines,
/// which have no box. InputError: other numbers of values, values that are not finite, unknown
/// types, sizes outside 0.01..100 m, positions further than 1000 m, an object twice in a frame.
std::vector<Label> parse_labels(std::string_view text, const std::filesystem::path& file);

/// Objects are numbered as they stand in the file. InputError as parse_labels, malformed XML and
/// missing elements.
std::vector<Label> parse_tracklets(std::string_view text, const std::filesystem::path& file);

/// Returns the time at which the laser points at a label's centre in the scan of its frame, the
/// frame's own time without one. `scans`: keyed by frame.
TimeOfLabel time_in_scans(const Rigid3d& velodyne_from_sensor,
                          std::map<std::int64_t, ScanTime> scans);

}  // namespace redrive::kitti
