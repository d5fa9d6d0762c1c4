// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti360/kitti360.h"

#include <algorithm>
#include <cstdio>
#include <map>
#include <optional>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/labels.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/kitti360/kitti360_boxes.h"
#include "redrive/recording/formats/kitti360/kitti360_calibration.h"

namespace redrive::kitti360 {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFolders[] = {"data_2d_raw", "data_3d_raw", "data_poses"};
constexpr const char* kCameras[] = {"image_00", "image_01", "image_02", "image_03"};
constexpr double kSamePlace_m = 0.01;
constexpr double kFarBox_m = 100;  // up to which standing objects count

bool is_perspective(const std::string& camera) { return camera < "image_02"; }
const char* images_folder(const std::string& camera) {
  return is_perspective(camera) ? "data_rect" : "data_rgb";
}

/// The path without a slash at its end, from the file system's root.
fs::path whole_path(const fs::path& path) {
  const fs::path absolute = fs::absolute(path).lexically_normal();
  return absolute.has_filename() ? absolute : absolute.parent_path();
}

bool holds_drives(const fs::path& folder) {
  return std::ranges::find(kFolders, folder.filename().string()) != std::end(kFolders);
}

/// Whether a folder, which is no drive of KITTI, has images or scans of KITTI-360 in itself.
bool is_lone_drive(const fs::path& folder) {
  if (is_folder(folder / "oxts")) return false;
  return std::ranges::any_of(kCameras,
                             [&](const std::string name) {
                               return is_folder(folder / name / images_folder(name));
                             }) ||
         is_there(folder / "velodyne_points/timestamps.txt") ||
         is_there(folder / "calibration/calib_cam_to_pose.txt");
}

Layout layout_of(const fs::path& root) {
  const fs::path path = whole_path(root);
  if (holds_drives(path.parent_path()))
    return {path.parent_path().parent_path(), path.filename().string()};
  if (!is_folder(root / "data_2d_raw")) return {root, path.filename().string()};
  std::vector<std::string> drives;
  for (const fs::path& folder : list_folder(root / "data_2d_raw"))
    if (is_folder(folder)) drives.push_back(folder.filename().string());
  if (drives.size() != 1)
    throw InputError(
        root / "data_2d_raw", "drives", std::to_string(drives.size()),
        drives.empty() ? "there is none" : "name the folder of one of them: " + first_few(drives));
  return {root, drives[0]};
}

/// Where files of a drive were found: as unpacked, or in the drive's own folder, as in excerpts. A
/// missing path is given as in the data set.
struct Drive {
  Layout layout;
  fs::path cameras, velodyne, poses, calibration;

  explicit Drive(const fs::path& root) : layout(layout_of(root)) {
    const fs::path unpacked = layout.camera("").parent_path(),
                   own = is_folder(unpacked) ? unpacked : whole_path(root);
    cameras = is_lone_drive(own) ? own : unpacked;
    velodyne = first_with({layout.velodyne(), own / "velodyne_points"}, {"data"});
    poses = first_with({layout.poses(), own, own / "poses", layout.root / "data_poses"},
                       {"poses.txt", "cam0_to_world.txt"});
    calibration = first_with(
        {layout.calibration(), own / "calibration", own, own.parent_path() / "calibration"},
        {"calib_cam_to_pose.txt", "perspective.txt"});
  }

  fs::path images(const std::string& name) const { return cameras / name / images_folder(name); }

 private:
  /// Returns the first of the folders that has one of the entries, else the first one.
  static fs::path first_with(const std::vector<fs::path>& folders,
                             const std::vector<const char*>& entries) {
    for (const fs::path& folder : folders)
      for (const char* entry : entries)
        if (is_there(folder / entry)) return folder;
    return folders[0];
  }
};

template <class Parse>
auto parse_file(const fs::path& file, Parse parse) {
  return parse(read_file(file), file);
}

/// Standing boxes are made when they are read: there are many, in many frames.
class Reader : public kitti::Reader {
 public:
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    std::vector<Box> found;
    if (const auto moving = boxes.find(file.frame_id); moving != boxes.end())
      found = moving->second;
    const auto frame = std::ranges::lower_bound(frames, file.frame_id, {}, &FramePose::id);
    const Rigid3d body_from_global = frame->global_from_body.inverse(Eigen::Isometry);
    for (const Object& object : standing) {
      if (file.frame_id < object.first_frame || file.frame_id > object.last_frame) continue;
      Box box;
      box.object_id = object.id;
      box.type = object.type;
      box.actor_name = object.type + " " + std::to_string(object.id);
      box.t_ns = frame->t_ns;
      box.body_from_box = body_from_global * object.world_from_box;
      if (box.body_from_box.translation().norm() > kFarBox_m) continue;
      box.size_m = object.size_m;
      box.velocity_in_body_m_per_s =
          -(body_from_global.linear() * velocity_at(frames, frame->t_ns));
      found.push_back(std::move(box));
    }
    return found;
  }

  std::vector<FramePose> frames;  ///< as recorded: the boxes were annotated in this world
  std::vector<Object> standing;
};

/// Poses of the IMU keyed by frame, without times, and their file.
struct ImuPoses {
  std::vector<FramePose> by_frame;
  fs::path file;
};

ImuPoses read_imu_poses(const fs::path& folder, const Rigid3d& imu_from_rectified,
                        const DamagedList& damaged, std::vector<Finding>* findings) {
  const fs::path poses_file = folder / "poses.txt", camera_file = folder / "cam0_to_world.txt";
  const auto parse = [&](const std::string& text, const fs::path& file) {
    return kitti::parse_frame_poses(text, file, &damaged);
  };
  if (!is_there(camera_file)) return {parse_file(poses_file, parse), poses_file};
  std::vector<FramePose> of_camera = parse_file(camera_file, parse);
  for (FramePose& pose : of_camera)
    pose.global_from_body = pose.global_from_body * imu_from_rectified.inverse(Eigen::Isometry);
  if (!is_there(poses_file)) return {std::move(of_camera), camera_file};
  std::vector<FramePose> poses = parse_file(poses_file, parse);
  double apart_m = 0;
  for (const FramePose& pose : poses) {
    const auto same = std::ranges::lower_bound(of_camera, pose.id, {}, &FramePose::id);
    if (same == of_camera.end() || same->id != pose.id) continue;
    apart_m = std::max(
        apart_m,
        (same->global_from_body.translation() - pose.global_from_body.translation()).norm());
  }
  if (apart_m > kSamePlace_m) {
    char what[120];
    std::snprintf(what, sizeof what,
                  "up to %.3f m away from poses.txt, which is used: of another calibration",
                  apart_m);
    findings->push_back({"cam0_to_world.txt", what});
  }
  return {std::move(poses), poses_file};
}

struct CameraImages {
  std::string name;
  std::vector<FrameFile> images;
  kitti::Timestamps times;
};

/// Returns frames with a pose and a time.
std::vector<FramePose> timed_frames(const ImuPoses& imu_poses, const CameraImages& camera,
                                    const DamagedList& damaged, const DamagedList& damaged_times,
                                    std::vector<Finding>* findings) {
  const kitti::Timestamps& times = camera.times;
  std::vector<FramePose> frames;
  std::vector<std::int64_t> without_time;
  for (const FramePose& pose : imu_poses.by_frame) {
    if (const auto t_ns = times.of(pose.id, has_file_of(camera.images, pose.id), &damaged_times))
      frames.push_back({pose.id, *t_ns, pose.global_from_body * imu_from_body()});
    else
      without_time.push_back(pose.id);
  }
  take_out_named(damaged_times, &without_time);
  if (!without_time.empty())
    findings->push_back({times.file.filename().string(),
                         "no time for frame " + first_few(without_time) + "; they are left out"});
  if (frames.empty()) throw InputError(times.file, "", "", "has a time of no pose");
  leave_out_impossible(imu_poses.file, {"time", "pose"}, &damaged, &frames);
  return frames;
}

/// Returns where damaged times of a sensor go.
DamagedList damaged_times_of(const std::string& sensor, Recording* recording) {
  return {"times of " + sensor, &recording->damaged};
}

std::vector<CameraImages> list_cameras(const Drive& drive, Recording* recording) {
  std::vector<Finding>* const findings = &recording->findings;
  std::vector<CameraImages> cameras;
  for (const std::string name : kCameras) {
    const fs::path folder = drive.images(name);
    std::vector<FrameFile> images =
        list_frame_files(folder, "", {".png", ".jpg", ".jpeg"}, name, findings);
    if (!images.empty()) {
      const DamagedList damaged = damaged_times_of(name, recording);
      cameras.push_back({name, std::move(images),
                         kitti::Timestamps(drive.cameras / name / "timestamps.txt", &damaged)});
    } else if (is_folder(drive.cameras / name)) {
      findings->push_back(
          {name, "no image in its folder " + folder.filename().string() +
                     (is_perspective(name) ? "; images before rectification are not read"
                                           : "; left out")});
    }
  }
  return cameras;
}

/// Intrinsics and extrinsics of each camera.
class Calibration {
 public:
  explicit Calibration(const fs::path& folder) : folder_(folder) {
    imu_from_camera_ = parse_file(folder / "calib_cam_to_pose.txt", parse_cam_to_pose);
    perspective_ = parse_file(folder / "perspective.txt", parse_perspective);
  }

  const Rigid3d& imu_from_camera(const std::string& name) const {
    const auto found = imu_from_camera_.find(name);
    if (found == imu_from_camera_.end())
      throw InputError(folder_ / "calib_cam_to_pose.txt", name, "",
                       "missing; other sensors or images need this camera's place");
    return found->second;
  }

  /// The first camera's.
  Rigid3d imu_from_rectified() const {
    const auto found = perspective_.find(0);
    const Rigid3d turned =
        found == perspective_.end() ? Rigid3d::Identity() : found->second.rectified_from_camera;
    return imu_from_camera("image_00") * turned.inverse(Eigen::Isometry);
  }

  CameraCalibration camera(const std::string& name) const {
    const Rigid3d body_from_camera =
        imu_from_body().inverse(Eigen::Isometry) * imu_from_camera(name);
    if (!is_perspective(name)) {
      CameraCalibration fisheye = parse_file(folder_ / (name + ".yaml"), parse_fisheye);
      fisheye.name = name;
      fisheye.body_from_sensor = body_from_camera;
      return fisheye;
    }
    const auto found = perspective_.find(name.back() - '0');
    if (found == perspective_.end())
      throw InputError(folder_ / "perspective.txt", "P_rect_" + name.substr(6), "",
                       "missing; the drive has images of this camera");
    kitti::RectifiedCamera projection = found->second.projection;
    projection.camera_from_rectified = Rigid3d::Identity();
    return kitti::calibration_of(
        projection, *projection.size, name,
        found->second.rectified_from_camera * body_from_camera.inverse(Eigen::Isometry));
  }

 private:
  fs::path folder_;
  std::map<std::string, Rigid3d> imu_from_camera_;
  std::map<int, PerspectiveCamera> perspective_;
};

/// Lists the scans of frames with a pose, and their times.
std::vector<FrameFile> list_scans(const fs::path& folder, const std::vector<FramePose>& frames,
                                  Reader* reader, const DamagedList& damaged,
                                  std::vector<Finding>* findings) {
  std::vector<FrameFile> files =
      list_frame_files(folder / "data", "", {".bin"}, "velodyne_points/data", findings);
  if (files.empty()) return files;
  const kitti::Timestamps times(folder / "timestamps.txt", &damaged);
  const std::int64_t revolution = revolution_ns(times);
  std::vector<std::int64_t> without_time, without_pose;
  std::erase_if(files, [&](const FrameFile& file) {
    const auto frame = std::ranges::lower_bound(frames, file.frame_id, {}, &FramePose::id);
    if (frame == frames.end() || frame->id != file.frame_id) {
      without_pose.push_back(file.frame_id);
      return true;
    }
    const std::optional<std::int64_t> t_ns = times.of(file.frame_id, true, &damaged);
    if (!t_ns) {
      without_time.push_back(file.frame_id);
      return true;
    }
    if (!times.is_same(file.frame_id, *t_ns, frame->t_ns, "the image", &damaged)) return true;
    reader->scans[file.frame_id] = scan_at(*t_ns, revolution);
    return false;
  });
  take_out_named(damaged, &without_time);
  if (!without_time.empty())
    findings->push_back({"velodyne_points", "no time for the scan of frame " +
                                                first_few(without_time) + "; they are not used"});
  if (!without_pose.empty())
    findings->push_back({"velodyne_points", "no pose for the scan of frame " +
                                                first_few(without_pose) + "; they are not used"});
  return files;
}

/// Reads the boxes; `reader` keeps the standing ones.
std::vector<FrameFile> read_objects(const fs::path& file, const kitti::Timestamps& times,
                                    Reader* reader, std::vector<Finding>* findings) {
  std::vector<Label> labels;
  std::vector<std::int64_t> beyond;
  const std::vector<FramePose>& frames = reader->frames;
  const auto lines = static_cast<std::int64_t>(times.by_line.size());
  for (Object& object : parse_file(file, parse_objects)) {
    if (object.frame_id == kStatic) {
      reader->standing.push_back(std::move(object));
      continue;
    }
    if (object.frame_id >= lines) beyond.push_back(object.frame_id);
    const auto frame = std::ranges::lower_bound(frames, object.frame_id, {}, &FramePose::id);
    if (frame == frames.end() || frame->id != object.frame_id) continue;
    labels.push_back({object.frame_id, object.id, object.type,
                      frame->global_from_body.inverse(Eigen::Isometry) * object.world_from_box,
                      object.size_m});
  }
  if (!beyond.empty())
    findings->push_back({file.filename().string(),
                         counted(beyond.size(), "object") + " of frames behind the last time of " +
                             times.file.string() + ", not used: " + first_few(beyond)});
  std::set<std::int64_t> moving;
  for (const Label& label : labels) moving.insert(label.object_id);
  std::erase_if(reader->standing, [&](const Object& object) { return moving.contains(object.id); });
  reader->boxes = place_boxes(labels, Rigid3d::Identity(), frames);
  std::vector<FrameFile> files;
  for (const FramePose& frame : frames)
    if (!reader->standing.empty() || reader->boxes.contains(frame.id))
      files.push_back({frame.id, file});
  return files;
}

}  // namespace

fs::path Layout::camera(const std::string& name) const {
  return root / "data_2d_raw" / drive / name;
}
fs::path Layout::images(const std::string& name) const {
  return camera(name) / images_folder(name);
}
fs::path Layout::velodyne() const { return root / "data_3d_raw" / drive / "velodyne_points"; }
fs::path Layout::poses() const { return root / "data_poses" / drive; }
fs::path Layout::calibration() const { return root / "calibration"; }
fs::path Layout::boxes(const char* part) const {
  return root / "data_3d_bboxes" / part / (drive + ".xml");
}

Rigid3d imu_from_body() {
  Rigid3d imu_from_body = Rigid3d::Identity();
  imu_from_body.linear().diagonal() << 1, -1, -1;
  imu_from_body.translation() << 0.05, 0.32, 0.9;
  return imu_from_body;
}

kitti::ScanTime scan_at(std::int64_t t_ns, std::int64_t revolution_ns) {
  return {t_ns - revolution_ns / 2, t_ns + revolution_ns / 2};
}

std::int64_t revolution_ns(const kitti::Timestamps& times) {
  constexpr std::int64_t kUsual_ns = 100'000'000, kLeast_ns = 50'000'000, kMost_ns = 500'000'000;
  std::vector<std::int64_t> steps;
  for (std::size_t i = 1; i < times.by_line.size(); ++i)
    if (times.by_line[i] && times.by_line[i - 1])
      steps.push_back(*times.by_line[i] - *times.by_line[i - 1]);
  if (steps.empty()) return kUsual_ns;
  std::ranges::sort(steps);
  const std::int64_t median = steps[steps.size() / 2];
  if (median < kLeast_ns || median > kMost_ns) {
    char value[40];
    std::snprintf(value, sizeof value, "%.3f s", 1e-9 * static_cast<double>(median));
    throw InputError(times.file, "median of the time between lines", value,
                     "a revolution takes 0.05 to 0.5 s");
  }
  return median;
}

bool looks_like(const fs::path& root) {
  return is_folder(root / "data_2d_raw") || is_lone_drive(root) ||
         (is_folder(root) && holds_drives(whole_path(root).parent_path()));
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  const Drive drive(root);
  const Calibration calibration(drive.calibration);
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  std::vector<Finding>& findings = recording.findings;
  const auto reader = std::make_shared<Reader>();

  const DamagedList damaged{"poses", &recording.damaged};
  const std::vector<CameraImages> cameras = list_cameras(drive, &recording);
  if (cameras.empty())
    throw InputError(drive.cameras, "", "",
                     "empty recording: no image in image_00/data_rect, image_01/data_rect, "
                     "image_02/data_rgb or image_03/data_rgb");
  recording.frames = timed_frames(
      read_imu_poses(drive.poses, calibration.imu_from_rectified(), damaged, &findings), cameras[0],
      damaged, damaged_times_of(cameras[0].name, &recording), &findings);
  for (const CameraImages& camera : cameras) {
    std::vector<ImageFile> images =
        images_with_poses(camera.images, camera.name, recording.frames, &findings);
    if (images.empty()) continue;
    CameraCalibration own = calibration.camera(camera.name);
    const DamagedList times = damaged_times_of(camera.name, &recording);
    own.time_offset_ns = kitti::time_offset_ns(camera.times, camera.name, images, recording.frames,
                                               &findings, &times);
    recording.cameras.push_back({own, std::move(images)});
  }
  require_cameras(recording);

  recording.lidar_files = list_scans(drive.velodyne, recording.frames, reader.get(),
                                     damaged_times_of("velodyne_points", &recording), &findings);
  if (!recording.lidar_files.empty()) {
    const Rigid3d velodyne_from_camera =
        parse_file(drive.calibration / "calib_cam_to_velo.txt", parse_cam_to_velo);
    reader->body_from_velodyne = imu_from_body().inverse(Eigen::Isometry) *
                                 calibration.imu_from_camera("image_00") *
                                 velodyne_from_camera.inverse(Eigen::Isometry);
    recording.lidars = {{"lidar", reader->body_from_velodyne}};
  }
  if (is_folder(drive.velodyne.parent_path() / "sick_points"))
    recording.other_sensors.push_back("sick_points");
  reader->frames = recording.frames;
  for (const char* part : {"train", "train_full"})
    if (const fs::path file = drive.layout.boxes(part);
        is_there(file) && recording.box_files.empty())
      recording.box_files = read_objects(file, cameras[0].times, reader.get(), &findings);
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::kitti360
