// SPDX-License-Identifier: Apache-2.0
// KITTI (Geiger, Lenz, Stiller, Urtasun: "Vision meets Robotics: The KITTI Dataset", IJRR 2013).
//
// Raw drives, synced and rectified: <date>/<drive>_sync with image_00..image_03, oxts,
// velodyne_points, and label_02/<sequence>.txt (the tracking benchmark's) or tracklet_labels.xml;
// calibration in <date>. Sequences of the odometry benchmark: sequences/NN with calib.txt,
// times.txt, image_0..image_3 and velodyne; poses in poses/NN.txt beside `sequences`. Sequences of
// the tracking benchmark: training/image_02/NNNN, velodyne/NNNN, and oxts, calib and label_02 with
// NNNN.txt.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::kitti {

bool looks_like(const std::filesystem::path& root);  ///< a raw drive
Recording open(const std::filesystem::path& root, PoseSource source);

bool looks_like_odometry(const std::filesystem::path& root);
Recording open_odometry(const std::filesystem::path& root, PoseSource source);

/// The folder `training`, with one sequence or with the sequence appended as if it were a
/// subfolder, or a sequence's folder of images.
bool looks_like_tracking(const std::filesystem::path& root);
Recording open_tracking(const std::filesystem::path& root, PoseSource source);

/// Mounting by Fig. 3 of the paper, and by calib_imu_to_velo.txt, whose Velodyne is in the middle
/// of the car: the body's origin, on the ground under the middle of the rear axle, in the axes of
/// the IMU; and the body in the axes of the rectified camera 0, 1.65 m above the ground and 1.03 m
/// ahead of the rear axle, which is mounted level.
Rigid3d imu_from_body();
Rigid3d rectified_from_body();

}  // namespace redrive::kitti
