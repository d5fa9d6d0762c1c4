// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/drive.h"

#include <algorithm>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/export/kitti/kitti_parts.h"
#include "redrive/export/ncore/ncore_terms.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

Recording drive_of_scene(const Recording& recording, const Scene& scene) {
  if (!recording.metric)
    throw InputError(recording.root, "", "",
                     "photographs have neither metres nor times, which a drive needs; export them "
                     "--to colmap or --to transforms");
  Recording drive = recording;
  drive.frames = scene.corrected_trajectory();
  keep_frames({scene.frames.front().id, scene.frames.back().id}, &drive);
  drive.cameras.clear();
  for (std::size_t c = 0; c < scene.rig.size(); ++c) {
    const RigCamera& rig = scene.rig[c];
    RecordedCamera camera{recording.find_camera(rig.name)->calibration, {}};
    camera.calibration.body_from_sensor = rig.body_from_sensor;
    camera.calibration.time_offset_ns = rig.time_offset_ns;
    camera.calibration.readout_ns = rig.readout_ns;
    camera.calibration.readout_by_column = rig.readout_by_column;
    for (const View& view : scene.views)
      if (view.camera == static_cast<int>(c)) {
        ImageFile image;
        image.frame_id = scene.frames[static_cast<std::size_t>(view.frame)].id;
        image.path = view.image;
        image.mask = view.mask;
        camera.images.push_back(image);
      }
    if (!camera.images.empty()) drive.cameras.push_back(std::move(camera));
  }
  return drive;
}

void write_drive_images(const std::filesystem::path& folder, const std::filesystem::path& below,
                        const PhotoSet& set, ThreadPool& pool, const std::atomic<bool>& stop,
                        DriveNotes* notes) {
  for (const Photo& photo : set.photos)
    notes->images[photo.source] = (below / photo.name).lexically_normal();
  write_images(folder / below, {}, set, pool, stop);
}

namespace {

template <class Written>
WrittenCameras all_cameras(const Recording& drive, const Written& written) {
  WrittenCameras cameras;
  for (const RecordedCamera& camera : drive.cameras)
    cameras.emplace(camera.calibration.name, written(camera.calibration));
  return cameras;
}
WrittenCameras as_recorded(const Recording& drive, DriveNotes*) {
  return all_cameras(drive, [](const CameraCalibration& camera) {
    return photo_camera(camera, [](const auto&) { return true; });
  });
}
WrittenCameras as_pinholes(const Recording& drive, DriveNotes*) {
  return all_cameras(drive,
                     [](const CameraCalibration& camera) { return pinhole_photo_camera(camera); });
}
WrittenCameras as_ncore(const Recording& drive, DriveNotes*) {
  return all_cameras(drive, [](const CameraCalibration& camera) {
    return photo_camera(camera, ncore::has_model);
  });
}

}  // namespace

std::span<const DriveFormat> drive_formats() {
  static constexpr DriveFormat kFormats[] = {
      {"aimotive", as_recorded, write_aimotive},      {"kitti", kitti_cameras, write_kitti},
      {"kitti360", kitti360_cameras, write_kitti360}, {"nuscenes", as_pinholes, write_nuscenes},
      {"argoverse2", as_pinholes, write_argoverse2},  {"ncore", as_ncore, write_ncore}};
  return kFormats;
}

Eigen::Vector3d velocity_in_global(const Box& box, const std::vector<FramePose>& frames) {
  return pose_at(frames, box.t_ns).linear() * box.velocity_in_body_m_per_s +
         velocity_at(frames, box.t_ns);
}

Rigid3d global_from_box_at(const Box& box, const std::vector<FramePose>& frames,
                           std::int64_t t_ns) {
  Rigid3d pose = pose_at(frames, box.t_ns) * box.body_from_box;
  if (t_ns != box.t_ns)
    pose.translation() +=
        1e-9 * static_cast<double>(t_ns - box.t_ns) * velocity_in_global(box, frames);
  return pose;
}

std::vector<LidarPoint> new_points(const Recording& drive, const FrameFile& scan,
                                   const FrameFile* before, std::size_t* repeated) {
  std::vector<LidarPoint> points = drive.read_lidar(scan);
  if (!before) return points;
  const std::vector<std::uint8_t> is_repeated = mark_repeated(points, drive.read_lidar(*before));
  std::size_t kept = 0;
  for (std::size_t i = 0; i < points.size(); ++i)
    if (!is_repeated[i]) points[kept++] = points[i];
  if (repeated) *repeated += points.size() - kept;
  points.resize(kept);
  return points;
}

Rigid3d local_from_global(const Recording& drive) {
  return drive.global_frame == GlobalFrame::kEcef
             ? drive.frames.front().global_from_body.inverse(Eigen::Isometry)
             : Rigid3d::Identity();
}

void note_world(const Recording& drive, const char* name, DriveNotes* notes) {
  if (drive.global_frame == GlobalFrame::kEcef)
    notes->changed.push_back("the " + std::string(name) +
                             " is the body frame (x forward, y left, z up) of frame " +
                             std::to_string(drive.frames.front().id) + ", not ECEF");
}

std::int64_t added_to_times_ns(const Recording& drive, DriveNotes* notes) {
  constexpr std::int64_t kFirst_ns = 10'000'000'000;
  const std::int64_t first_ns = drive.frames.front().t_ns;
  if (first_ns >= kFirst_ns) return 0;
  notes->changed.emplace_back("times count from 10 seconds before the first frame");
  return kFirst_ns - first_ns;
}

void add_pinhole(const CameraCalibration& camera, PhotoSet* set, DriveNotes* notes) {
  set->cameras.push_back(pinhole_photo_camera(camera));
  if (set->cameras.back().resampled) {
    char focal[80];
    std::snprintf(focal, sizeof focal, "): its images are resampled to a pinhole of %.1f pixels",
                  set->cameras.back().calibration.fx());
    notes->changed.push_back("the lens of " + camera.name + " (" + camera.model + focal);
  }
  if (camera.readout_ns != 0)
    notes->left_out.push_back("rolling shutter of " + camera.name +
                              ": each image has the time of its middle line");
}

Rigid3d spinning_axes(const Rigid3d& body_from_lidar) {
  constexpr double kNear = 0.9;
  if (body_from_lidar.linear()(0, 0) > kNear && body_from_lidar.linear()(2, 2) > kNear)
    return body_from_lidar;
  return Rigid3d(Eigen::Translation3d(body_from_lidar.translation()));
}

void note_not_of_drives(const Recording& drive, DriveNotes* notes) {
  if (!drive.novel.empty()) notes->left_out.emplace_back("novel views with their ground truth");
  if (!drive.ground_truth_frames.empty()) notes->left_out.emplace_back("ground-truth poses");
  if (!drive.lidar_files.empty() && drive.lidars.empty())
    notes->left_out.emplace_back("LiDAR, since the place of its sensor is unknown");
}

void note_masks(const Recording& drive, DriveNotes* notes) {
  const bool masked = std::ranges::any_of(drive.cameras, [](const RecordedCamera& camera) {
    return std::ranges::any_of(camera.images,
                               [](const ImageFile& image) { return !image.mask.path.empty(); });
  });
  if (masked) notes->left_out.emplace_back("masks of images");
}

void note_left_out(const Recording& drive, DriveNotes* notes) {
  note_masks(drive, notes);
  note_not_of_drives(drive, notes);
  for (std::size_t k = 1; k < drive.lidars.size(); ++k)
    notes->left_out.push_back("LiDAR " + drive.lidars[k].name + ": the format has one");
}

}  // namespace redrive
