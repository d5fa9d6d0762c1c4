// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <functional>
#include <map>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/kitti/kitti.h"
#include "redrive/recording/formats/kitti/kitti_calibration.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"
#include "redrive/recording/formats/kitti/kitti_reader.h"

namespace redrive::kitti {
namespace {

namespace fs = std::filesystem;

constexpr const char* kSequenceFolders[] = {"image_0", "image_1", "image_2", "image_3"};

/// poses/NN.txt of sequences/NN.
fs::path poses_file_of(const fs::path& root) {
  fs::path sequence = fs::absolute(root).lexically_normal();
  if (!sequence.has_filename()) sequence = sequence.parent_path();
  const fs::path file =
      sequence.parent_path().parent_path() / "poses" / (sequence.filename().string() + ".txt");
  if (!is_there(file))
    throw InputError(file, "", "", "missing: KITTI has poses of sequences 00 to 10");
  return file;
}

/// Returns frames of the lines that both files have. Frames with images of which one file alone has
/// the line go to `damaged`.
std::vector<FramePose> read_frames(const fs::path& root,
                                   const std::function<bool(std::int64_t)>& is_shown,
                                   const DamagedList& damaged, std::vector<Finding>* findings) {
  const fs::path times_file = root / "times.txt", poses_file = poses_file_of(root);
  const auto times = parse_times(read_file(times_file), times_file, &damaged);
  const auto poses = parse_poses(read_file(poses_file), poses_file, &damaged);
  const std::size_t both = std::min(poses.size(), times.size());
  if (poses.size() != times.size())
    findings->push_back(
        {poses_file.filename().string(), "has " + counted(poses.size(), "line") + ", times.txt " +
                                             std::to_string(times.size()) + "; the first " +
                                             std::to_string(both) + " of both are used"});
  const fs::path& shorter = poses.size() < times.size() ? poses_file : times_file;
  for (std::size_t i = 0; i < std::max(poses.size(), times.size()); ++i)
    if (const auto id = static_cast<std::int64_t>(i); is_shown(id))
      parse_record(&damaged, id, [&] {
        if (i >= both)
          throw InputError(shorter, "number of lines", std::to_string(both),
                           "has none for frame " + std::to_string(id));
      });
  std::vector<FramePose> frames;
  for (std::size_t i = 0; i < both; ++i)
    if (times[i] && poses[i])
      frames.push_back(
          {static_cast<std::int64_t>(i), *times[i], *poses[i] * rectified_from_body()});
  leave_out_impossible(poses_file, {"time", "pose"}, &damaged, &frames);
  return frames;
}

}  // namespace

bool looks_like_odometry(const fs::path& root) {
  return (is_there(root / "calib.txt") || is_there(root / "times.txt")) &&
         (is_folder(root / "velodyne") ||
          std::ranges::any_of(kSequenceFolders,
                              [&](const char* name) { return is_folder(root / name); }));
}

Recording open_odometry(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  const fs::path calibration_file = root / "calib.txt";
  const OdometryCalibration calibration =
      parse_odometry_calibration(read_file(calibration_file), calibration_file);
  Recording recording;
  recording.root = root;
  recording.global_frame = GlobalFrame::kArbitrary;
  std::vector<Finding>& findings = recording.findings;
  std::map<std::string, std::vector<FrameFile>> folders;
  std::set<std::int64_t> shown;
  for (const std::string name : kSequenceFolders) {
    folders[name] = list_frame_files(root / name, "", {".png"}, name, &findings);
    for (const FrameFile& file : folders[name]) shown.insert(file.frame_id);
  }
  recording.frames = read_frames(
      root, [&](std::int64_t id) { return shown.contains(id); },
      DamagedList{"poses", &recording.damaged}, &findings);
  for (auto& [name, files] : folders) {
    std::vector<ImageFile> images =
        images_with_poses(std::move(files), name, recording.frames, &findings);
    if (images.empty()) continue;
    const auto found = calibration.cameras.find(name.back() - '0');
    if (found == calibration.cameras.end())
      throw InputError(calibration_file, "P" + name.substr(6), "",
                       "missing; the sequence has images of this camera");
    const std::optional<ImageSize> size = usual_image_size(images);
    if (!size) throw InputError(images[0].path, "", "", "is no PNG image");
    recording.cameras.push_back(
        {calibration_of(found->second, *size, name, rectified_from_body()), std::move(images)});
  }
  require_cameras(recording);

  recording.lidar_files = list_frame_files(root / "velodyne", "", {".bin"}, "velodyne", &findings);
  if (!recording.lidar_files.empty()) {
    if (!calibration.rectified_from_velodyne)
      throw InputError(calibration_file, "Tr", "", "missing; the sequence has velodyne scans");
    const auto reader = std::make_shared<Reader>();
    reader->body_from_velodyne =
        rectified_from_body().inverse(Eigen::Isometry) * *calibration.rectified_from_velodyne;
    recording.lidars = {{"lidar", reader->body_from_velodyne}};
    drop_scans_behind(recording.frames, &recording.lidar_files, &findings);
    // The benchmark's scans are motion compensated to the time of their frame.
    for (const FrameFile& file : recording.lidar_files) {
      const std::int64_t t_ns =
          std::ranges::lower_bound(recording.frames, file.frame_id, {}, &FramePose::id)->t_ns;
      reader->scans[file.frame_id] = {t_ns, t_ns};
    }
    recording.reader = reader;
  }
  return recording;
}

}  // namespace redrive::kitti
