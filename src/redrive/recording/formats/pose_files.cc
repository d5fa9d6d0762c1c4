// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pose_files.h"

#include <algorithm>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/damaged_records.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSameTime_ns =
    1'000'000;  // rounding of times in files; the next frame is 10 ms away or more

bool has_frame(const std::vector<FramePose>& frames, std::int64_t id) {
  return std::ranges::binary_search(frames, id, {}, &FramePose::id);
}

/// Moves poses to `damaged` whose times differ from the times of the recording's frames.
void leave_out_of_other_times(const std::vector<FramePose>& recorded, const DamagedList& damaged,
                              CalibratedPoses* poses) {
  std::erase_if(poses->frames, [&](const FramePose& pose) {
    const auto frame = std::ranges::lower_bound(recorded, pose.id, {}, &FramePose::id);
    if (frame == recorded.end() || frame->id != pose.id) return false;
    return !parse_record(&damaged, pose.id, [&] {
      if (std::abs(pose.t_ns - frame->t_ns) > kSameTime_ns)
        throw InputError(poses->frames_file, std::to_string(pose.id) + ".time",
                         std::to_string(pose.t_ns) + " ns",
                         "the recording's frame is at " + std::to_string(frame->t_ns) +
                             " ns: a pose of another drive");
    });
  });
}

/// Leaves out the frames without a pose, with their images; a finding counts them, except for the
/// `damaged` ones. InputError if no frame remains.
void keep_posed_frames(const CalibratedPoses& poses, const std::vector<DamagedRecord>& damaged,
                       Recording* recording) {
  const auto has_pose = [&](std::int64_t id) { return has_frame(poses.frames, id); };
  if (std::ranges::none_of(recording->frames, has_pose, &FramePose::id)) {
    if (!damaged.empty())
      throw InputError(poses.frames_file, "", "", "no pose can be used: " + damaged.front().why);
    throw InputError(poses.frames_file, std::to_string(recording->frames.front().id), "",
                     "missing, as are all frames of the recording: poses of another drive");
  }
  const auto lacking = static_cast<std::size_t>(
      std::ranges::count_if(recording->frames, [&](const FramePose& frame) {
        return !has_pose(frame.id) &&
               std::ranges::find(damaged, frame.id, &DamagedRecord::frame_id) == damaged.end();
      }));
  keep_frames({poses.frames.front().id, poses.frames.back().id}, recording);
  std::erase_if(recording->frames, [&](const FramePose& frame) { return !has_pose(frame.id); });
  for (RecordedCamera& camera : recording->cameras)
    std::erase_if(camera.images, [&](const ImageFile& image) { return !has_pose(image.frame_id); });
  std::erase_if(recording->cameras,
                [](const RecordedCamera& camera) { return camera.images.empty(); });
  const std::size_t kept = recording->frames.size();
  if (lacking > 0)
    recording->findings.push_back({poses.frames_file.string(), "has poses of " +
                                                                   counted(kept, "frame") + " of " +
                                                                   std::to_string(kept + lacking) +
                                                                   "; the others are left out"});
}

}  // namespace

PoseFiles read_pose_files(const Recording& recording, const fs::path& folder) {
  PoseFiles files;
  for (const fs::path& name : recording.reader->pose_file_names())
    files[name] = read_file(folder / name);
  return files;
}

void write_pose_files(const fs::path& folder, const PoseFiles& files) {
  for (const auto& [name, text] : files) {
    std::error_code error;
    fs::create_directories((folder / name).parent_path(), error);
    if (error) throw IoError((folder / name).parent_path(), error.message());
    write_file(folder / name, text);
  }
}

void apply_pose_files(const PoseFiles& files, const fs::path& folder, Recording* recording,
                      const FrameRange& frames) {
  if (!recording->metric)
    throw InputError(folder, "", "",
                     "poses in these formats belong to a drive, not to photographs");
  std::vector<DamagedRecord> records;
  const DamagedList damaged{"poses", &records};
  CalibratedPoses poses = recording->reader->parse_pose_files(files, folder, &damaged);
  leave_out_of_other_times(recording->frames, damaged, &poses);
  std::erase_if(records, [&](const DamagedRecord& record) {
    return !record.breaks && !has_frame(recording->frames, record.frame_id);
  });
  keep_posed_frames(poses, records, recording);
  for (FramePose& frame : recording->frames)
    frame = *std::ranges::lower_bound(poses.frames, frame.id, {}, &FramePose::id);
  require_few_left_out({.frames = frames, .most_percent = recording->most_damaged_percent}, records,
                       recording);
  if (!recording->lidars.empty()) recording->lidars[0].elevation_rad = poses.lidar_elevation_rad;
  for (RecordedCamera& camera : recording->cameras) {
    const auto found =
        std::ranges::find(poses.cameras, camera.calibration.name, &CameraCalibration::name);
    if (found == poses.cameras.end())
      throw InputError(poses.cameras_file, camera.calibration.name, "",
                       "missing; the recording has images of this camera");
    camera.calibration = *found;
  }
}

}  // namespace redrive
