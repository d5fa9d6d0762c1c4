// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/pose_files.h"

#include <algorithm>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/recording/frame_range.h"
#include "redrive/recording/wording.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kSameTime_ns =
    1'000'000;  // rounding of times in files; the next frame is 10 ms away or more

/// Leaves out the frames of which the files have no pose, with their images; a finding counts them.
/// InputError if that are all.
void keep_posed_frames(const CalibratedPoses& poses, Recording* recording) {
  const std::size_t recorded = recording->frames.size();
  const auto has_pose = [&](std::int64_t id) {
    return std::ranges::binary_search(poses.frames, id, {}, &FramePose::id);
  };
  if (std::ranges::none_of(recording->frames, has_pose, &FramePose::id))
    throw InputError(poses.frames_file, std::to_string(recording->frames.front().id), "",
                     "missing, as are all frames of the recording: poses of another drive");
  keep_frames({poses.frames.front().id, poses.frames.back().id}, recording);
  std::erase_if(recording->frames, [&](const FramePose& frame) { return !has_pose(frame.id); });
  for (RecordedCamera& camera : recording->cameras)
    std::erase_if(camera.images, [&](const ImageFile& image) { return !has_pose(image.frame_id); });
  std::erase_if(recording->cameras,
                [](const RecordedCamera& camera) { return camera.images.empty(); });
  if (recording->frames.size() < recorded)
    recording->findings.push_back(
        {poses.frames_file.string(), "has poses of " + counted(recording->frames.size(), "frame") +
                                         " of " + std::to_string(recorded) +
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

void apply_pose_files(const PoseFiles& files, const fs::path& folder, Recording* recording) {
  if (!recording->metric)
    throw InputError(folder, "", "",
                     "poses in these formats belong to a drive, not to photographs");
  const CalibratedPoses poses = recording->reader->parse_pose_files(files, folder);
  keep_posed_frames(poses, recording);
  for (FramePose& frame : recording->frames) {
    const FramePose& found = *std::ranges::lower_bound(poses.frames, frame.id, {}, &FramePose::id);
    if (std::abs(found.t_ns - frame.t_ns) > kSameTime_ns)
      throw InputError(poses.frames_file, std::to_string(frame.id) + ".time",
                       std::to_string(found.t_ns) + " ns",
                       "the recording's frame is of " + std::to_string(frame.t_ns) +
                           " ns: poses of another drive");
    frame = found;
  }
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
