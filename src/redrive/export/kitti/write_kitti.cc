// SPDX-License-Identifier: Apache-2.0
// KITTI's raw drives, synced and rectified.
#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/export/drive.h"
#include "redrive/export/kitti/kitti_parts.h"
#include "redrive/export/kitti/kitti_tracklets.h"
#include "redrive/export/kitti/velodyne_scans.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/math/angles.h"
#include "redrive/math/local_level.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/kitti/kitti.h"
#include "redrive/recording/formats/kitti/kitti_write.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

// Colour cameras first, as the data set has them.
const std::vector<std::string> kFolders = {"image_02", "image_03", "image_00", "image_01"};
constexpr double kSameWay_deg = 10;
/// The Velodyne of KITTI's car, for drives without a LiDAR.
const Rigid3d kUsualVelodyne(Eigen::Translation3d(0.76, 0, 1.73));

Eigen::Vector3d axis_of(const CameraCalibration& camera) {
  return camera.body_from_sensor.linear().col(2);
}
double angle_deg(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return kDegreesPerRadian * std::atan2(a.cross(b).norm(), a.dot(b));
}

/// Returns the camera whose axes all have: one by the data set's names, else the one that looks
/// most nearly ahead. InputError: no perspective camera.
const RecordedCamera& reference_camera(const Recording& drive) {
  const RecordedCamera* reference = nullptr;
  const auto rank = [](const RecordedCamera& camera) {
    const auto own = std::ranges::find(kFolders, camera.calibration.name) - kFolders.begin();
    return std::pair(own, -axis_of(camera.calibration).x());
  };
  for (const RecordedCamera& camera : drive.cameras)
    if (is_perspective(camera.calibration) && (!reference || rank(camera) < rank(*reference)))
      reference = &camera;
  if (!reference)
    throw InputError(drive.root, "", "", "has no perspective camera, and KITTI has no others");
  return *reference;
}

/// Gives a folder to each camera that looks the same way as the reference.
KittiSlots assign_folders(const Recording& drive, const RecordedCamera& reference,
                          DriveNotes* notes) {
  std::vector<const RecordedCamera*> cameras, left;
  for (const RecordedCamera& camera : drive.cameras) {
    const std::string& name = camera.calibration.name;
    const double off_deg = angle_deg(axis_of(reference.calibration), axis_of(camera.calibration));
    if (!is_perspective(camera.calibration))
      notes->left_out.push_back("camera " + name + " (" + camera.calibration.model +
                                "): KITTI has rectified pinholes");
    else if (off_deg > kSameWay_deg)
      notes->left_out.push_back("camera " + name + ": looks" + formatted(" %.0f", off_deg) +
                                " degrees away from " + reference.calibration.name +
                                ", and KITTI's cameras look the same way");
    else
      cameras.push_back(&camera);
  }
  const KittiSlots slots = fill_slots(
      cameras, kFolders, [](const CameraCalibration&, const std::string&) { return true; }, &left,
      notes);
  for (const RecordedCamera* camera : left)
    notes->left_out.push_back("camera " + camera->calibration.name + ": KITTI has four");
  return slots;
}

/// Returns a camera's lines of calib_cam_to_cam.txt: size, matrix, distortion and pose before it
/// was rectified, which are those after it. Arguments as perspective_lines.
std::string calibration_lines(const CameraCalibration& camera, const std::string& number,
                              const Eigen::Vector3d& first_in_camera) {
  std::string text = formatted("S_%s: %d %d\n", number.c_str(), camera.width, camera.height) +
                     formatted("K_%s: %.17g 0 %.17g 0", number.c_str(), camera.fx(), camera.cx()) +
                     formatted(" %.17g %.17g 0 0 1\n", camera.fy(), camera.cy()) + "D_" + number +
                     ": 0 0 0 0 0\nR_" + number + ": 1 0 0 0 1 0 0 0 1\nT_" + number + ":";
  for (int i = 0; i < 3; ++i) text += formatted(" %.17g", first_in_camera[i]);
  return text + "\n" + perspective_lines(camera, number, first_in_camera);
}

/// Writes images and calib_cam_to_cam.txt. Returns the pose of the rectified camera 0 in the body.
Rigid3d write_cameras(const fs::path& folder, const fs::path& day, const fs::path& drive_folder,
                      const KittiSlots& slots, const RecordedCamera& reference,
                      std::int64_t earlier_ids, ThreadPool& pool, const std::atomic<bool>& stop,
                      DriveNotes* notes) {
  const Eigen::Matrix3d axes = reference.calibration.body_from_sensor.linear();
  // Where image_00 is missing, the first camera is camera 0, too.
  Rigid3d body_from_rectified = slots.begin()->second->calibration.body_from_sensor;
  body_from_rectified.linear() = axes;
  std::map<std::string, std::string> lines;  // keyed by camera
  PhotoSet photos;
  for (const auto& [name, recorded] : slots) {
    photos.cameras.push_back(pinhole_photo_camera(recorded->calibration, axes));
    const PhotoCamera& camera = photos.cameras.back();
    note_resampled(name, recorded->calibration, camera, notes);
    lines[name] =
        calibration_lines(camera.calibration, name.substr(6),
                          axes.transpose() * (body_from_rectified.translation() -
                                              camera.calibration.body_from_sensor.translation()));
    add_photos(
        *recorded,
        [&, slot = name](const ImageFile& image) {
          return fs::path(slot) / "data" / kitti::file_name(image.frame_id - earlier_ids, ".png");
        },
        &photos);
  }
  // Tools ask for all four cameras: those that are missing are where the first one is.
  std::string text = "calib_time: 01-Jan-1970 00:00:00\ncorner_dist: 0\n";
  for (const char* const name : {"image_00", "image_01", "image_02", "image_03"})
    text += lines.contains(name)
                ? lines[name]
                : calibration_lines(photos.cameras.front().calibration, std::string(name).substr(6),
                                    Eigen::Vector3d::Zero());
  make_folders(drive_folder);
  write_file(day / "calib_cam_to_cam.txt", text);
  write_drive_images(folder, drive_folder.lexically_relative(folder), photos, pool, stop, notes);
  return body_from_rectified;
}

void write_rigid(const fs::path& file, const Rigid3d& transform, const char* more) {
  std::string text = "calib_time: 01-Jan-1970 00:00:00\nR:";
  for (int i = 0; i < 9; ++i) text += formatted(" %.17g", transform.linear()(i / 3, i % 3));
  text += "\nT:";
  for (int i = 0; i < 3; ++i) text += formatted(" %.17g", transform.translation()[i]);
  write_file(file, text + "\n" + more);
}

/// Returns a packet of the GPS and IMU: pose and velocity; accelerations and turn rates are not
/// known. Forward, left and up of the velocity are level.
std::string packet_of(const Rigid3d& ecef_from_imu, const Eigen::Vector3d& velocity_in_imu) {
  const Eigen::Vector3d at = ecef_from_imu.translation();
  const Geodetic place = geodetic_from_ecef(at.x(), at.y(), at.z());
  const Eigen::Matrix3d r = ecef_from_enu(place).linear().transpose() * ecef_from_imu.linear();
  const Eigen::Vector3d east_north_up = r * velocity_in_imu, angles = roll_pitch_yaw(r);
  const double ahead_x = std::cos(angles.z()), ahead_y = std::sin(angles.z());
  const double numbers[] = {kDegreesPerRadian * place.latitude_rad,
                            kDegreesPerRadian * place.longitude_rad,
                            place.height_m,
                            angles.x(),
                            angles.y(),
                            angles.z(),
                            east_north_up.y(),
                            east_north_up.x(),
                            ahead_x * east_north_up.x() + ahead_y * east_north_up.y(),
                            ahead_x * east_north_up.y() - ahead_y * east_north_up.x(),
                            east_north_up.z()};
  std::string text;
  for (const double number : numbers) text += formatted(text.empty() ? "%.17g" : " %.17g", number);
  constexpr int kNotKnown = 14;  // accelerations and rates in both axes, accuracies
  for (int i = 0; i < kNotKnown; ++i) text += " 0";
  return text + " 0 0 0 0 0\n";  // status of the receiver
}

void write_oxts(const fs::path& folder, const std::vector<FramePose>& frames,
                const Rigid3d& ecef_from_global) {
  const Rigid3d body_from_imu = kitti::imu_from_body().inverse(Eigen::Isometry);
  make_folders(folder / "data");
  std::vector<std::pair<std::int64_t, std::int64_t>> times;
  for (const FramePose& frame : frames) {
    times.emplace_back(frame.id, frame.t_ns);
    write_file(
        folder / "data" / kitti::file_name(frame.id, ".txt"),
        packet_of(ecef_from_global * frame.global_from_body * body_from_imu,
                  frame.global_from_body.linear().transpose() * velocity_at(frames, frame.t_ns)));
  }
  write_file(folder / "timestamps.txt", kitti::make_timestamps(times));
}

void write_scan_times(const fs::path& folder,
                      const std::map<std::int64_t, kitti::ScanTime>& scans) {
  std::vector<std::pair<std::int64_t, std::int64_t>> starts, ends;
  for (const auto& [id, scan] : scans) {
    starts.emplace_back(id, scan.start_ns);
    ends.emplace_back(id, scan.end_ns);
  }
  write_file(folder / "timestamps_start.txt", kitti::make_timestamps(starts));
  write_file(folder / "timestamps_end.txt", kitti::make_timestamps(ends));
}

}  // namespace

WrittenCameras kitti_cameras(const Recording& drive, DriveNotes* notes) {
  const RecordedCamera& reference = reference_camera(drive);
  DriveNotes of_folders;
  WrittenCameras cameras;
  for (const auto& [name, recorded] : assign_folders(drive, reference, &of_folders))
    cameras.emplace(recorded->calibration.name,
                    pinhole_photo_camera(recorded->calibration,
                                         reference.calibration.body_from_sensor.linear()));
  notes->left_out.insert(notes->left_out.end(), of_folders.left_out.begin(),
                         of_folders.left_out.end());
  return cameras;
}

DriveNotes write_kitti(const fs::path& folder, const Recording& drive, ThreadPool& pool,
                       const std::atomic<bool>& stop) {
  DriveNotes notes;
  const RecordedCamera& reference = reference_camera(drive);
  const KittiSlots slots = assign_folders(drive, reference, &notes);
  const KittiFrames frames = frames_of_first_camera(
      drive, slots.begin()->second->calibration.time_offset_ns, true, &notes);
  const std::string date = date_of(frames.frames.front().t_ns);
  const fs::path day = folder / date, root = day / (date + "_drive_0000_sync");

  const Rigid3d body_from_rectified =
      write_cameras(folder, day, root, slots, reference, frames.earlier_ids, pool, stop, &notes);
  for (const auto& [name, camera] : slots)
    write_camera_times(root / name, name, *camera, drive, frames, &notes);
  note_rolling(slots, &notes);

  Rigid3d ecef_from_global = Rigid3d::Identity();
  if (drive.global_frame != GlobalFrame::kEcef) {
    ecef_from_global = ecef_from_enu({}) *
                       Eigen::Translation3d(-drive.frames.front().global_from_body.translation());
    notes.changed.emplace_back(
        "the drive, which has no place on the Earth, begins at latitude 0 and longitude 0");
  }
  write_oxts(root / "oxts", frames.frames, ecef_from_global);
  notes.left_out.emplace_back("accelerations and turn rates: 0 in the packets of oxts");

  const fs::path velodyne = root / "velodyne_points";
  const std::map<std::int64_t, kitti::ScanTime> scans =
      write_velodyne_scans(velodyne, drive, frames.frames, frames.earlier_ids, pool, stop, &notes);
  if (!scans.empty()) write_scan_times(velodyne, scans);
  const Rigid3d body_from_velodyne =
      drive.lidars.empty() ? kUsualVelodyne : spinning_axes(drive.lidars[0].body_from_lidar);
  write_rigid(day / "calib_velo_to_cam.txt",
              body_from_rectified.inverse(Eigen::Isometry) * body_from_velodyne,
              "delta_f: 0 0\ndelta_c: 0 0\n");
  write_rigid(
      day / "calib_imu_to_velo.txt",
      body_from_velodyne.inverse(Eigen::Isometry) * kitti::imu_from_body().inverse(Eigen::Isometry),
      "");
  if (!drive.box_files.empty()) {
    write_file(root / "tracklet_labels.xml",
               kitti::make_tracklets(kitti::tracklets_of(drive, frames.frames, frames.earlier_ids,
                                                         body_from_velodyne, scans, &notes)));
    notes.changed.emplace_back("identities and velocities of boxes are new");
  }
  if (!drive.points_file.empty()) notes.left_out.emplace_back("the static point cloud");
  note_left_out(drive, &notes);
  return notes;
}

}  // namespace redrive
