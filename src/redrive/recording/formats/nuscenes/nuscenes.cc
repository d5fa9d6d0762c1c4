// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes.h"

#include <algorithm>
#include <cstdlib>
#include <map>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/nuscenes/nuscenes_boxes.h"
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"
#include "redrive/recording/formats/nuscenes/nuscenes_tables.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/timed_images.h"

namespace redrive::nuscenes {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSameSample_ns = 200'000'000;
constexpr const char *kLidar = "LIDAR_TOP", *kFirstCamera = "CAM_FRONT";

bool is_tables_folder(const fs::path& folder) {
  return is_there(folder / "scene.json") || is_there(folder / "sample_data.json") ||
         is_there(folder / "calibrated_sensor.json");
}

/// Returns the folder itself, or the versions in it.
std::vector<fs::path> tables_below(const fs::path& folder) {
  if (is_tables_folder(folder)) return {folder};
  std::vector<fs::path> versions;
  std::error_code error;
  for (fs::directory_iterator it(folder, error), end; !error && it != end; it.increment(error))
    if (it->path().filename().string().starts_with("v1.0-") && is_tables_folder(it->path()))
      versions.push_back(it->path());
  std::ranges::sort(versions);
  return versions;
}

std::vector<std::string> missing_tables_of_boxes(const fs::path& tables) {
  std::vector<std::string> missing;
  for (const char* name : {"sample_annotation.json", "instance.json", "category.json"})
    if (!is_there(tables / name)) missing.push_back(name);
  return missing;
}

struct SceneFolder {
  std::vector<fs::path> tables;
  std::string scene;  ///< name or token; empty: the only one
};

SceneFolder find_scene_folder(const fs::path& root) {
  fs::path path = fs::absolute(root).lexically_normal();
  if (!path.has_filename()) path = path.parent_path();
  if (is_there(path)) return {tables_below(path), ""};
  return {tables_below(path.parent_path()), path.filename().string()};
}

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    return parse_scan(read_file(file.path, kMaxDataBytes), file.path,
                      {body_from_lidar, revolution_ends_ns.at(file.path), spin}, poses, left_out);
  }
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    std::error_code error;
    const std::uintmax_t bytes = fs::file_size(file.path, error);
    return error || bytes % kScanRecordBytes != 0 ? 0 : bytes / kScanRecordBytes;
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return boxes.at(file.frame_id);
  }

  Rigid3d body_from_lidar = Rigid3d::Identity();
  Spin spin;
  std::vector<FramePose> poses;
  std::map<fs::path, std::int64_t> revolution_ends_ns;
  std::map<std::int64_t, std::vector<Box>> boxes;  ///< key: frame; for Recording::box_files
};

/// Returns time offsets of cameras to the first one: medians at the key frames. One per sensor; 0
/// for others. Files of a key frame more than 0.2 s from it are damaged. InputError: a camera
/// without a key frame.
std::vector<std::int64_t> time_offsets_ns(const fs::path& sample_data, std::size_t first,
                                          SceneTables* tables) {
  SceneTables& scene = *tables;
  std::map<std::size_t, std::int64_t> first_times;  // one per sample
  for (const SensorFile& file : scene.files)
    if (file.sensor == first && file.key_frame) first_times[file.sample] = file.t_ns;
  std::vector<std::vector<std::int64_t>> offsets(scene.sensors.size());
  std::erase_if(scene.files, [&](const SensorFile& file) {
    const auto found = first_times.find(file.sample);
    if (!file.key_frame || found == first_times.end()) return false;
    const std::int64_t offset_ns = file.t_ns - found->second;
    const std::string& name = scene.sensors[file.sensor].calibration.name;
    const DamagedList damaged{"times of " + name, &scene.damaged};
    const bool fits = parse_record(&damaged, -1, [&] {
      if (std::abs(offset_ns) > kSameSample_ns)
        throw InputError(sample_data, name, file.path.filename().string(),
                         "more than 0.2 s from " + scene.sensors[first].calibration.name +
                             " in the same sample");
    });
    if (fits) offsets[file.sensor].push_back(offset_ns);
    return !fits;
  });
  std::vector<std::int64_t> medians(scene.sensors.size());
  for (std::size_t s = 0; s < medians.size(); ++s) {
    if (scene.sensors[s].modality != "camera") continue;
    const std::string& name = scene.sensors[s].calibration.name;
    if (offsets[s].empty())
      throw InputError(sample_data, name, "",
                       "has no key frame together with " + scene.sensors[first].calibration.name +
                           " in " + scene.name + ", so its time offset is unknown");
    std::ranges::sort(offsets[s]);
    medians[s] = offsets[s][offsets[s].size() / 2];
  }
  return medians;
}

/// One list per sensor, empty for others than cameras.
std::vector<TimedImages> images_of(const SceneTables& scene,
                                   const std::vector<std::int64_t>& offsets_ns) {
  std::vector<TimedImages> cameras(scene.sensors.size());
  for (std::size_t s = 0; s < cameras.size(); ++s)
    cameras[s] = {scene.sensors[s].calibration.name, offsets_ns[s], {}};
  for (const SensorFile& file : scene.files)
    if (scene.sensors[file.sensor].modality == "camera")
      cameras[file.sensor].images.push_back({file.t_ns, file.path});
  return cameras;
}

/// Drops missing files.
template <class File>
void drop_missing(std::vector<File>* files, const std::string& subject,
                  std::vector<Finding>* findings) {
  std::vector<std::string> missing;
  std::erase_if(*files, [&](const File& file) {
    if (is_there(file.path)) return false;
    missing.push_back(file.path.filename().string());
    return true;
  });
  if (!missing.empty())
    findings->push_back({subject, counted(missing.size(), "file") +
                                      " of the tables missing: " + first_few(missing)});
}

/// Returns how LIDAR_TOP turns, by its first file that can be read.
Spin spin_of_lidar(const SceneTables& scene) {
  std::vector<const SensorFile*> files;
  for (const SensorFile& file : scene.files)
    if (scene.sensors[file.sensor].calibration.name == kLidar) files.push_back(&file);
  std::vector<std::int64_t> intervals_ns;
  for (std::size_t i = 1; i < files.size(); ++i)
    intervals_ns.push_back(files[i]->t_ns - files[i - 1]->t_ns);
  // Files may be missing: where only key frames are there, the interval says nothing.
  constexpr std::int64_t kLongest_ns = 250'000'000;
  std::ranges::sort(intervals_ns);
  const std::int64_t interval_ns =
      intervals_ns.empty() ? 0 : intervals_ns[intervals_ns.size() / 10];
  const std::int64_t duration_ns = interval_ns <= kLongest_ns ? interval_ns : 0;
  for (const SensorFile* file : files) {
    if (!is_there(file->path)) continue;
    try {
      return spin_of(read_file(file->path, kMaxDataBytes), file->path, duration_ns);
    } catch (const InputError&) {
      // Named when the scan itself is read.
    }
  }
  return {};
}

/// Returns scans with the frame that is nearest to their middle; several may have the same.
std::vector<FrameFile> list_revolutions(const SceneTables& scene,
                                        const std::vector<FramePose>& frames, Reader* reader) {
  std::vector<FrameFile> revolutions;
  for (const SensorFile& file : scene.files) {
    if (scene.sensors[file.sensor].calibration.name != kLidar) continue;
    const std::int64_t middle_ns = file.t_ns - reader->spin.duration_ns / 2;
    revolutions.push_back({nearest_frame(frames, middle_ns).id, file.path});
    reader->revolution_ends_ns[file.path] = file.t_ns;
  }
  return revolutions;
}

void add_revolutions(const SceneTables& scene, Recording* recording, Reader* reader) {
  reader->body_from_lidar = recording->lidars[0].body_from_lidar;
  reader->poses = scene.poses;
  reader->spin = spin_of_lidar(scene);
  recording->lidar_files = list_revolutions(scene, recording->frames, reader);
  drop_missing(&recording->lidar_files, kLidar, &recording->findings);
  if (reader->spin.turn_rad == 0)
    recording->findings.push_back({kLidar,
                                   "the order of its points is no revolution: all have the time of "
                                   "their scan"});
}

/// Leaves out missing images; the recording has the frames that are left with one.
void add_frames(const std::vector<FramePose>& frames, std::vector<TimedImages>* cameras,
                Recording* recording) {
  std::vector<bool> shown(frames.size());
  for (TimedImages& camera : *cameras) {
    drop_missing(&camera.images, camera.camera, &recording->findings);
    for (const FrameFile& image : camera.images) shown[std::size_t(image.frame_id)] = true;
  }
  for (const FramePose& frame : frames)
    if (shown[std::size_t(frame.id)]) recording->frames.push_back(frame);
}

}  // namespace

bool looks_like(const fs::path& root) { return !find_scene_folder(root).tables.empty(); }

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  const auto [versions, wanted] = find_scene_folder(root);
  if (versions.size() > 1)
    throw InputError(root, "", "",
                     "holds several versions, " + versions[0].filename().string() + " and " +
                         versions[1].filename().string() +
                         ": add one of them to the path, and a scene, as in " +
                         (versions[0] / "scene-0061").string());
  const fs::path tables = versions.at(0), sample_data = tables / "sample_data.json";
  const std::vector<std::string> missing = missing_tables_of_boxes(tables);
  SceneTables scene = read_scene(tables, wanted, scan_file, missing.empty());
  const DamagedList strays{"poses", &scene.damaged};
  leave_out_strays(tables / "ego_pose.json", "translation", strays, &scene.poses);

  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  std::vector<Finding>& findings = recording.findings;
  if (!missing.empty())
    findings.push_back(
        {"boxes", "none: " + first_few(missing) + " missing in " + tables.filename().string()});
  std::size_t first = scene.sensors.size();
  for (std::size_t s = 0; s < scene.sensors.size(); ++s) {
    const Sensor& sensor = scene.sensors[s];
    const std::string& name = sensor.calibration.name;
    if (sensor.modality != "camera") recording.other_sensors.push_back(name);
    if (name == kLidar) recording.lidars = {{name, sensor.calibration.body_from_sensor}};
    // CAM_FRONT, or the first camera by name.
    const auto before = [&](const std::string& other) {
      return std::pair(name != kFirstCamera, name) < std::pair(other != kFirstCamera, other);
    };
    if (sensor.modality == "camera" &&
        (first == scene.sensors.size() || before(scene.sensors[first].calibration.name)))
      first = s;
  }
  std::ranges::sort(recording.other_sensors);
  if (first == scene.sensors.size())
    throw InputError(sample_data, "", "", "has no image of " + scene.name);
  const std::vector<std::int64_t> offsets_ns = time_offsets_ns(sample_data, first, &scene);
  std::vector<TimedImages> cameras = images_of(scene, offsets_ns);
  const std::vector<FramePose> frames =
      join_frames(scene.poses, sample_data, &cameras, &scene.damaged);
  check_trajectory(frames, tables / "ego_pose.json", {"timestamp", "translation"});

  add_frames(frames, &cameras, &recording);
  for (std::size_t s = 0; s < scene.sensors.size(); ++s) {
    CameraCalibration calibration = scene.sensors[s].calibration;
    calibration.time_offset_ns = offsets_ns[s];
    std::vector<ImageFile> images = images_with_poses(
        std::move(cameras[s].images), calibration.name, recording.frames, &findings);
    if (!images.empty()) recording.cameras.push_back({calibration, std::move(images)});
  }
  std::ranges::sort(recording.cameras, {},
                    [](const RecordedCamera& camera) { return camera.calibration.name; });
  require_cameras(recording);

  const auto reader = std::make_shared<Reader>();
  if (!recording.lidars.empty()) add_revolutions(scene, &recording, reader.get());
  reader->boxes = boxes_of_frames(
      scene,
      recording.lidars.empty() ? std::nullopt : std::optional(recording.lidars[0].body_from_lidar),
      reader->spin, recording.frames);
  for (const auto& [frame_id, boxes] : reader->boxes)
    recording.box_files.push_back({frame_id, tables / "sample_annotation.json"});
  recording.reader = reader;
  recording.damaged = std::move(scene.damaged);
  return recording;
}

}  // namespace redrive::nuscenes
