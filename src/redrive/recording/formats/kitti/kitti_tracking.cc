// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cctype>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/kitti/kitti.h"
#include "redrive/recording/formats/kitti/kitti_boxes.h"
#include "redrive/recording/formats/kitti/kitti_calibration.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/kitti/kitti_reader.h"

namespace redrive::kitti {
namespace {

namespace fs = std::filesystem;

// The benchmark has no times; its frames come from raw drives, at 10 Hz.
constexpr std::int64_t kFrameInterval_ns = 100'000'000;
constexpr const char* kTrackingFolders[] = {"image_00", "image_01", "image_02", "image_03"};

bool is_number(const std::string& name) {
  return !name.empty() &&
         std::ranges::all_of(name, [](unsigned char c) { return std::isdigit(c) != 0; });
}

/// Returns the numbers of the sequences that have a file in `folder`, or a folder.
std::set<std::string> sequences_in(const fs::path& folder, bool folders) {
  std::set<std::string> names;
  for (const fs::path& entry : list_folder(folder))
    if (is_number(entry.stem().string()) &&
        (folders ? is_folder(entry) : has_extension(entry, {".txt"})))
      names.insert(entry.stem().string());
  return names;
}

std::set<std::string> sequences_with_images(const fs::path& training) {
  std::set<std::string> names;
  for (const char* camera : kTrackingFolders) names.merge(sequences_in(training / camera, true));
  return names;
}

bool is_training(const fs::path& folder) {
  return !sequences_in(folder / "oxts", false).empty() ||
         (!sequences_in(folder / "calib", false).empty() && !sequences_with_images(folder).empty());
}

struct Sequence {
  fs::path training;
  std::string name;  ///< empty: the only one
};

Sequence find_sequence(const fs::path& root) {
  fs::path path = fs::absolute(root).lexically_normal();
  if (!path.has_filename()) path = path.parent_path();
  if (is_training(path)) return {path, ""};
  const std::string name = path.filename().string();
  for (const fs::path& training : {path.parent_path(), path.parent_path().parent_path()})
    if (is_number(name) && is_training(training)) return {training, name};
  return {};
}

/// Returns poses of the body, one per line; lines count frames.
std::vector<FramePose> read_packets(const fs::path& file, const DamagedList& damaged) {
  if (!is_there(file)) throw InputError(file, "", "", "missing: it has the poses of this sequence");
  std::vector<FramePose> frames;
  std::int64_t id = 0;
  for (const auto& pose : parse_oxts_lines(read_file(file), file, &damaged)) {
    if (pose) frames.push_back({id, id * kFrameInterval_ns, *pose * imu_from_body()});
    ++id;
  }
  leave_out_impossible(file, {"time", "latitude, longitude, altitude"}, &damaged, &frames);
  return frames;
}

void add_cameras(const Sequence& sequence, const fs::path& calibration_file,
                 const TrackingCalibration& calibration, const Rigid3d& rectified_from_body,
                 Recording* recording) {
  for (const std::string name : kTrackingFolders) {
    std::vector<ImageFile> images =
        images_with_poses(list_frame_files(sequence.training / name / sequence.name, "", {".png"},
                                           name, &recording->findings),
                          name, recording->frames, &recording->findings);
    if (images.empty()) continue;
    const auto found = calibration.cameras.find(name.back() - '0');
    if (found == calibration.cameras.end())
      throw InputError(calibration_file, "P" + name.substr(7), "",
                       "missing; the sequence has images of this camera");
    const std::optional<ImageSize> size = usual_image_size(images);
    if (!size) throw InputError(images[0].path, "", "", "is no image with a known size");
    recording->cameras.push_back(
        {calibration_of(found->second, *size, name, rectified_from_body), std::move(images)});
  }
  require_cameras(*recording);
}

}  // namespace

bool looks_like_tracking(const fs::path& root) { return !find_sequence(root).training.empty(); }

Recording open_tracking(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Sequence sequence = find_sequence(root);
  const std::set<std::string> shown = sequences_with_images(sequence.training);
  if (sequence.name.empty() && shown.size() != 1)
    throw InputError(sequence.training, "sequences with images", std::to_string(shown.size()),
                     shown.empty()
                         ? "this is KITTI's tracking benchmark, but image_02 has no sequence"
                         : "add one to the path, as in " +
                               (sequence.training / *shown.begin()).string() + "; there are " +
                               first_few(std::vector(shown.begin(), shown.end())));
  if (sequence.name.empty()) sequence.name = *shown.begin();
  const std::string text_name = sequence.name + ".txt";
  const fs::path calibration_file = sequence.training / "calib" / text_name;
  const TrackingCalibration calibration =
      parse_tracking_calibration(read_file(calibration_file), calibration_file);
  const Rigid3d velodyne_from_body = calibration.velodyne_from_imu * imu_from_body(),
                rectified_from_body = calibration.rectified_from_camera *
                                      calibration.camera_from_velodyne * velodyne_from_body;

  Recording recording;
  recording.root = root;
  recording.frames = read_packets(sequence.training / "oxts" / text_name,
                                  DamagedList{"poses", &recording.damaged});
  add_cameras(sequence, calibration_file, calibration, rectified_from_body, &recording);

  const auto reader = std::make_shared<Reader>();
  reader->body_from_velodyne = velodyne_from_body.inverse(Eigen::Isometry);
  recording.lidar_files = list_frame_files(sequence.training / "velodyne" / sequence.name, "",
                                           {".bin"}, "velodyne", &recording.findings);
  drop_scans_behind(recording.frames, &recording.lidar_files, &recording.findings);
  if (!recording.lidar_files.empty()) recording.lidars = {{"lidar", reader->body_from_velodyne}};
  for (const FrameFile& scan : recording.lidar_files) {
    const std::int64_t t_ns = scan.frame_id * kFrameInterval_ns;
    reader->scans[scan.frame_id] = {t_ns - kFrameInterval_ns / 2, t_ns + kFrameInterval_ns / 2};
  }
  if (const fs::path file = sequence.training / "label_02" / text_name; is_there(file)) {
    const Rigid3d body_from_rectified = rectified_from_body.inverse(Eigen::Isometry);
    reader->boxes =
        place_boxes(parse_labels(read_file(file), file), body_from_rectified, recording.frames,
                    time_in_scans(velodyne_from_body * body_from_rectified, reader->scans));
    for (const auto& [frame_id, boxes] : reader->boxes)
      recording.box_files.push_back({frame_id, file});
  }
  recording.findings.push_back(
      {"times", "the tracking benchmark has none: frames are taken to be 0.1 s apart"});
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::kitti
