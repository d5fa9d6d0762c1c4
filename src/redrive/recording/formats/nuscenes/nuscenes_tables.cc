// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/nuscenes_tables.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/json_field.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/calibration_fields.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::nuscenes {
namespace {

namespace fs = std::filesystem;

constexpr double kMaxRadius_m = 1e7;
constexpr double kMaxSensorDistance_m = 50;
constexpr double kMinSize_m = 0.01, kMaxSize_m = 100;
constexpr std::int64_t kMaxTime_us = 9'000'000'000'000'000;  // int64 nanoseconds end at 9.22e15 us
constexpr std::int64_t kMinSampleInterval_ns = 100'000'000;  // 2 Hz in the data set
constexpr double kSamePose_m = 0.1;  // difference of two sensors' poses at the same microsecond

Eigen::Vector3d position_from_json(const JsonField& field, double most_m) {
  const std::vector<double> numbers = field.numbers(3);
  const Eigen::Vector3d position(numbers[0], numbers[1], numbers[2]);
  if (!(position.norm() <= most_m)) {
    char rule[80];
    std::snprintf(rule, sizeof rule, "further than %g m from the origin; metres are expected",
                  most_m);
    field.fail(rule);
  }
  return position;
}

/// "translation" in metres and "rotation" as w, x, y, z.
Rigid3d pose_from_json(const JsonField& record, double most_m) {
  const JsonField field = record.at("rotation");
  const std::vector<double> wxyz = field.numbers(4);
  const Eigen::Quaterniond rotation(wxyz[0], wxyz[1], wxyz[2], wxyz[3]);
  if (!is_rotation(rotation)) field.fail("must be a rotation as w, x, y, z, of any length but 0");
  Rigid3d pose(rotation.normalized());
  pose.translation() = position_from_json(record.at("translation"), most_m);
  return pose;
}

std::int64_t t_ns_from_json(const JsonField& field) {
  const std::int64_t t_us = field.integer();
  if (t_us < 0 || t_us > kMaxTime_us) field.fail("expected microseconds since 1970");
  return 1000 * t_us;
}

bool bool_from_json(const JsonField& field) {
  if (!field.json().is_boolean()) field.fail("true or false was expected");
  return field.json().get<bool>();
}

fs::path path_from_json(const JsonField& field, const fs::path& root) {
  const fs::path path = fs::path(field.string()).lexically_normal();
  if (path.empty() || path.is_absolute() || *path.begin() == ".." || !path.has_filename() ||
      path == ".")
    field.fail("must be the name of a file below the folder of the data set");
  return root / path;
}

/// Cameras give their channel to files of the run.
std::string channel_from_json(const JsonField& field) {
  const std::string channel = field.string();
  const auto plain = [](unsigned char c) { return std::isalnum(c) || c == '_' || c == '-'; };
  if (channel.empty() || channel.size() > 128 || !std::ranges::all_of(channel, plain))
    field.fail("a channel is made of letters, digits, '_' and '-'");
  return channel;
}

/// Returns the token of the requested scene. Sets its name.
std::string find_scene(const TokenTables& tables, const std::string& wanted, std::string* name) {
  std::vector<std::string> names;
  std::string token;
  tables.each("scene", [&](const JsonField& record, std::size_t) {
    const std::string here = record.at("name").string();
    names.push_back(here);
    if (wanted.empty() || wanted == here || wanted == record.at("token").string()) {
      if (!token.empty() && !wanted.empty()) record.at("name").fail("a second scene of this name");
      *name = here;
      token = record.at("token").string();
    }
  });
  std::ranges::sort(names);
  constexpr std::size_t kShown = 20;
  if (names.empty()) throw InputError(tables.file("scene"), "", "", "has no scene");
  if (wanted.empty() && names.size() > 1)
    throw InputError(tables.file("scene"), "", "",
                     "has several scenes: add the name of one to the path, as in " +
                         (tables.file("scene").parent_path() / names[0]).string() + "; there are " +
                         first_few(names, kShown));
  if (token.empty())
    throw InputError(tables.file("scene"), "name", wanted,
                     "no such scene; there are " + first_few(names, kShown));
  return token;
}

/// fx, fy, cx and cy of a 3 x 3 matrix; the size of the images comes from their records.
void intrinsics_from_json(const JsonField& field, CameraCalibration* camera) {
  const JsonField top = field.at(std::size_t{0}), middle = field.at(1), bottom = field.at(2);
  const std::vector<double> rows[3] = {top.numbers(3), middle.numbers(3), bottom.numbers(3)};
  if (field.size() != 3 || rows[0][1] != 0 || rows[1][0] != 0 || rows[2][0] != 0 ||
      rows[2][1] != 0 || rows[2][2] != 1)
    field.fail("fx 0 cx, 0 fy cy, 0 0 1 is expected, a pinhole without skew");
  camera->model = "opencv_pinhole";
  camera->parameters = {focal_length_from_json(top.at(std::size_t{0})),
                        focal_length_from_json(middle.at(1)),
                        principal_point_from_json(top.at(2), camera->width),
                        principal_point_from_json(middle.at(2), camera->height),
                        0,
                        0,
                        0,
                        0,
                        0};
}

/// Sensors keyed by the tokens of their calibrations, which are parsed when a file refers to them.
class Sensors {
 public:
  explicit Sensors(const TokenTables& tables) : tables_(tables) {
    tables.each("sensor", [&](const JsonField& record, std::size_t) {
      channels_[record.at("token").string()] = {channel_from_json(record.at("channel")),
                                                record.at("modality").string()};
    });
    tables.each("calibrated_sensor", [&](const JsonField& record, std::size_t index) {
      calibrations_[record.at("token").string()] = {index, record.json()};
    });
  }

  /// Returns the index in `sensors` of the sensor to which a record of sample_data belongs, and
  /// adds it where it is new. InputError if its images have several sizes.
  std::size_t index_of(const JsonField& file, std::vector<Sensor>* sensors) {
    const JsonField token = file.at("calibrated_sensor_token");
    const auto known = known_.find(token.string());
    const std::size_t index = known != known_.end() ? known->second : add(token, file, sensors);
    if (const Sensor& sensor = (*sensors)[index]; sensor.modality == "camera")
      require_size(file, sensor.calibration);
    return index;
  }

 private:
  struct Channel {
    std::string name, modality;
  };
  struct Calibration {
    std::size_t record = 0;
    nlohmann::json json;
  };

  std::size_t add(const JsonField& token, const JsonField& file, std::vector<Sensor>* sensors) {
    const auto found = calibrations_.find(token.string());
    if (found == calibrations_.end())
      token.fail("calibrated_sensor.json has no record of this token");
    nlohmann::json document;
    const std::string name = "record " + std::to_string(found->second.record);
    document[name] = found->second.json;
    const JsonField record = JsonField(document, tables_.file("calibrated_sensor")).at(name);
    const auto channel = channels_.find(record.at("sensor_token").string());
    if (channel == channels_.end())
      record.at("sensor_token").fail("sensor.json has no record of this token");
    Sensor sensor;
    sensor.modality = channel->second.modality;
    CameraCalibration& calibration = sensor.calibration;
    calibration.name = channel->second.name;
    calibration.body_from_sensor = pose_from_json(record, kMaxSensorDistance_m);
    if (sensor.modality == "camera") {
      image_size_from_json(file.at("width"), file.at("height"), &calibration);
      intrinsics_from_json(record.at("camera_intrinsic"), &calibration);
    }
    std::size_t index = 0;
    while (index < sensors->size() && (*sensors)[index].calibration.name != calibration.name)
      ++index;
    if (index == sensors->size()) {
      sensors->push_back(sensor);
    } else if (const CameraCalibration& other = (*sensors)[index].calibration;
               other.parameters != calibration.parameters ||
               !other.body_from_sensor.isApprox(calibration.body_from_sensor, 1e-9)) {
      record.fail("another calibration of " + other.name + " in the same scene");
    }
    known_[token.string()] = index;
    return index;
  }

  static void require_size(const JsonField& file, const CameraCalibration& camera) {
    for (const auto& [key, side] :
         {std::pair("width", camera.width), std::pair("height", camera.height)})
      if (file.at(key).integer() != side)
        file.at(key).fail("other images of " + camera.name + " have " + std::to_string(side));
  }

  const TokenTables& tables_;
  std::map<std::string, Channel> channels_;
  std::map<std::string, Calibration> calibrations_;
  std::map<std::string, std::size_t> known_;
};

/// Reads the poses of the files' times, sorted and each time once.
std::vector<FramePose> read_poses(const TokenTables& tables, const References& references,
                                  const DamagedList& damaged) {
  std::vector<FramePose> poses;
  poses.reserve(references.size());
  references.resolve(
      tables, "ego_pose", [&](const JsonField& record, std::size_t index, std::size_t) {
        parse_record(&damaged, -1, [&] {
          poses.push_back({static_cast<std::int64_t>(index), t_ns_from_json(record.at("timestamp")),
                           pose_from_json(record, kMaxRadius_m)});
        });
      });
  std::ranges::stable_sort(poses, {}, &FramePose::t_ns);
  for (std::size_t i = 1; i < poses.size(); ++i) {
    const double apart_m =
        (poses[i].global_from_body.translation() - poses[i - 1].global_from_body.translation())
            .norm();
    if (poses[i].t_ns == poses[i - 1].t_ns && apart_m > kSamePose_m)
      throw InputError(tables.file("ego_pose"),
                       "record " + std::to_string(poses[i].id) + ".translation",
                       std::to_string(apart_m) + " m",
                       "away from record " + std::to_string(poses[i - 1].id) + " of the same time");
  }
  const auto same_time = [](const FramePose& a, const FramePose& b) { return a.t_ns == b.t_ns; };
  poses.erase(std::unique(poses.begin(), poses.end(), same_time), poses.end());
  if (poses.empty())
    throw InputError(
        tables.file("ego_pose"), "", "",
        "has no pose that can be used" +
            (damaged.records->empty() ? std::string() : ": " + damaged.records->front().why));
  for (std::size_t i = 0; i < poses.size(); ++i) poses[i].id = static_cast<std::int64_t>(i);
  return poses;
}

void read_annotations(const TokenTables& tables, const Tokens& samples, SceneTables* scene) {
  References objects(tables.file("sample_annotation"), "instance_token");
  std::set<std::pair<std::size_t, std::size_t>> seen;
  tables.each_of("sample_annotation", "sample_token", samples,
                 [&](const JsonField& record, std::size_t index, std::size_t sample) {
                   Annotation annotation;
                   annotation.sample = sample;
                   annotation.object = objects.add(record, index);
                   if (!seen.emplace(annotation.object, sample).second)
                     record.at("instance_token").fail("a second box of this object in its sample");
                   annotation.global_from_box = pose_from_json(record, kMaxRadius_m);
                   const JsonField size = record.at("size");
                   const std::vector<double> wlh = size.numbers(3);
                   for (const double side : wlh)
                     if (!(side >= kMinSize_m && side <= kMaxSize_m))
                       size.fail("must be between 0.01 and 100 m");
                   annotation.size_m = {wlh[1], wlh[0], wlh[2]};
                   scene->annotations.push_back(annotation);
                 });
  References categories(tables.file("instance"), "category_token");
  std::vector<std::size_t> category_of(objects.size());
  objects.resolve(tables, "instance",
                  [&](const JsonField& record, std::size_t index, std::size_t number) {
                    category_of[number] = categories.add(record, index);
                  });
  std::vector<std::string> names(categories.size());
  categories.resolve(tables, "category",
                     [&](const JsonField& record, std::size_t, std::size_t number) {
                       names[number] = record.at("name").string();
                     });
  for (const std::size_t category : category_of) scene->categories.push_back(names[category]);
}

void check_sample_times(std::vector<std::int64_t> times_ns, const fs::path& file) {
  std::ranges::sort(times_ns);
  for (std::size_t i = 1; i < times_ns.size(); ++i)
    if (times_ns[i] - times_ns[i - 1] < kMinSampleInterval_ns)
      throw InputError(file, "timestamp", std::to_string(times_ns[i] / 1000),
                       "is less than 0.1 s after that of another sample of the scene");
}

}  // namespace

SceneTables read_scene(const fs::path& folder, const std::string& wanted, const ReadTable& read,
                       bool boxes) {
  const TokenTables tables(folder, read);
  SceneTables scene;
  const Tokens scenes = {{find_scene(tables, wanted, &scene.name), 0}};
  Tokens samples;
  tables.each_of("sample", "scene_token", scenes,
                 [&](const JsonField& record, std::size_t, std::size_t) {
                   const JsonField token = record.at("token");
                   if (!samples.emplace(token.string(), samples.size()).second)
                     token.fail("a second record of this token");
                   scene.sample_times_ns.push_back(t_ns_from_json(record.at("timestamp")));
                 });
  if (samples.empty()) throw InputError(tables.file("sample"), "", "", "has none of " + scene.name);
  check_sample_times(scene.sample_times_ns, tables.file("sample"));

  Sensors sensors(tables);
  References poses(tables.file("sample_data"), "ego_pose_token");
  tables.each_of("sample_data", "sample_token", samples,
                 [&](const JsonField& record, std::size_t index, std::size_t sample) {
                   SensorFile file;
                   file.sensor = sensors.index_of(record, &scene.sensors);
                   const Sensor& sensor = scene.sensors[file.sensor];
                   if (sensor.modality != "camera" && sensor.calibration.name != "LIDAR_TOP")
                     return;
                   file.sample = sample;
                   file.path = path_from_json(record.at("filename"), folder.parent_path());
                   const DamagedList damaged{"times of " + sensor.calibration.name, &scene.damaged};
                   if (!parse_record(&damaged, -1,
                                     [&] { file.t_ns = t_ns_from_json(record.at("timestamp")); }))
                     return;
                   file.key_frame = bool_from_json(record.at("is_key_frame"));
                   poses.add(record, index);
                   scene.files.push_back(std::move(file));
                 });
  if (scene.files.empty())
    throw InputError(tables.file("sample_data"), "", "",
                     "has no file of a camera or of LIDAR_TOP of " + scene.name +
                         (scene.damaged.empty() ? "" : " with a time: " + scene.damaged[0].why));
  std::ranges::stable_sort(scene.files, {}, &SensorFile::t_ns);
  scene.poses = read_poses(tables, poses, DamagedList{"poses", &scene.damaged});
  if (boxes) read_annotations(tables, samples, &scene);
  return scene;
}

}  // namespace redrive::nuscenes
