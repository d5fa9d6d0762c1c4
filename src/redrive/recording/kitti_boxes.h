// SPDX-License-Identifier: Apache-2.0
// Annotated objects of KITTI: label_02/<sequence>.txt of the tracking benchmark, a line for each
// object and frame, in the axes of the rectified camera 0; or tracklet_labels.xml of raw drives, in
// the axes of the Velodyne. Both give the centre of a box's bottom.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/recording/box.h"
#include "redrive/recording/kitti_scan.h"
#include "redrive/recording/recording.h"

namespace redrive::kitti {

/// An object in one frame.
struct Label {
  std::int64_t frame_id = 0, object_id = 0;
  std::string type;         ///< "Car", "Pedestrian", ...
  Rigid3d sensor_from_box;  ///< axes and origin of the box as in Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
  bool deforms = false;  ///< as in Box
};

/// Lines of 17 values, or 18 with a score: frame, track, type, truncated, occluded, alpha, left,
/// top, right, bottom, height, width, length, x, y, z, rotation_y. DontCare lines, which have no
/// box, are left out. InputError: other numbers of values, values that are not finite, unknown
/// types, sizes outside 0.01..100 m, positions further than 1000 m, an object twice in a frame.
std::vector<Label> parse_labels(std::string_view text, const std::filesystem::path& file);

/// Objects are numbered as they stand in the file. InputError as parse_labels, malformed XML and
/// missing elements.
std::vector<Label> parse_tracklets(std::string_view text, const std::filesystem::path& file);

/// The sensor of the labels, and the times at which the Velodyne saw them.
struct LabelPlacement {
  Rigid3d body_from_sensor, body_from_velodyne;
  std::map<std::int64_t, ScanTime> scans;  ///< by frame; a frame without one has its own time
};

/// Boxes of the frames that have a pose, by frame. Each holds at the time at which the laser points
/// at its centre. Velocities are least-squares slopes of the positions within half a second.
std::map<std::int64_t, std::vector<Box>> place_boxes(const std::vector<Label>& labels,
                                                     const LabelPlacement& placement,
                                                     const std::vector<FramePose>& frames);

}  // namespace redrive::kitti
