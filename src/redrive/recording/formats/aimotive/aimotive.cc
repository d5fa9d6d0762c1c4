// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/aimotive/aimotive.h"

#include <algorithm>
#include <set>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"
#include "redrive/recording/formats/calibration_json.h"
#include "redrive/recording/formats/egomotion_json.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/recording/lidar/ply.h"
#include "redrive/recording/lidar/unusable_returns.h"

namespace redrive::aimotive {
namespace {

namespace fs = std::filesystem;

const fs::path kCalibrationFile = "sensor/calibration/calibration.json",
               kEgomotionFile = "sensor/gnssins/egomotion2.json";

class Reader : public RecordingReader {
 public:
  explicit Reader(std::vector<FramePose> frames) : frames_(std::move(frames)) {}
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    const auto frame = std::ranges::lower_bound(frames_, file.frame_id, {}, &FramePose::id);
    const bool known = frame != frames_.end() && frame->id == file.frame_id;
    return read_las(file.path, known ? frame->t_ns : 0, left_out);
  }
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    return las_point_count(file.path);
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return aimotive::read_boxes(file.path);
  }

  std::vector<fs::path> pose_file_names() const override {
    return {kEgomotionFile, kCalibrationFile};
  }
  /// The calibration is the recording's with these cameras: other sensors and fields stay.
  PoseFiles make_pose_files(const Recording& recording, const std::vector<FramePose>& frames,
                            const std::vector<CameraCalibration>& cameras) const override {
    nlohmann::json sensors = read_json(recording.root / kCalibrationFile);
    for (const CameraCalibration& camera : cameras)
      update_calibration(camera, &sensors.at(camera.name));
    update_lidar(first_elevation_rad(recording), &sensors);
    return {{kEgomotionFile, egomotion_to_json(frames).dump(1) + "\n"},
            {kCalibrationFile, sensors.dump(1) + "\n"}};
  }

 private:
  std::vector<FramePose> frames_;  ///< sorted by id; returns without a time have their frame's
};

fs::path egomotion_file(const fs::path& root) {
  const fs::path folder = root / "sensor/gnssins";
  for (const char* name : {"egomotion2.json", "egomotion.json"}) {
    if (is_there(folder / name)) return folder / name;
  }
  throw InputError(folder / "egomotion2.json", "", "",
                   "missing, and so is egomotion.json: there are no poses");
}

/// Adds the calibrated cameras with their images; a finding names what has only one of both.
void add_cameras(const std::vector<CameraCalibration>& calibrations, const fs::path& image_root,
                 Recording* recording) {
  std::set<std::string> calibrated;
  for (const CameraCalibration& calibration : calibrations) {
    calibrated.insert(calibration.name);
    const fs::path folder = image_root / calibration.name;
    std::vector<ImageFile> images = images_with_poses(
        list_frame_files(folder, calibration.name + "_", {".jpg", ".jpeg", ".png"},
                         calibration.name, &recording->findings),
        calibration.name, recording->frames, &recording->findings);
    if (!images.empty()) {
      recording->cameras.push_back({calibration, std::move(images)});
    } else {
      recording->findings.push_back(
          {calibration.name, is_there(folder)
                                 ? "calibrated, but no image to use; left out"
                                 : "calibrated, but there is no folder of its images; left out"});
    }
  }
  for (const fs::path& folder : list_folder(image_root)) {
    if (is_folder(folder) && !calibrated.contains(folder.filename().string())) {
      recording->findings.push_back(
          {folder.filename().string(),
           "images of a camera that calibration.json does not have; left out"});
    }
  }
  if (!recording->cameras.empty()) return;
  std::string why;
  for (const Finding& finding : recording->findings)
    why += "; " + finding.subject + ": " + finding.what;
  if (!recording->damaged.empty()) why += "; " + recording->damaged.front().why;
  throw InputError(image_root, "", "",
                   "empty recording: no image of a calibrated camera with a pose" + why);
}

/// Adds the LiDAR's revolutions or, where they cannot be used, points.ply.
void add_lidar(Recording* recording) {
  const fs::path& root = recording->root;
  recording->lidar_files =
      list_frame_files(root / "dynamic/raw-revolutions", "frame_", {".laz", ".las"},
                       "dynamic/raw-revolutions", &recording->findings);
  if (!recording->lidar_files.empty() && recording->lidars.empty())
    recording->findings.push_back(
        {"lidar",
         "not used: calibration.json has no sensor, or several, of type lidar with "
         "extrinsics (RT_body_from_sensor)"});
  if (!is_there(root / "points.ply")) return;
  recording->points_file = root / "points.ply";
  if (recording->lidars.empty())
    recording->lidar_files.clear();
  else if (!recording->lidar_files.empty())
    recording->findings.push_back({"points.ply", "not used: the LiDAR's revolutions are"});
  if (!recording->lidar_files.empty()) return;
  std::size_t left_out = 0;
  read_ply(recording->points_file, &left_out);  // what training would refuse is refused here
  if (const auto finding = points_left_out(recording->points_file, left_out))
    recording->findings.push_back(*finding);
}

}  // namespace

bool looks_like(const fs::path& root) {
  return is_folder(root / "sensor/calibration") || is_folder(root / "sensor/camera") ||
         is_folder(root / "sensor/gnssins");
}

std::shared_ptr<const RecordingReader> make_reader(std::vector<FramePose> frames) {
  return std::make_shared<const Reader>(std::move(frames));
}

Recording open(const fs::path& root, PoseSource source) {
  Recording recording;
  recording.root = root;
  const bool use_ground_truth = source == PoseSource::kGroundTruth;
  const fs::path calibration_file = use_ground_truth
                                        ? root / "sensor/calibration/calibration_true.json"
                                        : root / kCalibrationFile;
  const fs::path true_poses_file = root / "sensor/gnssins/egomotion2_true.json";
  OtherSensors others;
  const std::vector<CameraCalibration> calibrations =
      parse_calibration(read_file(calibration_file), calibration_file, &others);
  recording.other_sensors = others.names;
  if (others.body_from_lidar)
    recording.lidars = {{"lidar", *others.body_from_lidar, others.lidar_elevation_rad}};
  if (use_ground_truth || is_there(true_poses_file))
    recording.ground_truth_frames = parse_egomotion(read_file(true_poses_file), true_poses_file);
  if (use_ground_truth) {
    recording.frames = recording.ground_truth_frames;
  } else {
    const fs::path poses_file = egomotion_file(root);
    const DamagedList damaged{"poses", &recording.damaged};
    recording.frames = parse_egomotion(read_file(poses_file), poses_file, &damaged);
  }
  recording.reader = make_reader(recording.frames);

  add_cameras(calibrations, root / "sensor/camera", &recording);
  add_lidar(&recording);
  recording.box_files = list_frame_files(root / "dynamic/box/3d_body", "frame_", {".json"},
                                         "dynamic/box/3d_body", &recording.findings);
  for (const fs::path& folder : list_folder(root / "novel")) {
    if (!is_folder(folder)) continue;
    const std::string name = folder.filename().string();
    if (is_there(folder / "poses.json")) {
      recording.novel.push_back({name, folder / "poses.json"});
    } else {
      recording.findings.push_back({"novel/" + name, "no poses.json in it; left out"});
    }
  }
  return recording;
}

}  // namespace redrive::aimotive
