// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pandaset/pandaset.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <map>
#include <mutex>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/math/upper_median.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/image_size.h"
#include "redrive/recording/formats/pandaset/pandaset_boxes.h"
#include "redrive/recording/formats/pandaset/pandaset_rig.h"
#include "redrive/recording/formats/pandaset/pandaset_scan.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive::pandaset {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kLate_ns = 20'000'000;  // a car at 15 m/s moves by 0.3 m
constexpr const char* kFirstCamera = "front_camera";
const PoseFields kFields = {"time in timestamps.json", "position"};

/// Boxes of all frames, made of all tables when the first one is asked for, since an object's
/// velocity needs its boxes of other frames.
class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    return parse_scan(unpack(read_file(file.path), file.path), file.path,
                      file.lidar == 0 ? Lidar::kPandar64 : Lidar::kPandarGt, frames,
                      file.lidar == 0 ? body_from_lidar : body_from_lidar * pandar64_from_gt(),
                      left_out);
  }
  /// The end of a gzip file has the size of its content, the points of both LiDARs.
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    std::uint32_t bytes = 0;
    std::error_code error;
    const std::uintmax_t size = fs::file_size(file.path, error);
    if (error || size < 18) return 0;
    std::ifstream stream(file.path, std::ios::binary);
    stream.seekg(-4, std::ios::end);
    stream.read(reinterpret_cast<char*>(&bytes), 4);
    return stream ? bytes / kPointBytes : 0;
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    std::call_once(read_once_, [&] { read_all_boxes(); });
    if (const auto fault = faults_.find(file.frame_id); fault != faults_.end())
      throw InputError(fault->second);
    const auto found = boxes_.find(file.frame_id);
    return found == boxes_.end() ? std::vector<Box>() : found->second;
  }
  std::vector<Finding> box_findings() const override {
    std::vector<Finding> findings;
    if (!impossible_.empty())
      findings.push_back({"boxes", counted(impossible_.size(), "cuboid") +
                                       " without a size, a place or a name, left out: " +
                                       first_few(impossible_, 3)});
    if (!unknown_.empty())
      findings.push_back({"boxes", "labels that PandaSet does not list, taken for vehicles: " +
                                       first_few(std::vector(unknown_.begin(), unknown_.end()))});
    return findings;
  }

  std::vector<FramePose> frames;  ///< as recorded: points and cuboids lie in this world
  std::vector<FrameFile> box_files;
  Rigid3d body_from_lidar = Rigid3d::Identity();  ///< the Pandar64's

 private:
  void read_all_boxes() const {
    std::map<std::int64_t, std::vector<Cuboid>> cuboids;
    for (const FrameFile& file : box_files) try {
        cuboids[file.frame_id] =
            parse_cuboids(unpack(read_file(file.path), file.path), file.path, &impossible_);
      } catch (const InputError& error) {
        faults_.emplace(file.frame_id, error);
      }
    for (const auto& [frame, of_frame] : cuboids)
      for (const Cuboid& cuboid : of_frame)
        if (!is_known_label(cuboid.label)) unknown_.insert(cuboid.label);
    boxes_ = boxes_of_frames(cuboids, body_from_lidar, frames);
  }

  mutable std::once_flag read_once_;
  mutable std::map<std::int64_t, std::vector<Box>> boxes_;  ///< key: frame
  mutable std::map<std::int64_t, InputError> faults_;
  mutable std::vector<std::string> impossible_;
  mutable std::set<std::string> unknown_;
};

/// A folder of camera/, or lidar/.
struct Sensor {
  std::string name;
  fs::path folder;
  Times times_ns;                ///< keyed by frame
  std::vector<FramePose> poses;  ///< keyed by frame, world from sensor

  fs::path poses_file() const { return folder / "poses.json"; }
  fs::path times_file() const { return folder / "timestamps.json"; }
};

/// Poses that cannot be go to `damaged`.
Sensor read_sensor(const fs::path& folder, const std::string& name, const DamagedList& damaged) {
  Sensor sensor{name, folder, {}, {}};
  sensor.times_ns = parse_times(read_file(sensor.times_file()), sensor.times_file(), &damaged);
  sensor.poses = posed_times(
      parse_poses(read_file(sensor.poses_file()), sensor.poses_file(), &damaged), sensor.times_ns);
  return sensor;
}

/// Takes poses out that the list names.
void take_out_damaged(const DamagedList& damaged, std::vector<FramePose>* poses) {
  std::erase_if(*poses, [&](const FramePose& pose) {
    std::vector<std::int64_t> id = {pose.id};
    take_out_named(damaged, &id);
    return id.empty();
  });
}

/// Reads the cameras; the first one, whose times are the frames', comes first.
std::vector<Sensor> read_cameras(const fs::path& root, std::vector<DamagedRecord>* damaged,
                                 std::vector<Finding>* findings) {
  std::vector<std::string> missing = camera_names();
  std::vector<Sensor> cameras;
  for (const fs::path& folder : list_folder(root / "camera")) {
    if (!is_folder(folder)) continue;
    const std::string name = folder.filename().string();
    std::erase(missing, name);
    cameras.push_back(read_sensor(folder, name, {"poses of " + name, damaged}));
  }
  if (!missing.empty())
    findings->push_back(
        {"cameras", counted(missing.size(), "camera") +
                        " of PandaSet without a folder here: " + first_few(missing, 6)});
  if (cameras.empty()) throw InputError(root / "camera", "", "", "there is no camera");
  const auto first = std::ranges::find(cameras, kFirstCamera, &Sensor::name);
  if (first != cameras.end()) std::rotate(cameras.begin(), first, first + 1);
  return cameras;
}

/// Poses of the body at the ends of the scans; fewer than two where they are missing.
std::vector<FramePose> read_body(const fs::path& root, std::vector<DamagedRecord>* damaged,
                                 std::vector<Finding>* findings) {
  const fs::path folder = root / "lidar";
  if (!is_there(folder / "poses.json")) {
    findings->push_back({"lidar/poses.json",
                         "missing: the places of the cameras on the car are "
                         "those that PandaSet publishes"});
    return {};
  }
  const DamagedList list{"poses of the car", damaged};
  const Sensor car = read_sensor(folder, "lidar", list);
  std::vector<FramePose> body = car.poses;
  for (FramePose& pose : body) pose.global_from_body = body_of_car(pose.global_from_body);
  leave_out_impossible(car.poses_file(), kFields, &list, &body);
  return body;
}

/// Returns the pose of a camera in the body, from its images' poses or as published; poses that
/// contradict the others are taken out.
Rigid3d place_camera(const std::vector<FramePose>& body, const Rigid3d& body_from_lidar,
                     std::vector<DamagedRecord>* damaged, std::vector<Finding>* findings,
                     Sensor* camera) {
  const DamagedList list{"poses of " + camera->name, damaged};
  if (body.size() >= 2 && !camera->poses.empty()) {
    const Rigid3d placed = body_from_camera(body, camera->poses, camera->poses_file(), list);
    take_out_damaged(list, &camera->poses);
    return placed;
  }
  const std::optional<Rigid3d> published = camera_from_lidar(camera->name);
  if (!published)
    throw InputError(camera->poses_file(), "", "",
                     "has no pose, and PandaSet publishes no place of this camera on the car");
  if (body.size() >= 2)
    findings->push_back({camera->name, "no poses: its place on the car is the published one"});
  return body_from_lidar * published->inverse(Eigen::Isometry);
}

/// Median of the times of a camera's images after the first camera's. Frames at which it is off are
/// records of `damaged`.
std::int64_t time_offset_of(const Sensor& camera, const Sensor& first, const DamagedList& damaged) {
  std::vector<std::pair<std::int64_t, double>> offsets;  // keyed by frame
  std::vector<double> all;
  for (std::size_t i = 0; i < std::min(camera.times_ns.size(), first.times_ns.size()); ++i) {
    if (!camera.times_ns[i] || !first.times_ns[i]) continue;
    all.push_back(static_cast<double>(*camera.times_ns[i] - *first.times_ns[i]));
    offsets.emplace_back(static_cast<std::int64_t>(i), all.back());
  }
  if (all.empty())
    throw InputError(camera.times_file(), "", "", "has no time of a frame of " + first.name);
  const double median = upper_median(all);
  for (const auto& [frame, offset_ns] : offsets) {
    const std::string field = "[" + std::to_string(frame) + "]",
                      late = std::to_string(1e-9 * offset_ns) + " s after " + first.name;
    const bool fits = std::abs(offset_ns - median) <= static_cast<double>(kLate_ns);
    parse_record(&damaged, frame, [&] {
      if (!fits)
        throw InputError(camera.times_file(), field, late,
                         "in most frames it is " + std::to_string(1e-9 * median) + " s");
    });
  }
  return std::llround(median);
}

/// Adds a camera with the images of frames that have a pose.
void add_camera(const Sensor& camera, const Sensor& first, const Rigid3d& body_from_camera,
                Recording* recording) {
  std::vector<Finding>* findings = &recording->findings;
  CameraCalibration calibration;
  calibration.name = camera.name;
  calibration.body_from_sensor = body_from_camera;
  const DamagedList times{"times of " + camera.name, &recording->damaged};
  if (&camera != &first) calibration.time_offset_ns = time_offset_of(camera, first, times);
  std::vector<ImageFile> images = images_with_poses(
      list_frame_files(camera.folder, "", {".jpg", ".jpeg", ".png"}, camera.name, findings,
                       {"intrinsics.json", "poses.json", "timestamps.json"}),
      camera.name, recording->frames, findings);
  const DamagedList poses{"poses of " + camera.name, &recording->damaged};
  std::erase_if(images, [&](const ImageFile& image) {
    std::vector<std::int64_t> id = {image.frame_id};
    take_out_named(times, &id);
    take_out_named(poses, &id);
    return id.empty();
  });
  const std::optional<ImageSize> size = usual_image_size(images);
  if (!size) {
    findings->push_back({camera.name, "has no image to use; left out"});
    return;
  }
  calibration.width = size->width;
  calibration.height = size->height;
  const fs::path intrinsics = camera.folder / "intrinsics.json";
  parse_intrinsics(read_file(intrinsics), intrinsics, &calibration);
  recording->cameras.push_back({calibration, std::move(images)});
}

/// Adds scans and boxes, and findings about what is there and not used.
void add_scans_and_boxes(const Rigid3d& body_from_lidar, Reader* reader, Recording* recording) {
  const fs::path &root = recording->root, annotations = root / "annotations";
  std::vector<Finding>* findings = &recording->findings;
  recording->lidar_files = list_frame_files(root / "lidar", "", {".pkl.gz"}, "lidar", findings,
                                            {"poses.json", "timestamps.json"});
  std::vector<std::int64_t> missing;
  for (const RecordedCamera& camera : recording->cameras)
    for (const ImageFile& image : camera.images)
      if (!has_file_of(recording->lidar_files, image.frame_id)) missing.push_back(image.frame_id);
  std::ranges::sort(missing);
  missing.erase(std::unique(missing.begin(), missing.end()), missing.end());
  if (!missing.empty())
    findings->push_back({"lidar", "no scan of " + counted(missing.size(), "frame") +
                                      " with images: " + first_few(missing)});
  if (!recording->lidar_files.empty()) {
    recording->other_sensors = {"Pandar64", "PandarGT"};
    recording->lidars = {{"Pandar64", body_from_lidar},
                         {"PandarGT", body_from_lidar * pandar64_from_gt()}};
    share_files(recording);
  }
  recording->box_files =
      list_frame_files(annotations / "cuboids", "", {".pkl.gz"}, "boxes", findings);
  reader->box_files = recording->box_files;
  reader->body_from_lidar = body_from_lidar;
  std::vector<Finding> of_labels;
  const std::size_t labels = list_frame_files(annotations / "semseg", "", {".pkl.gz"}, "labels",
                                              &of_labels, {"classes.json"})
                                 .size();
  if (labels > 0)
    findings->push_back(
        {"annotations/semseg", "not used: classes of the points of " + counted(labels, "scan")});
}

}  // namespace

bool looks_like(const fs::path& root) {
  if (!is_folder(root / "camera")) return false;
  if (is_there(root / "lidar/poses.json")) return true;
  return std::ranges::any_of(camera_names(), [&](const std::string& name) {
    return is_there(root / "camera" / name / "poses.json");
  });
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  std::vector<DamagedRecord>* damaged = &recording.damaged;
  std::vector<Finding>* findings = &recording.findings;
  std::vector<FramePose> body = read_body(root, damaged, findings);
  std::vector<Sensor> cameras = read_cameras(root, damaged, findings);
  Sensor& first = cameras.front();
  if (first.poses.empty())
    throw InputError(first.poses_file(), "", "", "has no pose with a time in timestamps.json");

  const Rigid3d body_from_first =
      place_camera(body, usual_body_from_lidar(), damaged, findings, &first);
  recording.frames = first.poses;
  for (FramePose& frame : recording.frames)
    frame.global_from_body = frame.global_from_body * body_from_first.inverse(Eigen::Isometry);
  const DamagedList poses{"poses of " + first.name, damaged};
  leave_out_impossible(first.poses_file(), kFields, &poses, &recording.frames);
  if (body.size() < 2) body = recording.frames;

  const std::optional<Rigid3d> first_from_lidar = camera_from_lidar(first.name);
  const Rigid3d body_from_lidar =
      first_from_lidar ? body_from_first * *first_from_lidar : usual_body_from_lidar();
  const auto reader = std::make_shared<Reader>();
  reader->frames = recording.frames;
  for (Sensor& camera : cameras)
    add_camera(camera, first,
               &camera == &first ? body_from_first
                                 : place_camera(body, body_from_lidar, damaged, findings, &camera),
               &recording);
  std::ranges::sort(recording.cameras, {},
                    [](const RecordedCamera& camera) { return camera.calibration.name; });
  require_cameras(recording);
  add_scans_and_boxes(body_from_lidar, reader.get(), &recording);
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::pandaset
