// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/excerpt.h"

#include <algorithm>
#include <set>

#include "redrive/recording/core/wording.h"

namespace redrive {
namespace {

using Ids = std::set<std::int64_t>;

Ids ids_of_images(const Recording& recording) {
  Ids ids;
  for (const RecordedCamera& camera : recording.cameras)
    for (const ImageFile& image : camera.images) ids.insert(image.frame_id);
  return ids;
}

/// Returns the frames of the scans; none where the place of the sensor is unknown.
Ids ids_of_scans(const Recording& recording) {
  Ids ids;
  if (!recording.lidars.empty())
    for (const FrameFile& scan : recording.lidar_files) ids.insert(scan.frame_id);
  return ids;
}

/// Returns the ids of frames for which `holds`.
template <class Holds>
std::vector<std::int64_t> frames_where(const Recording& recording, const Holds& holds) {
  std::vector<std::int64_t> ids;
  for (const FramePose& frame : recording.frames)
    if (holds(frame.id)) ids.push_back(frame.id);
  return ids;
}

void report_scans(Recording* recording) {
  const std::int64_t first = recording->frames.front().id, last = recording->frames.back().id;
  std::vector<std::int64_t> beyond;
  for (const std::int64_t id : ids_of_scans(*recording))
    if (id < first || id > last) beyond.push_back(id);
  if (!beyond.empty())
    recording->findings.push_back({"lidar", counted(beyond.size(), "scan") +
                                                " before the first frame or behind the last, " +
                                                "not used: " + first_few(beyond)});
}

void report_boxes(Recording* recording) {
  Ids ids;
  for (const FramePose& frame : recording->frames) ids.insert(frame.id);
  if (!recording->box_files.empty() &&
      std::ranges::none_of(recording->box_files,
                           [&](const FrameFile& file) { return ids.contains(file.frame_id); }))
    recording->findings.push_back(
        {"boxes", "not used: all " + std::to_string(recording->box_files.size()) +
                      " are of other frames, the first of " +
                      std::to_string(recording->box_files.front().frame_id)});
}

}  // namespace

void drop_foreign_points(const FramePose& first, Recording* recording) {
  if (!recording->metric || recording->points_file.empty() ||
      recording->frames.front().id == first.id)
    return;
  recording->findings.push_back({recording->points_file.filename().string(),
                                 "not used: it is in the body axes of the first frame, which is "
                                 "left out"});
  recording->points_file.clear();
}

void leave_out_empty_frames(Recording* recording) {
  if (!recording->metric) return;
  const Ids images = ids_of_images(*recording), scans = ids_of_scans(*recording);
  const auto is_empty = [&](std::int64_t id) {
    return !images.contains(id) && !scans.contains(id);
  };
  const std::vector<std::int64_t> empty = frames_where(*recording, is_empty);
  if (empty.empty() || empty.size() == recording->frames.size()) return;
  drop_foreign_points(*std::ranges::find_if_not(recording->frames, is_empty, &FramePose::id),
                      recording);
  std::erase_if(recording->frames, [&](const FramePose& frame) { return is_empty(frame.id); });
  recording->findings.push_back(
      {"frames", counted(empty.size(), "pose") +
                     " without an image or a scan, left out: " + first_few(empty) + "; " +
                     std::to_string(recording->frames.size()) + " frames remain"});
}

void report_gaps(Recording* recording) {
  if (!recording->metric || recording->frames.empty()) return;
  const Ids shown = ids_of_images(*recording);
  for (const RecordedCamera& camera : recording->cameras) {
    const auto missing = frames_where(*recording, [&](std::int64_t id) {
      return shown.contains(id) &&
             !std::ranges::binary_search(camera.images, id, {}, &ImageFile::frame_id);
    });
    if (!missing.empty())
      recording->findings.push_back(
          {camera.calibration.name, "no image of " + counted(missing.size(), "frame") +
                                        " that other cameras have: " + first_few(missing)});
  }
  const auto scanned =
      frames_where(*recording, [&](std::int64_t id) { return !shown.contains(id); });
  if (!scanned.empty())
    recording->findings.push_back(
        {"frames", counted(scanned.size(), "frame") +
                       " with a scan and no image, for align alone: " + first_few(scanned)});
  report_scans(recording);
  report_boxes(recording);
}

}  // namespace redrive
