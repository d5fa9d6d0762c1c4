// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/aimotive.h"

#include <algorithm>
#include <cctype>
#include <charconv>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/recording/aimotive_boxes.h"
#include "redrive/recording/calibration_json.h"
#include "redrive/recording/egomotion_json.h"
#include "redrive/recording/las.h"
#include "redrive/recording/wording.h"

namespace redrive::aimotive {
namespace {

namespace fs = std::filesystem;

// Overloads without error_code would report a folder without permission as an internal error.
bool is_there(const fs::path& path) {
  std::error_code error;
  return fs::exists(path, error);
}
bool is_folder(const fs::path& path) {
  std::error_code error;
  return fs::is_directory(path, error);
}

/// Returns the entries of a folder by name, without hidden ones; none if there is no such folder.
std::vector<fs::path> list_folder(const fs::path& folder) {
  std::vector<fs::path> entries;
  std::error_code error;
  if (!fs::exists(folder, error) && !error) return entries;
  fs::directory_iterator it(folder, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
    if (it->path().filename().string().front() != '.') entries.push_back(it->path());
  }
  if (error) throw InputError(folder, "", error.message(), "the folder cannot be listed");
  std::sort(entries.begin(), entries.end());
  return entries;
}

/// Returns the id of <prefix><id><extension>, or -1.
std::int64_t frame_id_from_name(const fs::path& path, const std::string& prefix,
                                std::initializer_list<std::string_view> extensions) {
  const std::string stem = path.stem().string();
  if (!has_extension(path, extensions) || !stem.starts_with(prefix)) return -1;
  const char *const begin = stem.data() + prefix.size(), *const end = stem.data() + stem.size();
  if (begin == end || !std::all_of(begin, end, [](unsigned char c) { return std::isdigit(c); }))
    return -1;
  std::int64_t id = -1;
  const auto [last, error] = std::from_chars(begin, end, id);
  return error == std::errc() && last == end ? id : -1;
}

/// Returns the files <prefix><id><extension> of a folder by id, one per frame. A finding about
/// `subject` lists files of other names.
std::vector<FrameFile> list_frame_files(const fs::path& folder, const std::string& prefix,
                                        std::initializer_list<std::string_view> extensions,
                                        const std::string& subject,
                                        std::vector<Finding>* findings) {
  std::vector<FrameFile> files;
  std::vector<std::string> unexpected;
  for (const fs::path& path : list_folder(folder)) {
    const std::int64_t id = frame_id_from_name(path, prefix, extensions);
    if (id < 0) {
      unexpected.push_back(path.filename().string());
    } else {
      files.push_back({id, path});
    }
  }
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return a.frame_id < b.frame_id; });
  for (std::size_t i = 1; i < files.size(); ++i) {
    if (files[i].frame_id == files[i - 1].frame_id) {
      throw InputError(
          files[i].path, "frame id", std::to_string(files[i].frame_id),
          "a second file of this frame, beside " + files[i - 1].path.filename().string());
    }
  }
  if (!unexpected.empty()) {
    std::string expected = prefix + "<id>";
    for (const std::string_view& extension : extensions) {
      if (&extension != extensions.begin())
        expected += &extension + 1 == extensions.end() ? " or " : ", ";
      expected += extension;
    }
    findings->push_back({subject, counted(unexpected.size(), "file") + " not named " + expected +
                                      " ignored: " + first_few(unexpected)});
  }
  return files;
}

/// Returns the camera's images of frames with a pose. `findings` lists images that are dropped or
/// missing.
std::vector<ImageFile> collect_images(const fs::path& folder, const std::string& camera,
                                      const std::vector<FramePose>& frames,
                                      std::vector<Finding>* findings) {
  std::vector<FrameFile> images =
      list_frame_files(folder, camera + "_", {".jpg", ".jpeg", ".png"}, camera, findings);
  if (images.empty()) return {};

  std::set<std::int64_t> posed, seen;
  for (const FramePose& frame : frames) posed.insert(frame.id);
  std::vector<std::int64_t> without_pose, without_image;
  std::vector<ImageFile> kept;
  for (FrameFile& image : images) {
    seen.insert(image.frame_id);
    if (posed.contains(image.frame_id)) {
      kept.push_back({std::move(image)});
    } else {
      without_pose.push_back(image.frame_id);
    }
  }
  for (const FramePose& frame : frames) {
    if (!seen.contains(frame.id)) without_image.push_back(frame.id);
  }
  if (!without_pose.empty()) {
    findings->push_back({camera, counted(without_pose.size(), "image") +
                                     " dropped, the egomotion has no pose for frame " +
                                     first_few(without_pose)});
  }
  if (!without_image.empty()) {
    findings->push_back({camera, "no image for " + counted(without_image.size(), "frame") +
                                     " that " + (without_image.size() == 1 ? "has" : "have") +
                                     " a pose: " + first_few(without_image)});
  }
  return kept;
}

const fs::path kCalibrationFile = "sensor/calibration/calibration.json",
               kEgomotionFile = "sensor/gnssins/egomotion2.json";

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file) const override {
    return read_las(file.path);
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
    return {{kEgomotionFile, egomotion_to_json(frames).dump(1) + "\n"},
            {kCalibrationFile, sensors.dump(1) + "\n"}};
  }
  CalibratedPoses parse_pose_files(const PoseFiles& files, const fs::path& folder) const override {
    const fs::path frames = folder / kEgomotionFile, cameras = folder / kCalibrationFile;
    return {parse_egomotion(files.at(kEgomotionFile), frames),
            parse_calibration(files.at(kCalibrationFile), cameras, nullptr), frames, cameras};
  }
};

fs::path egomotion_file(const fs::path& root) {
  const fs::path folder = root / "sensor/gnssins";
  for (const char* name : {"egomotion2.json", "egomotion.json"}) {
    if (is_there(folder / name)) return folder / name;
  }
  throw InputError(folder / "egomotion2.json", "", "",
                   "missing, and so is egomotion.json: there are no poses");
}

}  // namespace

bool looks_like(const fs::path& root) {
  return is_folder(root / "sensor/calibration") || is_folder(root / "sensor/camera") ||
         is_folder(root / "sensor/gnssins");
}

std::shared_ptr<const RecordingReader> make_reader() { return std::make_shared<const Reader>(); }

Recording open(const fs::path& root, PoseSource source) {
  Recording recording;
  recording.root = root;
  recording.reader = make_reader();
  const bool use_ground_truth = source == PoseSource::kGroundTruth;
  const fs::path calibration_file = use_ground_truth
                                        ? root / "sensor/calibration/calibration_true.json"
                                        : root / kCalibrationFile;
  const fs::path image_root = root / "sensor/camera",
                 true_poses_file = root / "sensor/gnssins/egomotion2_true.json";
  OtherSensors others;
  const std::vector<CameraCalibration> calibrations =
      parse_calibration(read_file(calibration_file), calibration_file, &others);
  recording.other_sensors = others.names;
  recording.body_from_lidar = others.body_from_lidar;
  if (use_ground_truth || is_there(true_poses_file))
    recording.ground_truth_frames = parse_egomotion(read_file(true_poses_file), true_poses_file);
  if (use_ground_truth) {
    recording.frames = recording.ground_truth_frames;
  } else {
    const fs::path poses_file = egomotion_file(root);
    recording.frames = parse_egomotion(read_file(poses_file), poses_file);
  }

  std::set<std::string> calibrated;
  for (const CameraCalibration& calibration : calibrations) {
    calibrated.insert(calibration.name);
    const fs::path folder = image_root / calibration.name;
    std::vector<ImageFile> images =
        collect_images(folder, calibration.name, recording.frames, &recording.findings);
    if (!images.empty()) {
      recording.cameras.push_back({calibration, std::move(images)});
    } else {
      recording.findings.push_back(
          {calibration.name, is_there(folder)
                                 ? "calibrated, but no image to use; left out"
                                 : "calibrated, but there is no folder of its images; left out"});
    }
  }
  for (const fs::path& folder : list_folder(image_root)) {
    if (is_folder(folder) && !calibrated.contains(folder.filename().string())) {
      recording.findings.push_back(
          {folder.filename().string(),
           "images of a camera that calibration.json does not have; left out"});
    }
  }
  if (recording.cameras.empty()) {
    std::string why;
    for (const Finding& finding : recording.findings)
      why += "; " + finding.subject + ": " + finding.what;
    throw InputError(image_root, "", "",
                     "empty recording: no image of a calibrated camera with a pose" + why);
  }

  recording.lidar_files =
      list_frame_files(root / "dynamic/raw-revolutions", "frame_", {".laz", ".las"},
                       "dynamic/raw-revolutions", &recording.findings);
  recording.box_files = list_frame_files(root / "dynamic/box/3d_body", "frame_", {".json"},
                                         "dynamic/box/3d_body", &recording.findings);
  if (is_there(root / "points.ply")) recording.points_file = root / "points.ply";
  if (!recording.lidar_files.empty() && !recording.body_from_lidar)
    recording.findings.push_back(
        {"lidar",
         "not used: calibration.json has no sensor, or several, of type lidar with "
         "extrinsics (RT_body_from_sensor)"});
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
