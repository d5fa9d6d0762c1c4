// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/camera/models.h"
#include "redrive/export/drive.h"
#include "redrive/export/kitti360_scans.h"
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
constexpr double kExact_m = 1e-6;

std::string formatted(const char* format, auto... values) {
  char text[256];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

/// The first `rows` rows of a matrix in one line.
std::string row_text(const Rigid3d& transform, int rows) {
  std::string text;
  for (int i = 0; i < 4 * rows; ++i)
    text += formatted(i == 0 ? "%.17g" : " %.17g", transform.matrix()(i / 4, i % 4));
  return text;
}

// ---- Cameras

bool is_fisheye_of_format(const CameraCalibration& camera) {
  constexpr std::size_t kK3 = 8;
  return camera.model == "mei" && camera.parameters[kK3] == 0;
}
bool is_perspective(const CameraCalibration& camera) {
  return find_camera_model(camera.model)->perspective;
}

using Slots = std::map<std::string, const RecordedCamera*>;  ///< key: folder, image_00 to image_03

/// Gives each camera a folder of its kind: the folder of its own name, else the next from left to
/// right.
Slots assign_slots(const Recording& drive, DriveNotes* notes) {
  Slots slots;
  std::vector<const RecordedCamera*> others;
  const auto fits = [](const CameraCalibration& camera, const std::string& slot) {
    return slot < "image_02" ? is_perspective(camera) : is_fisheye_of_format(camera);
  };
  const std::vector<std::string> names = {"image_00", "image_01", "image_02", "image_03"};
  for (const RecordedCamera& camera : drive.cameras) {
    const std::string& name = camera.calibration.name;
    if (std::ranges::find(names, name) != names.end() && fits(camera.calibration, name))
      slots[name] = &camera;
    else
      others.push_back(&camera);
  }
  std::ranges::stable_sort(others, std::ranges::greater(), [](const RecordedCamera* camera) {
    return camera->calibration.body_from_sensor.translation().y();
  });
  for (const RecordedCamera* camera : others) {
    const CameraCalibration& calibration = camera->calibration;
    const auto slot = std::ranges::find_if(names, [&](const std::string& name) {
      return !slots.contains(name) && fits(calibration, name);
    });
    if (slot != names.end()) {
      slots[*slot] = camera;
      notes->changed.push_back(calibration.name + " is " + *slot);
    } else {
      const bool known = is_perspective(calibration) || is_fisheye_of_format(calibration);
      notes->left_out.push_back(
          "camera " + calibration.name + " (" + calibration.model + "): " +
          (known ? "KITTI-360 has two perspective cameras and two fisheyes"
                 : "KITTI-360 has pinholes, and fisheyes of the model mei without k3"));
    }
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

/// P_rect, R_rect and S_rect of a perspective camera.
std::string perspective_lines(const CameraCalibration& camera, const std::string& number,
                              const Eigen::Vector3d& first_in_camera) {
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k(0, 0) = camera.fx(), k(1, 1) = camera.fy(), k(0, 2) = camera.cx(), k(1, 2) = camera.cy();
  Eigen::Matrix<double, 3, 4> p;
  p << k, k * first_in_camera;
  std::string text = formatted("S_rect_%s: %d %d\n", number.c_str(), camera.width, camera.height) +
                     "R_rect_" + number + ": 1 0 0 0 1 0 0 0 1\nP_rect_" + number + ":";
  for (int i = 0; i < 12; ++i) text += formatted(" %.17g", p(i / 4, i % 4));
  return text + "\n";
}

/// Returns the pose of the camera from which calib_cam_to_velo.txt starts.
Rigid3d body_from_first_camera(const Slots& slots) {
  const auto first = slots.find("image_00");
  return first == slots.end() ? kitti::rectified_from_body().inverse(Eigen::Isometry)
                              : first->second->calibration.body_from_sensor;
}

void write_cameras(const kitti360::Layout& layout, const Slots& slots, std::int64_t earlier_ids,
                   ThreadPool& pool, const std::atomic<bool>& stop, DriveNotes* notes) {
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
      if (camera.resampled)
        notes->changed.push_back("the lens of " + name + " (" + calibration.model +
                                 "): its images are resampled to a pinhole" +
                                 formatted(" with a focal length of %.1f instead of %.1f pixels",
                                           camera.calibration.fx(), calibration.fx()));
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
  write_images(layout.root, {}, photos, pool, stop);
}

// ---- Poses and times

/// Frames at the times of a camera with this offset.
std::vector<FramePose> frames_later_by(const std::vector<FramePose>& frames, std::int64_t offset_ns,
                                       std::int64_t earlier_ids) {
  std::vector<FramePose> later;
  for (const FramePose& frame : frames) {
    const std::int64_t t_ns = frame.t_ns + offset_ns;
    later.push_back({frame.id - earlier_ids, t_ns, pose_at(frames, t_ns)});
  }
  return later;
}

/// Returns the greatest distance of a camera's poses from the poses that a reader of `written`
/// finds, metres.
double distance_from(const std::vector<FramePose>& written, const std::vector<FramePose>& frames,
                     std::int64_t offset_ns) {
  double most_m = 0;
  for (const FramePose& frame : frames) {
    const std::int64_t t_ns = frame.t_ns + offset_ns;
    most_m = std::max(
        most_m,
        (pose_at(written, t_ns).translation() - pose_at(frames, t_ns).translation()).norm());
  }
  return most_m;
}

void write_poses(const kitti360::Layout& layout, const std::vector<FramePose>& frames,
                 const Rigid3d& world_from_global, const Slots& slots) {
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

std::string date_of(std::int64_t t_ns) {
  const std::chrono::sys_time<std::chrono::nanoseconds> time{std::chrono::nanoseconds(t_ns)};
  const std::chrono::year_month_day date(std::chrono::floor<std::chrono::days>(time));
  return formatted("%04d_%02u_%02u", int(date.year()), unsigned(date.month()),
                   unsigned(date.day()));
}

}  // namespace

DriveNotes write_kitti360(const fs::path& folder, const Recording& drive, ThreadPool& pool,
                          const std::atomic<bool>& stop) {
  DriveNotes notes;
  const Slots slots = assign_slots(drive, &notes);
  const std::int64_t first_id = drive.frames.front().id, last_id = drive.frames.back().id;
  const std::int64_t earlier_ids = last_id < kitti::kMaxTimes ? 0 : first_id;
  if (last_id - earlier_ids >= kitti::kMaxTimes)
    throw InputError(drive.root, "frame id", std::to_string(last_id),
                     "KITTI-360 has files of a line for every number; a million fit");
  if (earlier_ids != 0)
    notes.changed.push_back("frame " + std::to_string(first_id) + " is frame 0");
  if (drive.frames.front().t_ns < 0 ||
      slots.begin()->second->calibration.time_offset_ns + drive.frames.front().t_ns < 0)
    throw InputError(drive.root, "time", std::to_string(drive.frames.front().t_ns) + " ns",
                     "dates before 1970 cannot be written");

  // Frames have the times of the first camera, as readers take them.
  const std::int64_t offset_ns = slots.begin()->second->calibration.time_offset_ns;
  const std::vector<FramePose> frames = frames_later_by(drive.frames, offset_ns, earlier_ids);
  const Rigid3d world_from_global = local_from_global(drive);
  if (drive.global_frame == GlobalFrame::kEcef)
    notes.changed.push_back("the world is the body frame (x forward, y left, z up) of frame " +
                            std::to_string(first_id) + ", not ECEF");
  const kitti360::Layout layout{folder, date_of(frames.front().t_ns) + "_drive_0000_sync"};

  write_cameras(layout, slots, earlier_ids, pool, stop, &notes);
  std::string rolling;
  for (const auto& [name, camera] : slots) {
    const CameraCalibration& calibration = camera->calibration;
    std::vector<std::pair<std::int64_t, std::int64_t>> times;
    for (const FramePose& frame : frames)
      times.emplace_back(frame.id, frame.t_ns + calibration.time_offset_ns - offset_ns);
    make_folders(layout.camera(name));
    write_file(layout.camera(name) / "timestamps.txt", kitti::make_timestamps(times));
    if (calibration.readout_ns != 0) rolling += (rolling.empty() ? "" : ", ") + name;
    if (const double m = distance_from(frames, drive.frames, calibration.time_offset_ns);
        m > kExact_m)
      notes.changed.push_back("poses of " + name + ", between those of " + slots.begin()->first +
                              formatted(", are up to %.2g mm off", 1e3 * m));
  }
  if (!rolling.empty())
    notes.left_out.push_back("rolling shutter of " + rolling +
                             ": each image has the pose of its middle row");
  write_poses(layout, frames, world_from_global, slots);
  if (!drive.lidars.empty() && !drive.lidar_files.empty())
    write_kitti360_scans(layout, drive, frames, earlier_ids, body_from_first_camera(slots), pool,
                         stop, &notes);
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
