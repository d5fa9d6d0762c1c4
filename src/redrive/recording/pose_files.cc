// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/pose_files.h"

#include <algorithm>
#include <cstdlib>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/recording/aimotive.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

const fs::path kEgomotion = "sensor/gnssins/egomotion2.json",
               kCalibration = "sensor/calibration/calibration.json";
constexpr std::int64_t kSameTime_ns =
    1'000'000;  // clocks are written with other digits; the next frame is 10 ms away or more

nlohmann::json rows_of(const Rigid3d& pose) {
  nlohmann::json rows = nlohmann::json::array();
  for (int r = 0; r < 4; ++r) {
    rows.push_back(nlohmann::json::array());
    for (int c = 0; c < 4; ++c)
      rows.back().push_back(r < 3 ? pose.matrix()(r, c) : c == 3 ? 1.0 : 0.0);
  }
  return rows;
}

}  // namespace

PoseFiles read_pose_files(const fs::path& folder) {
  return {read_file(folder / kEgomotion), read_file(folder / kCalibration)};
}

void write_pose_files(const fs::path& folder, const PoseFiles& files) {
  for (const auto& [name, text] :
       {std::pair(kEgomotion, &files.egomotion), std::pair(kCalibration, &files.calibration)}) {
    std::error_code error;
    fs::create_directories((folder / name).parent_path(), error);
    if (error) throw IoError((folder / name).parent_path(), error.message());
    write_file(folder / name, *text);
  }
}

PoseFiles make_pose_files(const Recording& recording, const std::vector<FramePose>& frames,
                          const std::vector<CameraCalibration>& cameras) {
  nlohmann::json poses = nlohmann::json::object();
  for (const FramePose& frame : frames) {
    const double t_s = static_cast<double>(frame.t_ns) * 1e-9;
    poses[std::to_string(frame.id)] = {
        {"RT_ECEF_body", rows_of(frame.global_from_body)}, {"time", t_s}, {"time_host", t_s}};
  }
  nlohmann::json sensors = read_json(recording.root / kCalibration);
  for (const CameraCalibration& camera : cameras) {
    nlohmann::json& sensor = sensors.at(camera.name);
    const Eigen::Vector3d position = camera.body_from_sensor.translation();
    sensor["RT_body_from_sensor"] = rows_of(camera.body_from_sensor);
    sensor["RT_sensor_from_body"] = rows_of(camera.body_from_sensor.inverse(Eigen::Isometry));
    if (sensor.contains("pos_meter"))
      sensor["pos_meter"] = {position.x(), position.y(), position.z()};
    sensor.erase("yaw_pitch_roll_deg");
    sensor["focal_length_px"] = {camera.fx(), camera.fy()};
    sensor["principal_point_px"] = {camera.cx(), camera.cy()};
    sensor["time_offset_s"] = static_cast<double>(camera.time_offset_ns) * 1e-9;
    if (camera.readout_ns != 0 || sensor.contains("readout_s"))
      sensor["readout_s"] = static_cast<double>(camera.readout_ns) / 1e9;
  }
  return {poses.dump(1) + "\n", sensors.dump(1) + "\n"};
}

void apply_pose_files(const PoseFiles& files, const fs::path& folder, Recording* recording) {
  if (!recording->metric)
    throw InputError(folder, "", "",
                     "poses in these formats belong to a drive, not to photographs");
  std::vector<FramePose> poses = aimotive::parse_egomotion(files.egomotion, folder / kEgomotion);
  for (FramePose& frame : recording->frames) {
    const auto found = std::ranges::lower_bound(poses, frame.id, {}, &FramePose::id);
    const std::string id = std::to_string(frame.id);
    if (found == poses.end() || found->id != frame.id)
      throw InputError(folder / kEgomotion, id, "", "missing; the recording has this frame");
    if (std::abs(found->t_ns - frame.t_ns) > kSameTime_ns)
      throw InputError(folder / kEgomotion, id + ".time", std::to_string(found->t_ns) + " ns",
                       "the recording's frame is of " + std::to_string(frame.t_ns) +
                           " ns: poses of another drive");
    frame = *found;
  }
  const std::vector<CameraCalibration> cameras =
      aimotive::parse_calibration(files.calibration, folder / kCalibration, nullptr);
  for (RecordedCamera& camera : recording->cameras) {
    const auto found =
        std::ranges::find(cameras, camera.calibration.name, &CameraCalibration::name);
    if (found == cameras.end())
      throw InputError(folder / kCalibration, camera.calibration.name, "",
                       "missing; the recording has images of this camera");
    camera.calibration = *found;
  }
}

}  // namespace redrive
