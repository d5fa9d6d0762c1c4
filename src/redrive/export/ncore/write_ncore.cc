// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <set>

#include "redrive/base/error.h"
#include "redrive/export/drive.h"
#include "redrive/export/ncore/ncore_sensors.h"
#include "redrive/export/ncore/ncore_terms.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive {
namespace {

using ncore::Json;
using ncore::Sequence;
using ncore::WrittenSensor;

/// Text of a tuple in Python.
std::string frames_key(const std::string& from, const std::string& to) {
  return "('" + from + "', '" + to + "')";
}

/// The world has the axes of the body at the first frame.
void write_poses(const Recording& drive, const std::vector<WrittenSensor>& sensors,
                 Sequence* sequence) {
  const Rigid3d& global_from_world = drive.frames.front().global_from_body;
  const Rigid3d world_from_global = global_from_world.inverse(Eigen::Isometry);
  std::set<std::int64_t> times{sequence->first_us(), sequence->last_us()};
  for (const FramePose& frame : drive.frames) times.insert(sequence->us(frame.t_ns));
  Json poses = Json::array();
  for (const std::int64_t us : times)
    poses.push_back(
        Json(rigid_to_json(world_from_global * pose_at(drive.frames, sequence->ns(us)))));
  const auto fixed = [](const Rigid3d& pose) {
    return Json{{"pose", Json(rigid_to_json(pose))}, {"dtype", "float64"}};
  };
  Json placed = Json::object();
  for (const WrittenSensor& sensor : sensors)
    placed[frames_key(sensor.id, "rig")] = fixed(sensor.rig_from_sensor);
  if (drive.global_frame == GlobalFrame::kEcef)
    placed[frames_key("world", "world_global")] = fixed(global_from_world);
  const std::string component = sequence->component("poses", "default");
  sequence->store().group(component + "/static_poses", placed);
  sequence->store().group(component + "/dynamic_poses",
                          {{frames_key("rig", "world"),
                            {{"poses", poses}, {"timestamps_us", times}, {"dtype", "float64"}}}});
}

void write_intrinsics(const std::vector<WrittenSensor>& cameras,
                      const std::vector<WrittenSensor>& lidars, Sequence* sequence) {
  ZarrStore& store = sequence->store();
  const std::string component = sequence->component("intrinsics", "default");
  store.group(component + "/cameras");
  store.group(component + "/lidars");
  for (const WrittenSensor& camera : cameras) {
    Json attributes = {{"camera_model_type", camera.model["type"]},
                       {"camera_model_parameters", camera.model["parameters"]}};
    if (const auto glass = camera.model.find("external_distortion_type");
        glass != camera.model.end())
      attributes["external_distortion_type"] = *glass;
    store.group(component + "/cameras/" + camera.id, attributes);
  }
  for (const WrittenSensor& lidar : lidars)
    if (!lidar.model.is_null())
      store.group(component + "/lidars/" + lidar.id,
                  {{"lidar_model_type", lidar.model["type"]},
                   {"lidar_model_parameters", lidar.model["parameters"]}});
  const std::string masks = sequence->component("masks", "default");
  store.group(masks + "/cameras");
  for (const WrittenSensor& camera : cameras) {
    const std::string path = masks + "/cameras/" + camera.id;
    Json names = Json::array();
    if (!camera.ego.empty()) names.push_back("ego");
    store.group(path, {{"mask_names", names}});
    if (!camera.ego.empty()) store.file(path + "/ego", camera.ego, {{"format", "png"}});
  }
}

/// Boxes lie in the axes of the rig at their own time.
void write_cuboids(const Recording& drive, Sequence* sequence, DriveNotes* notes) {
  Json observations = Json::array();
  std::size_t beyond = 0;
  std::set<std::string> classes;
  for (const FrameFile& file : drive.box_files)
    for (const Box& box : drive.reader->read_boxes(file)) {
      if (ncore::is_beyond_poses(drive, box.t_ns)) {
        ++beyond;
        continue;
      }
      const std::int64_t us = sequence->us(box.t_ns);
      sequence->cover(us, us);
      const std::string word = ncore::class_of_box(box.type);
      if (word != box.type) classes.insert(box.type + " is " + word);
      observations.push_back(
          {{"track_id", std::to_string(box.object_id)},
           {"class_id", word},
           {"timestamp_us", us},
           {"reference_frame_id", "rig"},
           {"reference_frame_timestamp_us", us},
           {"bbox3",
            {{"centroid", vector_to_json(box.body_from_box.translation())},
             {"dim", vector_to_json(box.size_m)},
             {"rot", vector_to_json(roll_pitch_yaw(box.body_from_box.linear()))}}},
           {"source", "EXTERNAL"},
           {"source_version", nullptr}});
    }
  const std::string component = sequence->component("cuboids", "default");
  sequence->store().group(component + "/cuboids",
                          {{"cuboid_track_observations", std::move(observations)}});
  if (!classes.empty())
    notes->changed.push_back("boxes have NuRec's classes: " +
                             first_few(std::vector<std::string>(classes.begin(), classes.end())));
  if (beyond > 0) notes->left_out.push_back(counted(beyond, "box record") + " without a pose");
}

std::string sequence_id(const Recording& drive) {
  const std::filesystem::path root = std::filesystem::absolute(drive.root).lexically_normal();
  std::string id = (root.has_filename() ? root : root.parent_path()).filename().string();
  std::ranges::replace_if(
      id, [](unsigned char c) { return c <= ' ' || c == '/'; }, '_');
  return id.empty() ? "drive" : id;
}

}  // namespace

DriveNotes write_ncore(const std::filesystem::path& folder, const Recording& drive,
                       ThreadPool& pool, const std::atomic<bool>& stop) {
  DriveNotes notes;
  Sequence sequence(folder, sequence_id(drive), -added_to_times_ns(drive, &notes));
  sequence.cover(sequence.us(drive.frames.front().t_ns), sequence.us(drive.frames.back().t_ns));
  std::vector<WrittenSensor> cameras, lidars;
  for (const RecordedCamera& camera : drive.cameras)
    cameras.push_back(write_camera(camera, drive.frames, pool, stop, &sequence, &notes));
  for (std::size_t k = 0; k < drive.lidars.size(); ++k)
    if (!drive.scans_of(k).empty())
      lidars.push_back(write_lidar(drive, k, pool, stop, &sequence, &notes));
  if (sequence.first_us() == sequence.last_us())  // NCore interpolates between two poses
    sequence.cover(sequence.first_us(), sequence.last_us() + 1);
  if (!drive.box_files.empty()) write_cuboids(drive, &sequence, &notes);
  write_intrinsics(cameras, lidars, &sequence);
  std::vector<WrittenSensor> sensors = cameras;
  sensors.insert(sensors.end(), lidars.begin(), lidars.end());
  write_poses(drive, sensors, &sequence);
  sequence.finish();
  note_not_of_drives(drive, &notes);
  if (!drive.points_file.empty()) notes.left_out.emplace_back("the static point cloud");
  return notes;
}

}  // namespace redrive
