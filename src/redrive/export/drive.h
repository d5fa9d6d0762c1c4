// SPDX-License-Identifier: Apache-2.0
// A recording as a drive in the format of a data set: rig, trajectory, LiDAR and boxes, as
// recorded, aligned or refined. Lists what does not fit.
#pragma once

#include <atomic>
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/export/photo_set.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Messages about an export.
struct DriveNotes {
  std::vector<std::string> changed;   ///< what is written in another form
  std::vector<std::string> left_out;  ///< what is not written
  /// Images in the written folder, by the recorded files; none where they lie in an archive.
  std::map<std::filesystem::path, std::filesystem::path> images;
};

/// Returns the part of a recording that its scene uses, with the scene's poses, extrinsics and time
/// offsets. Poses, LiDAR and boxes range from the scene's first to its last frame. InputError for
/// photographs, which have neither metres nor times.
Recording drive_of_scene(const Recording& recording, const Scene& scene);

/// Adds the image files of a camera to a set of photos: `name(frame id)` is their new path.
template <class Name>
void add_photos(const RecordedCamera& camera, const Name& name, PhotoSet* set) {
  for (const ImageFile& image : camera.images)
    set->photos.push_back({name(image), image.path, static_cast<int>(set->cameras.size()) - 1,
                           Rigid3d::Identity(), image.mask, image.held_out});
}

/// Writes the images below a folder of the drive and lists them in `notes`. Throws as write_images.
void write_drive_images(const std::filesystem::path& folder, const std::filesystem::path& below,
                        const PhotoSet& set, ThreadPool& pool, const std::atomic<bool>& stop,
                        DriveNotes* notes);

/// Velocity of a box in the global frame, m/s, and its pose there at t_ns.
Eigen::Vector3d velocity_in_global(const Box& box, const std::vector<FramePose>& frames);
Rigid3d global_from_box_at(const Box& box, const std::vector<FramePose>& frames, std::int64_t t_ns);

/// Returns the points of a scan that the scan before it does not repeat, and adds the number of the
/// others to `repeated`. `before`: null: there is none.
std::vector<LidarPoint> new_points(const Recording& drive, const FrameFile& scan,
                                   const FrameFile* before, std::size_t* repeated = nullptr);

/// Returns axes for the points of a spinning LiDAR, x forward and z up: the sensor's own, or the
/// body's at its place where these differ by more than 26 degrees.
Rigid3d spinning_axes(const Rigid3d& body_from_lidar);

/// Returns the identity, or for ECEF drives the axes of the body at the first frame.
Rigid3d local_from_global(const Recording& drive);

/// Names the world of `local_from_global` where it is not the recording's. `name`: the format's
/// word.
void note_world(const Recording& drive, const char* name, DriveNotes* notes);
/// Returns the nanoseconds to add to the drive's times: 0, or for a drive that begins before 10 s,
/// with a note, as many as let it begin there, since sensors may begin before the first frame.
std::int64_t added_to_times_ns(const Recording& drive, DriveNotes* notes);
/// Adds a camera to a set of pinholes, with notes on its lens and its rolling shutter.
void add_pinhole(const CameraCalibration& camera, PhotoSet* set, DriveNotes* notes);

/// Adds notes on what no format of drives has: other poses, novel views, LiDAR without a place.
void note_not_of_drives(const Recording& drive, DriveNotes* notes);
/// Adds a note on masks of images.
void note_masks(const Recording& drive, DriveNotes* notes);
/// Adds both, and a note on all LiDARs but the first.
void note_left_out(const Recording& drive, DriveNotes* notes);

/// Writes KITTI-360's layout (recording/formats/kitti360/kitti360.h) with up to two perspective
/// cameras and two fisheyes. InputError for a file that cannot be read and a drive without such a
/// camera; IoError; Interrupted once `stop` is set.
DriveNotes write_kitti360(const std::filesystem::path& folder, const Recording& drive,
                          ThreadPool& pool, const std::atomic<bool>& stop);

/// Writes KITTI's layout of raw drives (recording/formats/kitti/kitti.h), DATE/DATE_drive_0000_sync
/// below `folder`, with up to four cameras that look within 10 degrees of each other, rectified to
/// the axes of one of them. A drive without a place on the Earth begins at latitude and longitude
/// 0. Throws as write_kitti360.
DriveNotes write_kitti(const std::filesystem::path& folder, const Recording& drive,
                       ThreadPool& pool, const std::atomic<bool>& stop);

/// Writes aiMotive's layout (recording/formats/aimotive/aimotive.h). Throws as write_kitti360.
DriveNotes write_aimotive(const std::filesystem::path& folder, const Recording& drive,
                          ThreadPool& pool, const std::atomic<bool>& stop);

/// Writes a scene of nuScenes' layout, DATA/v1.0-redrive and its files below DATA (`folder`), with
/// all cameras as pinholes. Throws as write_kitti360.
DriveNotes write_nuscenes(const std::filesystem::path& folder, const Recording& drive,
                          ThreadPool& pool, const std::atomic<bool>& stop);

/// Writes a log in Argoverse 2's layout (recording/formats/argoverse2/argoverse2.h), with all
/// cameras as pinholes and two LiDARs of up to 32 beams or one of more. Throws as write_kitti360.
DriveNotes write_argoverse2(const std::filesystem::path& folder, const Recording& drive,
                            ThreadPool& pool, const std::atomic<bool>& stop);

/// Writes a sequence of NVIDIA's NCore, version 4 (export/ncore/ncore_sequence.h), with all cameras
/// and LiDARs. Throws as write_kitti360.
DriveNotes write_ncore(const std::filesystem::path& folder, const Recording& drive,
                       ThreadPool& pool, const std::atomic<bool>& stop);

/// Cameras of the written images, by the names of the recorded ones.
using WrittenCameras = std::map<std::string, PhotoCamera>;

/// A layout of drives.
struct DriveFormat {
  std::string_view name;  ///< value of --to
  /// Cameras for which it has no place are left out and named. Throws as write_kitti360.
  WrittenCameras (*cameras)(const Recording& drive, DriveNotes* notes);
  DriveNotes (*write)(const std::filesystem::path& folder, const Recording& drive, ThreadPool& pool,
                      const std::atomic<bool>& stop);
};
std::span<const DriveFormat> drive_formats();

}  // namespace redrive
