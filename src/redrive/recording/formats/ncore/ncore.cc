// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/recording/formats/ncore/ncore_contents.h"
#include "redrive/recording/formats/ncore/ncore_cuboids.h"
#include "redrive/recording/formats/ncore/ncore_lens.h"
#include "redrive/recording/formats/ncore/ncore_poses.h"
#include "redrive/recording/formats/ncore/ncore_scan.h"
#include "redrive/recording/formats/ncore/ncore_stores.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/recording/formats/timed_images.h"

namespace redrive::ncore {
namespace {

namespace fs = std::filesystem;

constexpr double kEarth_m = 6.3e6, kEarthTop_m = 6.4e6;  // radii, to the highest roads

class Reader : public RecordingReader {
 public:
  std::vector<LidarPoint> read_lidar(const FrameFile& file,
                                     std::size_t* left_out = nullptr) const override {
    return read_scan(contents->scan(file.path), places.at(file.lidar), left_out);
  }
  std::uint64_t lidar_point_count(const FrameFile& file) const override {
    return ray_count(contents->scan(file.path));
  }
  std::vector<Box> read_boxes(const FrameFile& file) const override {
    return boxes.at(file.frame_id);
  }

  std::shared_ptr<Contents> contents;
  std::vector<Rigid3d> places;                     ///< RecordedLidar::body_from_lidar
  std::map<std::int64_t, std::vector<Box>> boxes;  ///< key: frame; for Recording::box_files
};

/// What stands in all components and is read first.
struct SequenceParts {
  Components components;
  Poses poses;
  Component intrinsics;
  std::optional<Component> masks;

  const std::vector<Component>& of_kind(const std::string& kind) const {
    static const std::vector<Component> none;
    const auto found = components.find(kind);
    return found == components.end() ? none : found->second;
  }
};

/// A camera's mask of the own car; no path where it has none.
MaskFile find_mask(const SequenceParts& sequence, const std::string& camera, Contents* contents,
                   std::vector<Finding>* findings) {
  if (!sequence.masks) return {};
  const std::string group = "cameras/" + camera;
  const nlohmann::json attributes = sequence.masks->attributes(group);
  if (!attributes.contains("mask_names")) return {};
  const JsonField names = JsonField(attributes, sequence.masks->file(group)).at("mask_names");
  MaskFile mask;
  std::vector<std::string> others;
  for (std::size_t i = 0; i < names.size(); ++i) {
    const std::string name = names.at(i).string();
    if (name == "ego")
      mask = contents->add_mask(*sequence.masks, sequence.masks->path + "/" + group + "/" + name,
                                camera);
    else
      others.push_back(name);
  }
  if (!others.empty()) findings->push_back({camera, "masks not used: " + first_few(others)});
  return mask;
}

CameraCalibration calibration_of(const SequenceParts& sequence, const Component& sensor,
                                 int* direction, std::vector<Finding>* findings) {
  const std::string group = "cameras/" + sensor.name;
  const nlohmann::json attributes = sequence.intrinsics.attributes(group);
  const JsonField intrinsics(attributes, sequence.intrinsics.file(group));
  CameraCalibration calibration;
  calibration.name = sensor.name;
  parse_lens(intrinsics, &calibration, findings);
  *direction = parse_shutter(intrinsics, &calibration);
  const auto place = sequence.poses.between(sensor.name, "rig");
  if (!place)
    throw InputError(sequence.poses.file, "('" + sensor.name + "', 'rig')", "",
                     "is missing: no fixed poses lead from the camera to the rig");
  calibration.body_from_sensor = *place;
  return calibration;
}

/// Adds frames and cameras. A camera that cannot be used is left out, with a finding.
void add_cameras(const SequenceParts& sequence, const std::vector<FramePose>& poses,
                 Contents* contents, Recording* recording) {
  std::vector<TimedImages> cameras;
  std::map<std::string, CameraCalibration> calibrations;
  std::map<std::string, MaskFile> masks;
  for (const Component& sensor : sequence.of_kind("cameras")) try {
      int direction = 0;
      CameraCalibration calibration =
          calibration_of(sequence, sensor, &direction, &recording->findings);
      TimedImages images{sensor.name, 0,
                         contents->add_images(sensor, direction != 0, &calibration.readout_ns,
                                              &recording->damaged)};
      // NCore exposes line v of h at start + v / (h - 1) of the frame's time.
      const int lines = calibration.readout_by_column ? calibration.width : calibration.height;
      calibration.readout_ns = direction * calibration.readout_ns * lines / std::max(1, lines - 1);
      masks[sensor.name] = {};
      try {
        masks[sensor.name] = find_mask(sequence, sensor.name, contents, &recording->findings);
      } catch (const InputError& error) {
        recording->findings.push_back({sensor.name, std::string("mask not used: ") + error.what()});
      }
      calibrations[sensor.name] = calibration;
      cameras.push_back(std::move(images));
    } catch (const InputError& error) {
      recording->findings.push_back({sensor.name, std::string("left out: ") + error.what()});
    }
  add_timed_cameras(poses, sequence.poses.file, {"timestamps_us", "poses"}, std::move(cameras),
                    calibrations, kSameImage_ns, recording);
  for (RecordedCamera& camera : recording->cameras)
    for (ImageFile& image : camera.images) image.mask = masks.at(camera.calibration.name);
}

void add_lidars(const SequenceParts& sequence, Reader* reader, Recording* recording) {
  for (const Component& sensor : sequence.of_kind("lidars")) {
    recording->other_sensors.push_back(sensor.name);
    const auto place = sequence.poses.between(sensor.name, "rig");
    if (!place) {
      recording->findings.push_back(
          {sensor.name, "not used: no fixed poses lead from the LiDAR to the rig"});
      continue;
    }
    std::vector<FrameFile> scans;
    try {
      scans = reader->contents->add_scans(sensor, reader->places.size(), &recording->damaged);
    } catch (const InputError& error) {
      recording->findings.push_back({sensor.name, std::string("left out: ") + error.what()});
      continue;
    }
    if (!scans.empty() && return_count(reader->contents->scan(scans.front().path)) > 1)
      recording->findings.push_back({sensor.name, "of each ray the first return is used"});
    recording->lidars.push_back({sensor.name, *place});
    reader->places.push_back(*place);
    add_timed_scans(std::move(scans), sensor.name, recording);
  }
}

void add_boxes(const SequenceParts& sequence, const std::vector<FramePose>& poses, Reader* reader,
               Recording* recording) {
  std::vector<Finding>* const findings = &recording->findings;
  const auto component = choose(sequence.components, "cuboids", findings);
  if (!component) return;
  std::vector<std::string> impossible;
  std::vector<Cuboid> cuboids;
  try {
    cuboids = read_cuboids(*component, sequence.poses, &impossible);
  } catch (const InputError& error) {
    findings->push_back({"boxes", std::string("none: ") + error.what()});
  }
  if (!impossible.empty())
    findings->push_back({"boxes", counted(impossible.size(), "cuboid") +
                                      " without a size, a place, a time or a name, left out: " +
                                      first_few(impossible, 3)});
  const Rigid3d global_from_world =
      poses.front().global_from_body *
      sequence.poses.world_from_rig.front().global_from_body.inverse(Eigen::Isometry);
  for (Cuboid& cuboid : cuboids) cuboid.world_from_box = global_from_world * cuboid.world_from_box;
  std::set<std::int64_t> with_scan;
  for (const FrameFile& scan : recording->lidar_files) with_scan.insert(scan.frame_id);
  std::vector<FramePose> anchors;
  for (const FramePose& frame : recording->frames)
    if (with_scan.empty() || with_scan.contains(frame.id)) anchors.push_back(frame);
  reader->boxes = boxes_of_frames(cuboids, recording->frames, anchors);
  const fs::path store = component->store->path(),
                 file = is_folder(store) ? component->file("cuboids") : store;
  for (const auto& [frame_id, boxes] : reader->boxes)
    recording->box_files.push_back({frame_id, file});
}

/// Poses in the frame of the Earth where the sequence has its place on it.
std::vector<FramePose> place_on_earth(const Poses& poses, GlobalFrame* frame) {
  std::vector<FramePose> placed = poses.world_from_rig;
  const auto earth = poses.between("world", "world_global");
  const double radius_m = earth ? earth->translation().norm() : 0;
  *frame = GlobalFrame::kArbitrary;
  if (radius_m < kEarth_m || radius_m > kEarthTop_m) return placed;
  *frame = GlobalFrame::kEcef;
  for (FramePose& pose : placed) pose.global_from_body = *earth * pose.global_from_body;
  return placed;
}

void name_unused(const SequenceParts& sequence, std::vector<Finding>* findings) {
  static const std::set<std::string> kUsed = {"poses",   "intrinsics", "masks",
                                              "cameras", "lidars",     "cuboids"};
  for (const auto& [kind, components] : sequence.components)
    if (!kUsed.contains(kind))
      findings->push_back({kind, "not used: " + counted(components.size(), "component")});
}

}  // namespace

bool looks_like(const fs::path& root) {
  std::error_code error;
  fs::directory_iterator it(root, error);
  for (const fs::directory_iterator end; !error && it != end; it.increment(error))
    if (is_store_name(it->path())) return true;
  return false;
}

Recording open(const fs::path& root, PoseSource source) {
  refuse_ground_truth(root, source);
  Recording recording;
  recording.root = root;
  SequenceParts sequence{open_components(&recording), {}, {}, {}};
  const auto require = [&](const char* kind) {
    const auto component = choose(sequence.components, kind, &recording.findings);
    if (!component) throw InputError(root, kind, "", "is missing: no store has this component");
    return *component;
  };
  sequence.poses = read_poses(require("poses"), &recording);
  sequence.intrinsics = require("intrinsics");
  sequence.masks = choose(sequence.components, "masks", &recording.findings);
  const std::vector<FramePose> poses = place_on_earth(sequence.poses, &recording.global_frame);
  const auto reader = std::make_shared<Reader>();
  reader->contents = std::make_shared<Contents>(root);
  mount(root, reader->contents);
  add_cameras(sequence, poses, reader->contents.get(), &recording);
  add_lidars(sequence, reader.get(), &recording);
  add_boxes(sequence, poses, reader.get(), &recording);
  name_unused(sequence, &recording.findings);
  recording.reader = reader;
  return recording;
}

}  // namespace redrive::ncore
