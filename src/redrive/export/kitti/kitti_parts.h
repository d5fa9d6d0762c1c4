// SPDX-License-Identifier: Apache-2.0
// Parts that drives of KITTI and of KITTI-360 have in common.
#pragma once

#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include "redrive/export/drive.h"

namespace redrive {

/// Cameras by folder, image_00 to image_03.
using KittiSlots = std::map<std::string, const RecordedCamera*>;

bool is_perspective(const CameraCalibration& camera);

/// Gives each camera a folder that `fits`: the one of its name, else the first free one, from left
/// to right. Cameras without one go to `left`.
KittiSlots fill_slots(
    const std::vector<const RecordedCamera*>& cameras, const std::vector<std::string>& folders,
    const std::function<bool(const CameraCalibration& camera, const std::string& folder)>& fits,
    std::vector<const RecordedCamera*>* left, DriveNotes* notes);

/// DriveFormat::cameras of KITTI and KITTI-360.
WrittenCameras kitti_cameras(const Recording& drive, DriveNotes* notes);
WrittenCameras kitti360_cameras(const Recording& drive, DriveNotes* notes);

/// Frames at the times of the first camera, as readers take them.
struct KittiFrames {
  std::vector<FramePose> frames;  ///< ids and times as written, poses at these times
  std::int64_t offset_ns = 0;     ///< time offset of the first camera
  std::int64_t earlier_ids = 0;   ///< what written ids are less than the drive's
};

/// `from_zero`: ids begin at 0, otherwise they stay where they fit into files of a line for every
/// number. InputError: ids that do not fit, dates before 1970.
KittiFrames frames_of_first_camera(const Recording& drive, std::int64_t offset_ns, bool from_zero,
                                   DriveNotes* notes);

/// Writes timestamps.txt of a camera into `folder`. Notes by how much interpolation from the poses
/// of the first camera misses the camera's own.
void write_camera_times(const std::filesystem::path& folder, const std::string& name,
                        const RecordedCamera& camera, const Recording& drive,
                        const KittiFrames& frames, DriveNotes* notes);
void note_rolling(const KittiSlots& slots, DriveNotes* notes);
/// Notes what became of the images of a camera that is not written as recorded.
void note_resampled(const std::string& name, const CameraCalibration& recorded,
                    const PhotoCamera& camera, DriveNotes* notes);

/// Returns P_rect, R_rect and S_rect of a pinhole. `number`: "00". `first_in_camera`: place of the
/// rectified camera 0 in the camera's axes; both have the same axes.
std::string perspective_lines(const CameraCalibration& camera, const std::string& number,
                              const Eigen::Vector3d& first_in_camera);

/// The day of a time in names: "2011_09_26", UTC.
std::string date_of(std::int64_t t_ns);

/// printf into a string, up to 255 characters.
std::string formatted(const char* format, auto... values) {
  char text[256];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}
/// The first `rows` rows of a matrix in one line.
std::string row_text(const Rigid3d& transform, int rows);

}  // namespace redrive
