// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/kitti/kitti_parts.h"

#include <algorithm>
#include <chrono>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/camera/models.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/kitti/kitti_write.h"

namespace redrive {
namespace {

constexpr double kExact_m = 1e-6;

/// Returns the greatest distance of a camera's poses from the poses that a reader of `written`
/// finds, metres.
double distance_from(const std::vector<FramePose>& written, const std::vector<FramePose>& frames,
                     std::int64_t offset_ns) {
  double most_m = 0;
  for (const FramePose& frame : frames) {
    const std::int64_t t_ns = frame.t_ns + offset_ns;
    most_m = std::max(
        most_m,
        (pose_at(written, t_ns).translation() - pose_at(frames, t_ns).translation()).norm());
  }
  return most_m;
}

}  // namespace

bool is_perspective(const CameraCalibration& camera) {
  return find_camera_model(camera.model)->perspective;
}

KittiSlots fill_slots(
    const std::vector<const RecordedCamera*>& cameras, const std::vector<std::string>& folders,
    const std::function<bool(const CameraCalibration& camera, const std::string& folder)>& fits,
    std::vector<const RecordedCamera*>* left, DriveNotes* notes) {
  KittiSlots slots;
  std::vector<const RecordedCamera*> others;
  for (const RecordedCamera* camera : cameras) {
    const std::string& name = camera->calibration.name;
    if (std::ranges::find(folders, name) != folders.end() && fits(camera->calibration, name))
      slots[name] = camera;
    else
      others.push_back(camera);
  }
  std::ranges::stable_sort(others, std::ranges::greater(), [](const RecordedCamera* camera) {
    return camera->calibration.body_from_sensor.translation().y();
  });
  for (const RecordedCamera* camera : others) {
    const CameraCalibration& calibration = camera->calibration;
    const auto folder = std::ranges::find_if(folders, [&](const std::string& name) {
      return !slots.contains(name) && fits(calibration, name);
    });
    if (folder == folders.end()) {
      left->push_back(camera);
    } else {
      slots[*folder] = camera;
      notes->changed.push_back(calibration.name + " is " + *folder);
    }
  }
  return slots;
}

KittiFrames frames_of_first_camera(const Recording& drive, std::int64_t offset_ns, bool from_zero,
                                   DriveNotes* notes) {
  KittiFrames out{{}, offset_ns, 0};
  const std::int64_t first_id = drive.frames.front().id, last_id = drive.frames.back().id;
  out.earlier_ids = last_id < kitti::kMaxTimes && !from_zero ? 0 : first_id;
  if (last_id - out.earlier_ids >= kitti::kMaxTimes)
    throw InputError(drive.root, "frame id", std::to_string(last_id),
                     "KITTI has files of a line for every number; a million fit");
  if (out.earlier_ids != 0)
    notes->changed.push_back("frame " + std::to_string(first_id) + " is frame 0");
  if (drive.frames.front().t_ns < 0 || offset_ns + drive.frames.front().t_ns < 0)
    throw InputError(drive.root, "time", std::to_string(drive.frames.front().t_ns) + " ns",
                     "dates before 1970 cannot be written");
  for (const FramePose& frame : drive.frames) {
    const std::int64_t t_ns = frame.t_ns + offset_ns;
    out.frames.push_back({frame.id - out.earlier_ids, t_ns, pose_at(drive.frames, t_ns)});
  }
  return out;
}

void write_camera_times(const std::filesystem::path& folder, const std::string& name,
                        const RecordedCamera& camera, const Recording& drive,
                        const KittiFrames& frames, DriveNotes* notes) {
  const std::int64_t offset_ns = camera.calibration.time_offset_ns;
  std::vector<std::pair<std::int64_t, std::int64_t>> times;
  for (const FramePose& frame : frames.frames)
    times.emplace_back(frame.id, frame.t_ns + offset_ns - frames.offset_ns);
  make_folders(folder);
  write_file(folder / "timestamps.txt", kitti::make_timestamps(times));
  if (const double m = distance_from(frames.frames, drive.frames, offset_ns); m > kExact_m)
    notes->changed.push_back("poses of " + name +
                             ", interpolated from the first camera's, are up to" +
                             formatted(" %.2g mm off", 1e3 * m));
}

void note_rolling(const KittiSlots& slots, DriveNotes* notes) {
  std::string rolling;
  for (const auto& [name, camera] : slots)
    if (camera->calibration.readout_ns != 0) rolling += (rolling.empty() ? "" : ", ") + name;
  if (!rolling.empty())
    notes->left_out.push_back("rolling shutter of " + rolling +
                              ": each image has the pose of its middle row");
}

void note_resampled(const std::string& name, const CameraCalibration& recorded,
                    const PhotoCamera& camera, DriveNotes* notes) {
  if (!camera.resampled) return;
  const double turned_deg =
      kDegreesPerRadian * Eigen::AngleAxisd(camera.recorded_from_written).angle();
  notes->changed.push_back(
      "the lens of " + name + " (" + recorded.model + "): its images are resampled to a pinhole" +
      (turned_deg > 0 ? formatted(", turned by %.2f degrees,", turned_deg) : "") +
      formatted(" with a focal length of %.1f instead of %.1f pixels", camera.calibration.fx(),
                recorded.fx()));
}

std::string perspective_lines(const CameraCalibration& camera, const std::string& number,
                              const Eigen::Vector3d& first_in_camera) {
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k(0, 0) = camera.fx(), k(1, 1) = camera.fy(), k(0, 2) = camera.cx(), k(1, 2) = camera.cy();
  Eigen::Matrix<double, 3, 4> p;
  p << k, k * first_in_camera;
  std::string text = formatted("S_rect_%s: %d %d\n", number.c_str(), camera.width, camera.height) +
                     "R_rect_" + number + ": 1 0 0 0 1 0 0 0 1\nP_rect_" + number + ":";
  for (int i = 0; i < 12; ++i) text += formatted(" %.17g", p(i / 4, i % 4));
  return text + "\n";
}

std::string date_of(std::int64_t t_ns) {
  const std::chrono::sys_time<std::chrono::nanoseconds> time{std::chrono::nanoseconds(t_ns)};
  const std::chrono::year_month_day date(std::chrono::floor<std::chrono::days>(time));
  return formatted("%04d_%02u_%02u", int(date.year()), unsigned(date.month()),
                   unsigned(date.day()));
}

std::string row_text(const Rigid3d& transform, int rows) {
  std::string text;
  for (int i = 0; i < 4 * rows; ++i)
    text += formatted(i == 0 ? "%.17g" : " %.17g", transform.matrix()(i / 4, i % 4));
  return text;
}

}  // namespace redrive
