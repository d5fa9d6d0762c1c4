// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <functional>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/kitti/kitti_boxes.h"
#include "redrive/recording/formats/kitti/kitti_calibration.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/kitti/kitti_reader.h"

namespace redrive::kitti {
namespace {

namespace fs = std::filesystem;

constexpr const char* kImageFolders[] = {"image_00", "image_01", "image_02", "image_03"};
constexpr std::int64_t kMaxRevolution_ns = 500'000'000;  // 2 Hz; the scanner turns at 10 Hz

/// Returns the folder that holds the drive, also for "." and for names that end in a slash.
fs::path day_of_drive(const fs::path& root) {
  const fs::path absolute = fs::absolute(root).lexically_normal();
  return (absolute.has_filename() ? absolute : absolute.parent_path()).parent_path();
}

/// Returns the calibration file, also where an excerpt has it in the drive's own folder.
fs::path calibration_file(const fs::path& root, const char* name) {
  const fs::path day = day_of_drive(root);
  for (const fs::path& folder : {day, root, root / "calibration", root / "calib"})
    if (is_there(folder / name)) return folder / name;
  throw InputError(day / name, "", "",
                   "missing: the calibration stands in the folder of the day, above the drive's, "
                   "or in the drive's");
}

template <class Parse>
auto parse_file(const fs::path& file, Parse parse) {
  return parse(read_file(file), file);
}

/// Returns poses of the body at the times of the GPS and IMU. `is_shown`: whether a frame has an
/// image.
std::vector<FramePose> read_oxts_poses(const fs::path& root,
                                       const std::function<bool(std::int64_t)>& is_shown,
                                       const DamagedList& damaged, std::vector<Finding>* findings) {
  const std::vector<FrameFile> files =
      list_frame_files(root / "oxts/data", "", {".txt"}, "oxts/data", findings);
  if (files.empty()) throw InputError(root / "oxts/data", "", "", "holds no pose");
  const Timestamps times(root / "oxts/timestamps.txt", &damaged);
  std::vector<FramePose> poses;
  std::vector<std::int64_t> without_time;
  for (const FrameFile& file : files) {
    const std::optional<std::int64_t> t_ns =
        times.of(file.frame_id, is_shown(file.frame_id), &damaged);
    if (!t_ns) {
      without_time.push_back(file.frame_id);
      continue;
    }
    parse_record(&damaged, file.frame_id, [&] {
      poses.push_back(
          {file.frame_id, *t_ns, parse_oxts(read_file(file.path), file.path) * imu_from_body()});
    });
  }
  take_out_named(damaged, &without_time);
  if (!without_time.empty())
    findings->push_back({"oxts", "no time, and so no pose, for frame " + first_few(without_time)});
  if (poses.empty()) throw InputError(times.file, "", "", "has a time of no pose");
  leave_out_impossible(root / "oxts/data", {"time", "latitude, longitude, altitude"}, &damaged,
                       &poses);
  return poses;
}

struct CameraFolder {
  std::string name;
  std::vector<FrameFile> images;
  Timestamps times;
};

/// Returns where damaged times of a sensor go.
DamagedList damaged_times(const std::string& sensor, Recording* recording) {
  return {"times of " + sensor, &recording->damaged};
}

std::vector<CameraFolder> list_cameras(const fs::path& root, Recording* recording) {
  std::vector<Finding>* const findings = &recording->findings;
  std::vector<CameraFolder> folders;
  for (const char* name : kImageFolders) {
    if (!is_folder(root / name)) continue;
    std::vector<FrameFile> images =
        list_frame_files(root / name / "data", "", {".png", ".jpg", ".jpeg"}, name, findings);
    if (images.empty()) {
      findings->push_back({name, "no image in its folder data; left out"});
    } else {
      const DamagedList damaged = damaged_times(name, recording);
      folders.push_back(
          {name, std::move(images), Timestamps(root / name / "timestamps.txt", &damaged)});
    }
  }
  return folders;
}

/// Returns frames at the first camera's times, at which poses are interpolated.
std::vector<FramePose> frames_at_images(const std::vector<FramePose>& poses,
                                        const CameraFolder& camera, const fs::path& oxts,
                                        const DamagedList& damaged,
                                        std::vector<Finding>* findings) {
  std::vector<FramePose> frames;
  std::vector<std::int64_t> without_time;
  for (const FramePose& pose : poses) {
    const std::optional<std::int64_t> t_ns =
        camera.times.of(pose.id, has_file_of(camera.images, pose.id), &damaged);
    if (!t_ns) {
      without_time.push_back(pose.id);
      continue;
    }
    if (camera.times.is_same(pose.id, *t_ns, pose.t_ns, oxts.string(), &damaged))
      frames.push_back({pose.id, *t_ns, pose_at(poses, *t_ns)});
  }
  take_out_named(damaged, &without_time);
  if (!without_time.empty())
    findings->push_back(
        {camera.name, "no time for frame " + first_few(without_time) + "; they are left out"});
  return frames;
}

/// Lists the revolutions and their times.
std::vector<FrameFile> list_scans(const fs::path& root, const std::vector<FramePose>& frames,
                                  Reader* reader, const DamagedList& damaged,
                                  std::vector<Finding>* findings) {
  const fs::path folder = root / "velodyne_points";
  std::vector<FrameFile> files =
      list_frame_files(folder / "data", "", {".bin"}, "velodyne_points/data", findings);
  if (files.empty()) return files;
  const Timestamps start(folder / "timestamps_start.txt", &damaged),
      end(folder / "timestamps_end.txt", &damaged);
  std::vector<std::int64_t> without_time;
  std::erase_if(files, [&](const FrameFile& file) {
    const auto frame = std::ranges::lower_bound(frames, file.frame_id, {}, &FramePose::id);
    const bool has_frame = frame != frames.end() && frame->id == file.frame_id;
    const auto start_ns = start.of(file.frame_id, has_frame, &damaged),
               end_ns = start_ns ? end.of(file.frame_id, has_frame, &damaged) : std::nullopt;
    if (!start_ns || !end_ns) {
      without_time.push_back(file.frame_id);
      return true;
    }
    if (!parse_record(&damaged, file.frame_id, [&] {
          if (*end_ns <= *start_ns || *end_ns - *start_ns > kMaxRevolution_ns)
            end.fail(file.frame_id, 1e-9 * static_cast<double>(*end_ns - *start_ns),
                     "after the start of the revolution, which takes up to 0.5 s");
        }))
      return true;
    if (has_frame && !start.is_same(file.frame_id, (*start_ns + *end_ns) / 2, frame->t_ns,
                                    "the image", &damaged))
      return true;
    reader->scans[file.frame_id] = {*start_ns, *end_ns};
    return false;
  });
  take_out_named(damaged, &without_time);
  if (!without_time.empty())
    findings->push_back({"velodyne_points", "no time for the scan of frame " +
                                                first_few(without_time) + "; they are not used"});
  return files;
}

/// The file of the boxes, or an empty path.
fs::path find_labels(const fs::path& root, std::vector<Finding>* findings) {
  std::vector<fs::path> labels;
  for (const fs::path& file : list_folder(root / "label_02"))
    if (has_extension(file, {".txt"})) labels.push_back(file);
  if (labels.size() > 1)
    throw InputError(labels[1], "", "",
                     "a second file of labels, beside " + labels[0].filename().string() +
                         ": only the one of this drive belongs here");
  const fs::path tracklets = root / "tracklet_labels.xml";
  if (labels.empty()) return is_there(tracklets) ? tracklets : fs::path();
  if (is_there(tracklets))
    findings->push_back({"tracklet_labels.xml", "not used: label_02 has the boxes of this drive"});
  return labels[0];
}

}  // namespace

Rigid3d imu_from_body() { return Rigid3d(Eigen::Translation3d(0.05, -0.32, -0.93)); }

Rigid3d rectified_from_body() {
  Rigid3d rectified_from_body = Rigid3d::Identity();
  rectified_from_body.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  rectified_from_body.translation() << 0, 1.65, -1.03;
  return rectified_from_body;
}

bool looks_like(const fs::path& root) {
  return is_folder(root / "oxts") || is_folder(root / "velodyne_points") ||
         std::ranges::any_of(kImageFolders,
                             [&](const char* name) { return is_folder(root / name / "data"); });
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  const fs::path cameras_file = calibration_file(root, "calib_cam_to_cam.txt");
  const CamToCam cam_to_cam = parse_file(cameras_file, parse_cam_to_cam);
  const Rigid3d camera_from_velodyne =
      parse_file(calibration_file(root, "calib_velo_to_cam.txt"), parse_rigid);
  const Rigid3d velodyne_from_imu =
      parse_file(calibration_file(root, "calib_imu_to_velo.txt"), parse_rigid);
  const Rigid3d velodyne_from_body = velodyne_from_imu * imu_from_body();
  const Rigid3d rectified_from_body =
      cam_to_cam.rectified_from_camera * camera_from_velodyne * velodyne_from_body;

  Recording recording;
  recording.root = root;
  std::vector<Finding>& findings = recording.findings;
  const auto reader = std::make_shared<Reader>();
  reader->body_from_velodyne = velodyne_from_body.inverse(Eigen::Isometry);

  const DamagedList damaged{"poses", &recording.damaged};
  const std::vector<CameraFolder> cameras = list_cameras(root, &recording);
  const std::vector<FramePose> poses = read_oxts_poses(
      root,
      [&](std::int64_t id) {
        return std::ranges::any_of(
            cameras, [&](const CameraFolder& camera) { return has_file_of(camera.images, id); });
      },
      damaged, &findings);
  if (!cameras.empty())
    recording.frames = frames_at_images(poses, cameras[0], root / "oxts/timestamps.txt",
                                        damaged_times(cameras[0].name, &recording), &findings);
  for (const CameraFolder& camera : cameras) {
    const auto found = cam_to_cam.cameras.find(camera.name.back() - '0');
    if (found == cam_to_cam.cameras.end())
      throw InputError(cameras_file, "P_rect_" + camera.name.substr(6), "",
                       "missing; the drive has images of this camera");
    std::vector<ImageFile> images =
        images_with_poses(camera.images, camera.name, recording.frames, &findings);
    if (images.empty()) continue;
    CameraCalibration calibration =
        calibration_of(found->second, *found->second.size, camera.name, rectified_from_body);
    const DamagedList times = damaged_times(camera.name, &recording);
    calibration.time_offset_ns =
        time_offset_ns(camera.times, camera.name, images, recording.frames, &findings, &times);
    recording.cameras.push_back({calibration, std::move(images)});
  }
  require_cameras(recording);

  recording.lidar_files = list_scans(root, recording.frames, reader.get(),
                                     damaged_times("velodyne_points", &recording), &findings);
  if (!recording.lidar_files.empty()) recording.lidars = {{"lidar", reader->body_from_velodyne}};
  if (const fs::path file = find_labels(root, &findings); !file.empty()) {
    const bool tracklets = has_extension(file, {".xml"});
    const std::string text = read_file(file);
    const Rigid3d body_from_sensor =
        tracklets ? reader->body_from_velodyne : rectified_from_body.inverse(Eigen::Isometry);
    reader->boxes = place_boxes(
        tracklets ? parse_tracklets(text, file) : parse_labels(text, file), body_from_sensor,
        recording.frames, time_in_scans(velodyne_from_body * body_from_sensor, reader->scans));
    for (const auto& [frame_id, boxes] : reader->boxes)
      recording.box_files.push_back({frame_id, file});
  }
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::kitti
