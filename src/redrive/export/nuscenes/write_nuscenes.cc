// SPDX-License-Identifier: Apache-2.0
// Tables: docs/schema_nuscenes.md of nutonomy/nuscenes-devkit.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <map>
#include <set>
#include <tuple>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/export/compensated_scans.h"
#include "redrive/export/drive.h"
#include "redrive/export/nuscenes/nuscenes_terms.h"
#include "redrive/export/write_photo_set.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/nuscenes/nuscenes_scan.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr const char* kVersion = "v1.0-redrive";
constexpr const char* kLidarTop = "LIDAR_TOP";
constexpr std::int64_t kSample_ns = 500'000'000, kSameSample_ns = 100'000'000;

/// 32 hexadecimal digits, as tokens of the data set have: the table and the number of the record.
std::string token(int table, std::size_t n) {
  char text[40];
  std::snprintf(text, sizeof text, "%08x%024zx", table, n);
  return text;
}
enum Table {
  kCategory = 1,
  kAttribute,
  kVisibility,
  kInstance,
  kSensor,
  kCalibrated,
  kEgoPose,
  kLog,
  kScene,
  kSample,
  kSampleData,
  kAnnotation,
  kMap
};

Json rotation_json(const Rigid3d& pose) {
  const Eigen::Quaterniond q(pose.linear());
  return {q.w(), q.x(), q.y(), q.z()};
}

/// Returns the axes of LIDAR_TOP, x right, y forward, z up.
Rigid3d body_from_lidar_top(const Recording& drive) {
  Rigid3d forward_from_file = Rigid3d::Identity();
  forward_from_file.linear() << 0, 1, 0, -1, 0, 0, 0, 0, 1;
  return spinning_axes(drive.lidars[0].body_from_lidar) * forward_from_file;
}

/// Writes the file of a scan, compensated for the motion until `end_ns`. Returns what lies in the
/// boxes.
std::vector<ObjectReturns> write_scan(const fs::path& file, const Recording& drive,
                                      const ScanOfDrive& scan, std::int64_t end_ns,
                                      float full_scale, const std::vector<Box>& boxes) {
  std::vector<LidarPoint> points = new_points(drive, scan.file, scan.before);
  std::ranges::stable_sort(
      points, {}, [](const LidarPoint& point) { return std::tuple(point.t_ns, point.ring); });
  const Rigid3d global_from_lidar =
                    pose_at(drive.frames, end_ns) * spinning_axes(drive.lidars[0].body_from_lidar),
                lidar_from_global = global_from_lidar.inverse(Eigen::Isometry);
  ReturnsOnObjects on_objects(boxes, drive.frames, lidar_from_global);
  std::vector<LidarRecord> records;
  for_each_in_global(
      points, drive.frames, [&](const Eigen::Vector3d& in_global, const LidarPoint& point) {
        LidarRecord record{lidar_from_global * in_global, point.t_ns,
                           std::min(1.0f, static_cast<float>(point.intensity) / full_scale)};
        record.ring = point.ring;
        records.push_back(record);
        on_objects.count(in_global, point.t_ns);
      });
  write_file(file, nuscenes::make_scan(records));
  return on_objects.returns();
}

/// A file of a sensor.
struct SensorFile {
  std::int64_t t_us = 0;
  std::size_t sensor = 0;  ///< index into SceneWriter::channels_
  std::size_t index = 0;   ///< among the camera's images or the scans
  std::size_t sample = 0;
  bool key_frame = false;
  std::string path = {};
};

class SceneWriter {
 public:
  SceneWriter(const fs::path& folder, const Recording& drive, ThreadPool& pool,
              const std::atomic<bool>& stop, DriveNotes* notes)
      : folder_(folder),
        drive_(drive),
        pool_(pool),
        stop_(stop),
        notes_(*notes),
        world_from_global_(local_from_global(drive)) {
    note_world(drive, "map", notes);
    later_ns_ = added_to_times_ns(drive, notes);
    const fs::path root = fs::absolute(drive.root).lexically_normal();
    name_ = (root.has_filename() ? root : root.parent_path()).filename().string();
    std::ranges::replace_if(
        name_, [](unsigned char c) { return !std::isalnum(c) && c != '-' && c != '_'; }, '_');
    if (name_.empty()) name_ = "drive";
  }

  void write() {
    list_files();
    assign_samples();
    write_pictures();
    write_scans();
    write_tables();
  }

 private:
  std::int64_t us(std::int64_t t_ns) const { return (t_ns + later_ns_ + 500) / 1000; }
  std::int64_t ns(std::int64_t t_us) const { return 1000 * t_us - later_ns_; }
  bool is_camera(std::size_t sensor) const { return sensor < drive_.cameras.size(); }

  void list_files() {
    channels_ = nuscenes::channels_of(drive_.cameras);
    for (std::size_t c = 0; c < drive_.cameras.size(); ++c) {
      const RecordedCamera& camera = drive_.cameras[c];
      if (channels_[c] != camera.calibration.name)
        notes_.changed.push_back(camera.calibration.name + " is " + channels_[c]);
      for (std::size_t i = 0; i < camera.images.size(); ++i) {
        const auto frame =
            std::ranges::lower_bound(drive_.frames, camera.images[i].frame_id, {}, &FramePose::id);
        files_.push_back({us(frame->t_ns + camera.calibration.time_offset_ns), c, i});
      }
    }
    if (!drive_.lidars.empty() && !drive_.lidar_files.empty()) {
      scan_files_ = drive_.scans_of(0);
      scans_ = list_scans(drive_, scan_files_, pool_, stop_, &notes_);
    }
    if (!scans_.empty()) channels_.emplace_back(kLidarTop);
    for (std::size_t i = 0; i < scans_.size(); ++i)
      files_.push_back({us(scans_[i].last_ns), drive_.cameras.size(), i});
    std::ranges::stable_sort(files_, {}, &SensorFile::t_us);
  }

  /// A sample begins twice a second at a file of the last sensor, LIDAR_TOP where there is one. The
  /// file of each sensor that is nearest to it is a key frame; others belong to the sample after
  /// them.
  void assign_samples() {
    const std::size_t anchor = channels_.size() - 1;
    for (const SensorFile& file : files_)
      if (file.sensor == anchor &&
          (sample_us_.empty() || file.t_us - sample_us_.back() > kSample_ns / 1000 - kHalfFrame_us))
        sample_us_.push_back(file.t_us);
    std::map<std::pair<std::size_t, std::size_t>, std::size_t> nearest;  // key: sensor, sample
    for (std::size_t f = 0; f < files_.size(); ++f) {
      SensorFile& file = files_[f];
      const auto after = std::ranges::lower_bound(sample_us_, file.t_us);
      std::size_t best = static_cast<std::size_t>(after - sample_us_.begin());
      file.sample = std::min(best, sample_us_.size() - 1);
      if (best == sample_us_.size() ||
          (best > 0 && file.t_us - sample_us_[best - 1] < sample_us_[best] - file.t_us))
        --best;
      const auto off_us = [&](std::size_t i) {
        return std::abs(files_[i].t_us - sample_us_[best]);
      };
      if (off_us(f) > kSameSample_ns / 1000) continue;
      const auto [at, is_new] = nearest.emplace(std::pair(file.sensor, best), f);
      if (!is_new && off_us(f) < off_us(at->second)) at->second = f;
    }
    for (const auto& [of, f] : nearest) {
      files_[f].key_frame = true;
      files_[f].sample = of.second;
    }
    for (std::size_t sensor = 0; sensor < channels_.size(); ++sensor) {
      std::size_t without = 0;
      for (std::size_t s = 0; s < sample_us_.size(); ++s) without += !nearest.contains({sensor, s});
      if (without > 0)
        notes_.left_out.push_back(counted(without, "sample") + " without a file of " +
                                  channels_[sensor] + " within 0.1 s");
    }
  }

  /// Sets the file's path below the folder. `extension`: ".jpg"
  void set_path(const std::string& extension, SensorFile* of) const {
    const SensorFile& file = *of;
    const std::string& channel = channels_[file.sensor];
    of->path = (file.key_frame ? "samples/" : "sweeps/") + channel + "/" + name_ + "__" + channel +
               "__" + std::to_string(file.t_us) + extension;
  }

  void write_pictures() {
    PhotoSet photos;
    for (const RecordedCamera& camera : drive_.cameras)
      add_pinhole(camera.calibration, &photos, &notes_);
    for (SensorFile& file : files_)
      if (is_camera(file.sensor)) {
        const ImageFile& image = drive_.cameras[file.sensor].images[file.index];
        const bool kept = !photos.cameras[file.sensor].resampled &&
                          has_extension(image.path, {".jpg", ".jpeg", ".png"});
        set_path(kept ? image.path.extension().string() : ".png", &file);
        photos.photos.push_back(
            {file.path, image.path, static_cast<int>(file.sensor), Rigid3d::Identity(), {}, false});
      }
    for (const PhotoCamera& camera : photos.cameras) pinholes_.push_back(camera.calibration);
    write_drive_images(folder_, {}, photos, pool_, stop_, &notes_);
  }

  void write_scans() {
    boxes_.resize(sample_us_.size());
    returns_.resize(sample_us_.size());
    for (std::size_t s = 0; s < sample_us_.size(); ++s) {
      boxes_[s] = boxes_near(drive_, ns(sample_us_[s]));
      for (std::size_t b = 0; b < boxes_[s].size(); ++b)
        returns_[s].push_back({0, ns(sample_us_[s])});
    }
    if (scans_.empty()) return;
    for (const char* below : {"samples", "sweeps"}) make_folders(folder_ / below / kLidarTop);
    const float full_scale = full_scale_of(scans_);
    std::vector<const SensorFile*> files;
    for (SensorFile& file : files_)
      if (!is_camera(file.sensor)) {
        set_path(".pcd.bin", &file);
        files.push_back(&file);
      }
    Progress progress("writing LiDAR", std::ssize(files));
    pool_.run(static_cast<int>(files.size()), [&](int i) {
      if (stop_) throw Interrupted();
      const SensorFile& file = *files[static_cast<std::size_t>(i)];
      const std::vector<Box> none;
      auto returns = write_scan(folder_ / file.path, drive_, scans_[file.index], ns(file.t_us),
                                full_scale, file.key_frame ? boxes_[file.sample] : none);
      if (file.key_frame) returns_[file.sample] = std::move(returns);
      progress.count();
    });
  }

  Json with_pose(const Rigid3d& pose) const {
    return {{"rotation", rotation_json(pose)}, {"translation", vector_to_json(pose.translation())}};
  }

  /// Chains records by "prev" and "next".
  static void chain(const std::vector<std::size_t>& indices, Json* records) {
    for (std::size_t i = 0; i < indices.size(); ++i) {
      const auto token_at = [&](std::size_t k) { return (*records)[indices[k]]["token"]; };
      (*records)[indices[i]]["prev"] = i == 0 ? Json("") : token_at(i - 1);
      (*records)[indices[i]]["next"] = i + 1 == indices.size() ? Json("") : token_at(i + 1);
    }
  }

  void write_table(const char* name, const Json& records) const {
    write_file(folder_ / kVersion / (std::string(name) + ".json"), records.dump(1) + "\n");
  }

  void write_sensors() const {
    Json sensors = Json::array(), calibrated = Json::array();
    for (std::size_t s = 0; s < channels_.size(); ++s) {
      sensors.push_back({{"token", token(kSensor, s)},
                         {"channel", channels_[s]},
                         {"modality", is_camera(s) ? "camera" : "lidar"}});
      const Rigid3d place = is_camera(s) ? drive_.cameras[s].calibration.body_from_sensor
                                         : body_from_lidar_top(drive_);
      Json record = {{"token", token(kCalibrated, s)}, {"sensor_token", token(kSensor, s)}};
      record.update(with_pose(place));
      record["camera_intrinsic"] = Json::array();
      if (is_camera(s)) {
        const CameraCalibration& k = pinholes_[s];
        record["camera_intrinsic"] = {{k.fx(), 0, k.cx()}, {0, k.fy(), k.cy()}, {0, 0, 1}};
      }
      calibrated.push_back(std::move(record));
    }
    write_table("sensor", sensors);
    write_table("calibrated_sensor", calibrated);
  }

  void write_files() const {
    Json data = Json::array(), poses = Json::array();
    std::vector<std::vector<std::size_t>> of_sensor(channels_.size());
    for (std::size_t f = 0; f < files_.size(); ++f) {
      const SensorFile& file = files_[f];
      const bool camera = is_camera(file.sensor);
      data.push_back(
          {{"token", token(kSampleData, f)},
           {"sample_token", token(kSample, file.sample)},
           {"ego_pose_token", token(kEgoPose, f)},
           {"calibrated_sensor_token", token(kCalibrated, file.sensor)},
           {"timestamp", file.t_us},
           {"fileformat", camera ? fs::path(file.path).extension().string().substr(1) : "pcd"},
           {"is_key_frame", file.key_frame},
           {"height", camera ? pinholes_[file.sensor].height : 0},
           {"width", camera ? pinholes_[file.sensor].width : 0},
           {"filename", file.path}});
      of_sensor[file.sensor].push_back(f);
      Json pose = {{"token", token(kEgoPose, f)}, {"timestamp", file.t_us}};
      pose.update(with_pose(world_from_global_ * pose_at(drive_.frames, ns(file.t_us))));
      poses.push_back(std::move(pose));
    }
    for (const std::vector<std::size_t>& of : of_sensor) chain(of, &data);
    write_table("sample_data", data);
    write_table("ego_pose", poses);
  }

  void write_samples() const {
    Json samples = Json::array();
    std::vector<std::size_t> all;
    for (std::size_t s = 0; s < sample_us_.size(); ++s) {
      samples.push_back({{"token", token(kSample, s)},
                         {"timestamp", sample_us_[s]},
                         {"scene_token", token(kScene, 0)}});
      all.push_back(s);
    }
    chain(all, &samples);
    write_table("sample", samples);
    write_table("scene", {{{"token", token(kScene, 0)},
                           {"log_token", token(kLog, 0)},
                           {"nbr_samples", sample_us_.size()},
                           {"first_sample_token", token(kSample, 0)},
                           {"last_sample_token", token(kSample, sample_us_.size() - 1)},
                           {"name", name_},
                           {"description", "written by redrive"}}});
  }

  void write_log() const {
    const std::chrono::sys_time<std::chrono::nanoseconds> time{
        std::chrono::nanoseconds(drive_.frames.front().t_ns + later_ns_)};
    const std::chrono::year_month_day date(std::chrono::floor<std::chrono::days>(time));
    char day[40];
    std::snprintf(day, sizeof day, "%04d-%02u-%02u", int(date.year()), unsigned(date.month()),
                  unsigned(date.day()));
    write_table("log", {{{"token", token(kLog, 0)},
                         {"logfile", ""},
                         {"vehicle", "redrive"},
                         {"date_captured", day},
                         {"location", "unknown"}}});
    // The devkit wants a map of each log: an empty one.
    const std::string map = "maps/" + token(kMap, 0) + ".png";
    make_folders(folder_ / "maps");
    constexpr int kSide = 10;
    write_image(folder_ / map, Image8{kSide, kSide, std::vector<std::uint8_t>(3 * kSide * kSide)});
    write_table("map", {{{"token", token(kMap, 0)},
                         {"category", "semantic_prior"},
                         {"filename", map},
                         {"log_tokens", {token(kLog, 0)}}}});
  }

  void write_visibility() {
    Json visibility = Json::array();
    for (const auto& [number, level] : {std::pair("1", "v0-40"), std::pair("2", "v40-60"),
                                        std::pair("3", "v60-80"), std::pair("4", "v80-100")})
      visibility.push_back({{"token", number},
                            {"level", level},
                            {"description", std::string("visible part in percent: ") + level}});
    write_table("visibility", visibility);
  }

  void write_objects() {
    std::map<std::string, std::size_t> category_index, attribute_index;
    Json categories = Json::array(), attributes = Json::array();
    const auto category = [&](const std::string& name, const std::string& description) {
      const auto [at, is_new] = category_index.emplace(name, category_index.size());
      if (is_new)
        categories.push_back({{"token", token(kCategory, at->second)},
                              {"name", name},
                              {"description", description}});
      return token(kCategory, at->second);
    };
    for (const nuscenes::Term& term : nuscenes::categories()) category(term.name, term.description);
    for (const nuscenes::Term& term : nuscenes::attributes()) {
      attribute_index[term.name] = attributes.size();
      attributes.push_back({{"token", token(kAttribute, attributes.size())},
                            {"name", term.name},
                            {"description", term.description}});
    }

    Json annotations = Json::array(), instances = Json::array();
    std::map<std::int64_t, std::vector<std::size_t>> of_object;
    std::map<std::int64_t, std::string> types;
    std::set<std::string> renamed;
    constexpr double kMoves_m_per_s = 0.5;
    for (std::size_t s = 0; s < boxes_.size(); ++s)
      for (std::size_t b = 0; b < boxes_[s].size(); ++b) {
        const Box& box = boxes_[s][b];
        const ObjectReturns& returns = returns_[s][b];
        const std::string name = nuscenes::category_of(box.type);
        const std::string attribute = nuscenes::moving_attribute(name);
        const std::size_t n = annotations.size();
        Json record = {{"token", token(kAnnotation, n)},
                       {"sample_token", token(kSample, s)},
                       {"instance_token", ""},
                       {"visibility_token", "4"},
                       {"attribute_tokens", Json::array()}};
        if (!attribute.empty() && velocity_in_global(box, drive_.frames).norm() > kMoves_m_per_s)
          record["attribute_tokens"].push_back(token(kAttribute, attribute_index.at(attribute)));
        // Boxes fit the returns, as the data set's do.
        record.update(
            with_pose(world_from_global_ * global_from_box_at(box, drive_.frames, returns.t_ns)));
        record["size"] = {box.size_m.y(), box.size_m.x(), box.size_m.z()};
        record["num_lidar_pts"] = returns.n;
        record["num_radar_pts"] = 0;
        annotations.push_back(std::move(record));
        of_object[box.object_id].push_back(n);
        types.emplace(box.object_id, name);
        if (name != box.type) renamed.insert(box.type + " is " + name);
      }
    for (const auto& [object, indices] : of_object) {
      const std::string own = token(kInstance, instances.size());
      for (const std::size_t i : indices) annotations[i]["instance_token"] = own;
      instances.push_back({{"token", own},
                           {"category_token", category(types.at(object), "")},
                           {"nbr_annotations", indices.size()},
                           {"first_annotation_token", annotations[indices.front()]["token"]},
                           {"last_annotation_token", annotations[indices.back()]["token"]}});
      chain(indices, &annotations);
    }
    write_table("category", categories);
    write_table("attribute", attributes);
    write_visibility();
    write_table("instance", instances);
    write_table("sample_annotation", annotations);
    if (!renamed.empty())
      notes_.changed.push_back("categories of boxes: " +
                               first_few(std::vector<std::string>(renamed.begin(), renamed.end())));
    if (!annotations.empty())
      notes_.changed.emplace_back(
          "boxes are written twice a second, all as visible; their velocities follow from them");
    const auto without = static_cast<std::size_t>(
        std::ranges::count_if(boxes_, [](const auto& boxes) { return boxes.empty(); }));
    if (!drive_.box_files.empty() && without > 0)
      notes_.left_out.push_back(counted(without, "sample") + " without boxes within 0.3 s");
    std::vector<std::string> others;
    for (const auto& [name, index] : category_index)
      if (index >= nuscenes::categories().size()) others.push_back(name);
    if (!others.empty())
      notes_.changed.push_back("categories that nuScenes lacks: " + first_few(others));
  }

  void write_tables() {
    make_folders(folder_ / kVersion);
    write_sensors();
    write_files();
    write_samples();
    write_log();
    write_objects();
  }

  static constexpr std::int64_t kHalfFrame_us = 25'000;

  const fs::path& folder_;
  const Recording& drive_;
  ThreadPool& pool_;
  const std::atomic<bool>& stop_;
  DriveNotes& notes_;
  Rigid3d world_from_global_;
  std::int64_t later_ns_ = 0;
  std::string name_;
  std::vector<std::string> channels_;  ///< cameras first, then LIDAR_TOP
  std::vector<FrameFile> scan_files_;
  std::vector<ScanOfDrive> scans_;
  std::vector<SensorFile> files_;  ///< in order of time
  std::vector<std::int64_t> sample_us_;
  std::vector<CameraCalibration> pinholes_;
  std::vector<std::vector<Box>> boxes_;              ///< keyed by sample
  std::vector<std::vector<ObjectReturns>> returns_;  ///< keyed by sample, then box
};

}  // namespace

DriveNotes write_nuscenes(const fs::path& folder, const Recording& drive, ThreadPool& pool,
                          const std::atomic<bool>& stop) {
  DriveNotes notes;
  SceneWriter(folder, drive, pool, stop, &notes).write();
  note_left_out(drive, &notes);
  if (!drive.points_file.empty()) notes.left_out.emplace_back("the static point cloud");
  return notes;
}

}  // namespace redrive
