// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_reader.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/kitti/kitti_poses.h"

namespace redrive::kitti {
namespace {

constexpr std::int64_t kSameFrame_ns = 200'000'000;  // sensors of a frame; frames are 0.1 s apart
constexpr std::int64_t kOffsetJitter_ns = 5'000'000;

}  // namespace

Timestamps::Timestamps(const std::filesystem::path& path, const DamagedList* damaged)
    : file(path), by_line(parse_timestamps(read_file(path), path, damaged)) {}

std::optional<std::int64_t> Timestamps::of(std::int64_t frame_id, bool needed,
                                           const DamagedList* damaged) const {
  const bool has_line = frame_id < static_cast<std::int64_t>(by_line.size());
  if (needed)
    parse_record(damaged, frame_id, [&] {
      if (!has_line)
        throw InputError(file, "number of lines", std::to_string(by_line.size()),
                         "has none for frame " + std::to_string(frame_id) +
                             ": line n is of frame n - 1, also where files of other frames are "
                             "missing");
    });
  return has_line ? by_line[static_cast<std::size_t>(frame_id)] : std::nullopt;
}

bool Timestamps::is_same(std::int64_t frame_id, std::int64_t t_ns, std::int64_t other_ns,
                         const std::string& other, const DamagedList* damaged) const {
  return parse_record(damaged, frame_id, [&] {
    if (std::abs(t_ns - other_ns) > kSameFrame_ns)
      fail(frame_id, 1e-9 * static_cast<double>(t_ns - other_ns),
           "after " + other +
               " of the same frame; in synchronised drives they are 0.2 s apart at most");
  });
}

void Timestamps::fail(std::int64_t frame_id, double off_s, const std::string& rule) const {
  char value[64];
  std::snprintf(value, sizeof value, "%.3f s", off_s);
  throw InputError(file, "line " + std::to_string(frame_id + 1), value, rule);
}

std::int64_t time_offset_ns(const Timestamps& times, const std::string& camera,
                            const std::vector<ImageFile>& images,
                            const std::vector<FramePose>& frames, std::vector<Finding>* findings,
                            const DamagedList* damaged) {
  std::vector<std::int64_t> offsets;
  for (const ImageFile& image : images) {
    const auto frame = std::ranges::lower_bound(frames, image.frame_id, {}, &FramePose::id);
    const std::optional<std::int64_t> t_ns = times.of(image.frame_id, true, damaged);
    if (!t_ns || !times.is_same(image.frame_id, *t_ns, frame->t_ns, "the first camera", damaged))
      continue;
    offsets.push_back(*t_ns - frame->t_ns);
  }
  if (offsets.empty()) return 0;
  std::ranges::sort(offsets);
  const std::int64_t median = offsets[offsets.size() / 2];
  const auto off = std::ranges::count_if(
      offsets, [&](std::int64_t offset) { return std::abs(offset - median) > kOffsetJitter_ns; });
  if (off > 0)
    findings->push_back({camera, "the time of " + counted(std::size_t(off), "image") +
                                     " is more than 5 ms off a constant offset from the "
                                     "first camera's, which is used"});
  return median;
}

std::vector<LidarPoint> Reader::read_lidar(const FrameFile& file, std::size_t* left_out) const {
  return parse_scan(read_file(file.path, kMaxDataBytes), file.path, body_from_velodyne,
                    scans.at(file.frame_id), left_out);
}

std::uint64_t Reader::lidar_point_count(const FrameFile& file) const {
  std::error_code error;
  const std::uintmax_t bytes = std::filesystem::file_size(file.path, error);
  return error || bytes % kScanRecordBytes != 0 ? 0 : bytes / kScanRecordBytes;
}

std::vector<Box> Reader::read_boxes(const FrameFile& file) const { return boxes.at(file.frame_id); }

void drop_scans_behind(const std::vector<FramePose>& frames, std::vector<FrameFile>* scans,
                       std::vector<Finding>* findings) {
  std::vector<std::int64_t> behind;
  std::erase_if(*scans, [&](const FrameFile& file) {
    if (std::ranges::binary_search(frames, file.frame_id, {}, &FramePose::id)) return false;
    behind.push_back(file.frame_id);
    return true;
  });
  if (!behind.empty())
    findings->push_back(
        {"velodyne", "no pose for the scan of frame " + first_few(behind) + "; they are not used"});
}

CameraCalibration calibration_of(const RectifiedCamera& camera, ImageSize size,
                                 const std::string& name, const Rigid3d& rectified_from_body) {
  CameraCalibration calibration;
  calibration.name = name;
  calibration.model = "opencv_pinhole";
  calibration.parameters = {camera.fx, camera.fy, camera.cx, camera.cy, 0, 0, 0, 0, 0};
  calibration.width = size.width;
  calibration.height = size.height;
  calibration.body_from_sensor =
      (camera.camera_from_rectified * rectified_from_body).inverse(Eigen::Isometry);
  return calibration;
}

}  // namespace redrive::kitti
