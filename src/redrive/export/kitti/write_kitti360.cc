// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/camera/models.h"
#include "redrive/export/drive.h"
#include "redrive/export/kitti/kitti_parts.h"
#include "redrive/export/kitti/velodyne_scans.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/kitti/kitti.h"
#include "redrive/recording/formats/kitti/kitti_write.h"
#include "redrive/recording/formats/kitti360/kitti360.h"
#include "redrive/recording/formats/kitti360/kitti360_boxes.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr int kMaxInstances = 999;  // instances of a class, at most

// ---- Cameras

bool is_fisheye_of_format(const CameraCalibration& camera) {
  constexpr std::size_t kK3 = 8;
  return camera.model == "mei" && camera.parameters[kK3] == 0;
}
/// Gives each camera a folder of its kind.
KittiSlots assign_slots(const Recording& drive, DriveNotes* notes) {
  const auto fits = [](const CameraCalibration& camera, const std::string& slot) {
    return slot < "image_02" ? is_perspective(camera) : is_fisheye_of_format(camera);
  };
  std::vector<const RecordedCamera*> cameras, left;
  for (const RecordedCamera& camera : drive.cameras) cameras.push_back(&camera);
  KittiSlots slots =
      fill_slots(cameras, {"image_00", "image_01", "image_02", "image_03"}, fits, &left, notes);
  for (const RecordedCamera* camera : left) {
    const CameraCalibration& calibration = camera->calibration;
    const bool known = is_perspective(calibration) || is_fisheye_of_format(calibration);
    notes->left_out.push_back(
        "camera " + calibration.name + " (" + calibration.model + "): " +
        (known ? "KITTI-360 has two perspective cameras and two fisheyes"
               : "KITTI-360 has pinholes, and fisheyes of the model mei without k3"));
  }
  if (slots.empty())
    throw InputError(drive.root, "", "",
                     "has no camera that KITTI-360 can say: a perspective one, or a fisheye of the "
                     "model mei without k3");
  return slots;
}

std::string fisheye_yaml(const CameraCalibration& camera, const std::string& name) {
  const std::vector<double>& p = camera.parameters;
  std::string text = "%YAML:1.0\nmodel_type: MEI\ncamera_name: " + name + "\n";
  text += formatted("image_width: %d\nimage_height: %d\n", camera.width, camera.height);
  text += formatted("mirror_parameters:\n   xi: %.17g\n", p[9]);
  text += formatted("distortion_parameters:\n   k1: %.17g\n   k2: %.17g\n", p[4], p[5]);
  text += formatted("   p1: %.17g\n   p2: %.17g\n", p[6], p[7]);
  text += formatted("projection_parameters:\n   gamma1: %.17g\n   gamma2: %.17g\n", p[0], p[1]);
  return text + formatted("   u0: %.17g\n   v0: %.17g\n", p[2], p[3]);
}

/// Returns the pose of the camera from which calib_cam_to_velo.txt starts.
Rigid3d body_from_first_camera(const KittiSlots& slots) {
  const auto first = slots.find("image_00");
  return first == slots.end() ? kitti::rectified_from_body().inverse(Eigen::Isometry)
                              : first->second->calibration.body_from_sensor;
}

void write_cameras(const kitti360::Layout& layout, const KittiSlots& slots,
                   std::int64_t earlier_ids, ThreadPool& pool, const std::atomic<bool>& stop,
                   DriveNotes* notes) {
  const Rigid3d body_from_first = body_from_first_camera(slots);
  PhotoSet photos;
  std::string perspective, places;
  const auto add_place = [&](const std::string& name, const Rigid3d& body_from_camera) {
    places += name + ": " + row_text(kitti360::imu_from_body() * body_from_camera, 3) + "\n";
  };
  if (!slots.contains("image_00")) add_place("image_00", body_from_first);
  make_folders(layout.calibration());
  for (const auto& [name, recorded] : slots) {
    const CameraCalibration& calibration = recorded->calibration;
    add_place(name, calibration.body_from_sensor);
    if (is_perspective(calibration)) {
      photos.cameras.push_back(pinhole_photo_camera(calibration));
      const PhotoCamera& camera = photos.cameras.back();
      perspective += perspective_lines(
          camera.calibration, name.substr(6),
          (calibration.body_from_sensor.inverse(Eigen::Isometry) * body_from_first).translation());
      note_resampled(name, calibration, camera, notes);
    } else {
      photos.cameras.push_back(photo_camera(calibration, is_fisheye_of_format));
      write_file(layout.calibration() / (name + ".yaml"), fisheye_yaml(calibration, name));
    }
    add_photos(
        *recorded,
        [&, slot = name](const ImageFile& image) {
          return layout.images(slot).lexically_relative(layout.root) /
                 kitti::file_name(image.frame_id - earlier_ids, ".png");
        },
        &photos);
  }
  write_file(layout.calibration() / "perspective.txt",
             perspective.empty() ? "corner_dist: 0\n" : perspective);
  write_file(layout.calibration() / "calib_cam_to_pose.txt", places);
  write_drive_images(layout.root, {}, photos, pool, stop, notes);
}

// ---- Poses and times

void write_poses(const kitti360::Layout& layout, const std::vector<FramePose>& frames,
                 const Rigid3d& world_from_global, const KittiSlots& slots) {
  const Rigid3d body_from_imu = kitti360::imu_from_body().inverse(Eigen::Isometry);
  const Rigid3d body_from_camera = body_from_first_camera(slots);
  std::string poses, cameras;
  for (const FramePose& frame : frames) {
    const Rigid3d world_from_body = world_from_global * frame.global_from_body;
    poses += std::to_string(frame.id) + " " + row_text(world_from_body * body_from_imu, 3) + "\n";
    cameras +=
        std::to_string(frame.id) + " " + row_text(world_from_body * body_from_camera, 4) + "\n";
  }
  make_folders(layout.poses());
  write_file(layout.poses() / "poses.txt", poses);
  write_file(layout.poses() / "cam0_to_world.txt", cameras);
}

// ---- Boxes

std::vector<kitti360::Object> objects_of(const Recording& drive,
                                         const std::vector<FramePose>& frames,
                                         const Rigid3d& world_from_global, std::int64_t earlier_ids,
                                         DriveNotes* notes) {
  struct Track {
    bool moves = false;
    std::vector<kitti360::Object> boxes;
  };
  std::map<std::int64_t, Track> tracks;
  for (const FrameFile& file : drive.box_files) {
    const std::int64_t id = file.frame_id - earlier_ids;
    const auto frame = std::ranges::lower_bound(frames, id, {}, &FramePose::id);
    if (frame == frames.end() || frame->id != id) continue;
    for (const Box& box : drive.reader->read_boxes(file)) {
      Track& track = tracks[box.object_id];
      track.moves |= kind_of(box.type).always_moves ||
                     velocity_in_global(box, drive.frames).norm() > kMovingSpeed_m_per_s;
      kitti360::Object object;
      object.type = box.type;
      object.frame_id = object.first_frame = object.last_frame = id;
      object.world_from_box =
          world_from_global * global_from_box_at(box, drive.frames, frame->t_ns);
      object.size_m = box.size_m;
      track.boxes.push_back(std::move(object));
    }
  }
  std::map<int, int> instances;
  std::set<std::string> renamed;
  std::vector<kitti360::Object> objects;
  std::size_t dropped = 0;
  for (auto& [id, track] : tracks) {
    const kitti360::ObjectClass& what = kitti360::class_named(track.boxes.front().type);
    if (track.boxes.front().type != what.name)
      renamed.insert(track.boxes.front().type + " as " + std::string(what.name));
    const int instance = ++instances[what.label_id];
    if (instance > kMaxInstances) {
      ++dropped;
      continue;
    }
    const std::int64_t first = track.boxes.front().frame_id, last = track.boxes.back().frame_id;
    if (!track.moves) {  // one box for all frames: the middle one
      kitti360::Object middle = track.boxes[track.boxes.size() / 2];
      middle.frame_id = kitti360::kStatic;
      track.boxes = {middle};
    }
    for (kitti360::Object& object : track.boxes) {
      object.id = 1000 * what.label_id + instance;
      object.first_frame = first, object.last_frame = last;
      objects.push_back(object);
    }
  }
  for (const std::string& names : renamed) notes->changed.push_back("boxes of type " + names);
  notes->changed.emplace_back(
      "objects that stand have one box for all frames; identities and "
      "velocities of boxes are new");
  if (dropped > 0)
    notes->left_out.push_back(counted(dropped, "object") + " beyond 999 of its class");
  return objects;
}

}  // namespace

WrittenCameras kitti360_cameras(const Recording& drive, DriveNotes* notes) {
  DriveNotes of_folders;
  WrittenCameras cameras;
  for (const auto& [name, recorded] : assign_slots(drive, &of_folders))
    cameras.emplace(recorded->calibration.name,
                    is_perspective(recorded->calibration)
                        ? pinhole_photo_camera(recorded->calibration)
                        : photo_camera(recorded->calibration, is_fisheye_of_format));
  notes->left_out.insert(notes->left_out.end(), of_folders.left_out.begin(),
                         of_folders.left_out.end());
  return cameras;
}

DriveNotes write_kitti360(const fs::path& folder, const Recording& drive, ThreadPool& pool,
                          const std::atomic<bool>& stop) {
  DriveNotes notes;
  const KittiSlots slots = assign_slots(drive, &notes);
  const auto [frames, offset_ns, earlier_ids] = frames_of_first_camera(
      drive, slots.begin()->second->calibration.time_offset_ns, false, &notes);
  const Rigid3d world_from_global = local_from_global(drive);
  if (drive.global_frame == GlobalFrame::kEcef)
    notes.changed.push_back("the world is the body frame (x forward, y left, z up) of frame " +
                            std::to_string(drive.frames.front().id) + ", not ECEF");
  const kitti360::Layout layout{folder, date_of(frames.front().t_ns) + "_drive_0000_sync"};

  write_cameras(layout, slots, earlier_ids, pool, stop, &notes);
  for (const auto& [name, camera] : slots)
    write_camera_times(layout.camera(name), name, *camera, drive, {frames, offset_ns, earlier_ids},
                       &notes);
  note_rolling(slots, &notes);
  write_poses(layout, frames, world_from_global, slots);
  if (!write_velodyne_scans(layout.velodyne(), drive, frames, earlier_ids, pool, stop, &notes)
           .empty())
    write_file(layout.calibration() / "calib_cam_to_velo.txt",
               row_text(spinning_axes(drive.lidars[0].body_from_lidar).inverse(Eigen::Isometry) *
                            body_from_first_camera(slots),
                        3) +
                   "\n");
  if (!drive.box_files.empty()) {
    make_folders(layout.boxes().parent_path());
    write_file(layout.boxes(), kitti360::make_objects(objects_of(drive, frames, world_from_global,
                                                                 earlier_ids, &notes)));
  }
  if (!drive.points_file.empty()) notes.left_out.emplace_back("the static point cloud");
  note_left_out(drive, &notes);
  return notes;
}

}  // namespace redrive
