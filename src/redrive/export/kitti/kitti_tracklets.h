// SPDX-License-Identifier: Apache-2.0
// Writes boxes as tracklet_labels.xml of KITTI's raw drives.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "redrive/export/drive.h"
#include "redrive/recording/core/labels.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"

namespace redrive::kitti {

/// Returns KITTI's type of an object of any data set: Car, Van, Truck, Pedestrian, Person
/// (sitting), Cyclist (also two-wheelers), Tram, or Misc.
std::string type_of(const std::string& type);

/// Returns the boxes of a drive in the Velodyne's axes when it looks at them. `frames`: as written,
/// `earlier_ids` less than the drive's. `scans`: revolutions by written id; in frames without one
/// boxes have the frame's time. Types are KITTI's; renamed ones are noted.
std::vector<Label> tracklets_of(const Recording& drive, const std::vector<FramePose>& frames,
                                std::int64_t earlier_ids, const Rigid3d& body_from_velodyne,
                                const std::map<std::int64_t, ScanTime>& scans, DriveNotes* notes);

/// Returns the file. A tracklet has a pose for each frame from its first one on, so an object
/// becomes several where frames are missing or its size or type changes.
std::string make_tracklets(std::vector<Label> labels);

}  // namespace redrive::kitti
