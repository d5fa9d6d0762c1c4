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
  const std::size_t recorded = recording->frames.size();
  const auto covered = [&](const FramePose& frame) {
    return frame.id >= poses.frames.front().id && frame.id <= poses.frames.back().id;
  };
  if (std::ranges::any_of(recording->frames, covered) &&
      !std::ranges::all_of(recording->frames, covered)) {
    keep_frames({poses.frames.front().id, poses.frames.back().id}, recording);
    recording->findings.push_back(
        {poses.frames_file.string(), "has poses of " + counted(recording->frames.size(), "frame") +
                                         " of " + std::to_string(recorded) +
                                         "; the others are left out"});
  }
  for (FramePose& frame : recording->frames) {
    const auto found = std::ranges::lower_bound(poses.frames, frame.id, {}, &FramePose::id);
    const std::string id = std::to_string(frame.id);
    if (found == poses.frames.end() || found->id != frame.id)
      throw InputError(poses.frames_file, id, "", "missing; the recording has this frame");
    if (std::abs(found->t_ns - frame.t_ns) > kSameTime_ns)
      throw InputError(poses.frames_file, id + ".time", std::to_string(found->t_ns) + " ns",
                       "the recording's frame is of " + std::to_string(frame.t_ns) +
                           " ns: poses of another drive");
    frame = *found;
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
