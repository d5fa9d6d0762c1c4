// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <set>
#include <vector>

#include <yaml-cpp/yaml.h>

#include "redrive/base/error.h"
#include "redrive/camera/models.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/formats/rosbag/rig.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::rosbag {
namespace {

struct Unit {
  const char* name;
  double seconds;
};
constexpr Unit kUnits[] = {{"s", 1}, {"ms", 1e-3}, {"us", 1e-6}, {"ns", 1e-9}};

/// A map of rig.yaml whose keys are all known.
class RigFields {
 public:
  RigFields(const YAML::Node& node, std::string name, const std::filesystem::path& file,
            const std::vector<std::string_view>& keys)
      : node_(node), name_(std::move(name)), file_(file) {
    if (!node.IsMap()) fail("", "", "is a map");
    for (const auto& entry : node) {
      const auto key = entry.first.as<std::string>();
      if (keys.size() > 0 && std::ranges::find(keys, key) == keys.end()) {
        std::string known;
        for (const std::string_view one : keys)
          known += (known.empty() ? "" : ", ") + std::string(one);
        fail(key, "", "is not known; known are " + known);
      }
    }
  }

  bool has(const char* key) const { return node_[key] && !node_[key].IsNull(); }
  std::string text(const char* key, const std::string& otherwise) const {
    return has(key) ? as<std::string>(key, "a text") : otherwise;
  }
  std::string required(const char* key) const {
    const std::string value = text(key, "");
    if (value.empty()) fail(key, "", "is missing");
    return value;
  }
  double number(const char* key, double least, double most, double otherwise) const {
    const double value = has(key) ? as<double>(key, "a number") : otherwise;
    if (!(value >= least && value <= most))
      fail(key, std::to_string(value),
           "is " + std::to_string(least) + " to " + std::to_string(most));
    return value;
  }
  bool flag(const char* key, bool otherwise) const {
    return has(key) ? as<bool>(key, "true or false") : otherwise;
  }
  std::vector<double> numbers(const char* key) const {
    return as<std::vector<double>>(key, "a list of numbers");
  }
  template <class T>
  T as(const char* key, const char* rule) const {
    try {
      return node_[key].as<T>();
    } catch (const YAML::Exception&) {
      fail(key, "", "is " + std::string(rule));
    }
  }
  [[noreturn]] void fail(const std::string& key, const std::string& value,
                         const std::string& rule) const {
    throw InputError(file_, name_ + (name_.empty() || key.empty() ? "" : ".") + key, value, rule);
  }
  RigFields child(const char* key, const std::vector<std::string_view>& keys) const {
    if (!has(key)) fail(key, "", "is missing");
    return {node_[key], name_ + (name_.empty() ? "" : ".") + key, file_, keys};
  }
  YAML::Node node(const char* key) const { return node_[key]; }

 private:
  YAML::Node node_;
  std::string name_;
  const std::filesystem::path& file_;
};

Place place_from(const RigFields& fields) {
  Place place{fields.text("frame", ""), std::nullopt};
  if (!fields.has("body_from_sensor")) return place;
  const RigFields pose = fields.child("body_from_sensor", {"xyz", "xyzw"});
  const std::vector<double> xyz = pose.numbers("xyz"), xyzw = pose.numbers("xyzw");
  if (xyz.size() != 3 || xyzw.size() != 4)
    pose.fail("xyz, xyzw", "", "are three numbers in metres and a quaternion of four");
  const Eigen::Quaterniond q(xyzw[3], xyzw[0], xyzw[1], xyzw[2]);
  const Eigen::Vector3d at(xyz[0], xyz[1], xyz[2]);
  constexpr double kMost_m = 100;
  if (!is_rotation(q)) pose.fail("xyzw", "", "is a quaternion");
  if (!(at.norm() <= kMost_m)) pose.fail("xyz", std::to_string(at.norm()), "is at most 100 m");
  place.body_from_sensor = Rigid3d(Eigen::Translation3d(at) * q.normalized());
  return place;
}

CameraCalibration intrinsics_from(const RigFields& fields) {
  CameraCalibration camera;
  camera.model = fields.required("model");
  const CameraModelInfo* const model = find_camera_model(camera.model);
  if (!model) fields.fail("model", camera.model, "is one of " + camera_model_names());
  camera.width = static_cast<int>(fields.number("width", 1, kMaxImageSize_px, 0));
  camera.height = static_cast<int>(fields.number("height", 1, kMaxImageSize_px, 0));
  camera.parameters = fields.numbers("parameters");
  constexpr std::size_t kFocalAndCentre = 4;
  const std::size_t n = kFocalAndCentre + model->distortion.size() + model->other.size();
  if (camera.parameters.size() != n)
    fields.fail("parameters", std::to_string(camera.parameters.size()) + " numbers",
                "fx, fy, cx, cy and those of the model are " + std::to_string(n));
  return camera;
}

void emit(YAML::Emitter* out, const char* key, const std::string& value) {
  *out << YAML::Key << key << YAML::Value << value;
}

void emit_cameras(const Rig& rig, YAML::Emitter* out) {
  *out << YAML::Key << "cameras" << YAML::Value << YAML::BeginMap;
  for (const CameraTopics& camera : rig.cameras) {
    *out << YAML::Key << camera.name << YAML::Value << YAML::BeginMap;
    emit(out, "image", camera.image);
    emit(out, "info", camera.info);
    emit(out, "frame", camera.place.frame);
    *out << YAML::Key << "optical" << YAML::Value << camera.optical << YAML::Key << "rectified"
         << YAML::Value << camera.rectified << YAML::Key << "readout_s" << YAML::Value
         << camera.readout_s << YAML::EndMap;
  }
  *out << YAML::EndMap << YAML::Newline;
}

void emit_lidars(const Rig& rig, YAML::Emitter* out) {
  *out << YAML::Key << "lidars" << YAML::Value << YAML::BeginMap;
  for (const LidarTopics& lidar : rig.lidars) {
    *out << YAML::Key << lidar.name << YAML::Value << YAML::BeginMap;
    emit(out, "topic", lidar.topic);
    emit(out, "frame", lidar.place.frame);
    emit(out, "time", lidar.scan.time);
    const auto unit = std::ranges::find(kUnits, lidar.scan.time_unit_s, &Unit::seconds);
    emit(out, "time_unit", unit == std::end(kUnits) ? "s" : unit->name);
    *out << YAML::Key << "since_epoch" << YAML::Value << lidar.scan.since_epoch;
    emit(out, "intensity", lidar.scan.intensity);
    *out << YAML::Key << "intensity_full" << YAML::Value << lidar.scan.intensity_full;
    emit(out, "ring", lidar.scan.ring);
    *out << YAML::EndMap;
  }
  *out << YAML::EndMap << YAML::Newline;
}

LidarTopics lidar_from(const RigFields& fields, const std::string& name) {
  LidarTopics lidar{name, fields.required("topic"), place_from(fields), {}};
  lidar.scan.time = fields.text("time", "");
  const std::string unit = fields.text("time_unit", "s");
  const auto known = std::ranges::find(kUnits, unit, &Unit::name);
  if (known == std::end(kUnits)) fields.fail("time_unit", unit, "is s, ms, us or ns");
  lidar.scan.time_unit_s = known->seconds;
  lidar.scan.since_epoch = fields.flag("since_epoch", false);
  lidar.scan.intensity = fields.text("intensity", "");
  lidar.scan.intensity_full = fields.number("intensity_full", 1e-6, 1e9, 255);
  lidar.scan.ring = fields.text("ring", "");
  return lidar;
}

const std::vector<std::string_view> kCameraKeys = {"image",     "info",
                                                   "frame",     "body_from_sensor",
                                                   "optical",   "rectified",
                                                   "readout_s", "intrinsics"},
                                    kLidarKeys = {"topic",     "frame",          "body_from_sensor",
                                                  "time",      "time_unit",      "since_epoch",
                                                  "intensity", "intensity_full", "ring"};

/// Calls `use(name, fields)` for the sensors of "cameras" or "lidars".
template <class Use>
void each_sensor(const RigFields& all, const char* key, const std::filesystem::path& file,
                 const std::vector<std::string_view>& keys, const Use& use) {
  const RigFields sensors = all.child(key, {});
  for (const auto& entry : all.node(key)) {
    const auto name = entry.first.as<std::string>();
    if (name.empty() || name.find('/') != name.npos || name.starts_with('.'))
      sensors.fail(name, "", "is a name without /");
    use(name, RigFields(entry.second, std::string(key) + "." + name, file, keys));
  }
}

}  // namespace

std::string rig_text(const Proposal& proposal) {
  const Rig& rig = proposal.rig;
  YAML::Emitter out;
  out << YAML::Comment("Which topics of this bag are which sensors: docs/recordings.md.")
      << YAML::Newline;
  for (const std::string& question : proposal.questions)
    out << YAML::Comment("TO DECIDE: " + question) << YAML::Newline;
  out << YAML::BeginMap << YAML::Key << "time" << YAML::Value
      << (rig.clock == Clock::kHeader ? "header" : "log")
      << YAML::Comment("header: stamps of messages; log: when they were recorded") << YAML::Newline
      << YAML::Key << "body" << YAML::Value << YAML::BeginMap;
  emit(&out, "frame", rig.body);
  out << YAML::Comment("x forward, y left, z up") << YAML::Key << "above_ground_m" << YAML::Value
      << rig.above_ground_m << YAML::Comment("height of its origin") << YAML::EndMap
      << YAML::Newline << YAML::Key << "poses" << YAML::Value << YAML::BeginMap;
  emit(&out, "topic", rig.poses);
  emit(&out, "world", rig.world);
  out << YAML::Comment("tf: the frame above the body");
  emit(&out, "imu", rig.imu);
  out << YAML::Comment("NavSatFix: the topic with the orientation") << YAML::EndMap
      << YAML::Newline;
  emit_cameras(rig, &out);
  if (!rig.lidars.empty()) emit_lidars(rig, &out);
  out << YAML::EndMap;
  return std::string(out.c_str()) + "\n";
}

Rig parse_rig(std::string_view text, const std::filesystem::path& file) try {
  const RigFields all(YAML::Load(std::string(text)), "", file,
                      {"time", "body", "poses", "cameras", "lidars", "lidar"});
  Rig rig;
  const std::string clock = all.text("time", "header");
  if (clock != "header" && clock != "log") all.fail("time", clock, "is header or log");
  rig.clock = clock == "log" ? Clock::kLog : Clock::kHeader;
  if (all.has("body")) {
    const RigFields body = all.child("body", {"frame", "above_ground_m"});
    rig.body = body.text("frame", rig.body);
    rig.above_ground_m = body.number("above_ground_m", -10, 10, 0);
  }
  const RigFields poses = all.child("poses", {"topic", "world", "imu"});
  rig.poses = poses.required("topic");
  rig.world = poses.text("world", "");
  rig.imu = poses.text("imu", "");
  each_sensor(all, "cameras", file, kCameraKeys,
              [&](const std::string& name, const RigFields& fields) {
                CameraTopics camera{.name = name,
                                    .image = fields.required("image"),
                                    .info = fields.text("info", ""),
                                    .place = place_from(fields)};
                camera.optical = fields.flag("optical", true);
                camera.rectified = fields.flag("rectified", false);
                camera.readout_s = fields.number("readout_s", -kMaxReadout_s, kMaxReadout_s, 0);
                if (fields.has("intrinsics"))
                  camera.intrinsics = intrinsics_from(
                      fields.child("intrinsics", {"model", "width", "height", "parameters"}));
                else if (camera.info.empty())
                  fields.fail("info", "", "is missing, and so are intrinsics");
                rig.cameras.push_back(std::move(camera));
              });
  if (rig.cameras.empty()) all.fail("cameras", "", "has none");
  if (all.has("lidar")) rig.lidars.push_back(lidar_from(all.child("lidar", kLidarKeys), "lidar"));
  if (all.has("lidars"))
    each_sensor(all, "lidars", file, kLidarKeys,
                [&](const std::string& name, const RigFields& fields) {
                  rig.lidars.push_back(lidar_from(fields, name));
                });
  for (auto lidar = rig.lidars.begin(); lidar != rig.lidars.end(); ++lidar)
    if (std::ranges::find(rig.cameras, lidar->name, &CameraTopics::name) != rig.cameras.end() ||
        std::ranges::find(rig.lidars.begin(), lidar, lidar->name, &LidarTopics::name) != lidar)
      all.fail("lidars." + lidar->name, "", "is the name of another sensor, too");
  return rig;
} catch (const YAML::Exception& error) {
  throw InputError(file, "", "", "not usable YAML: " + std::string(error.what()));
}

}  // namespace redrive::rosbag
