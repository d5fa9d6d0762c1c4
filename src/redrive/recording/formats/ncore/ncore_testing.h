// SPDX-License-Identifier: Apache-2.0
// For tests: a small valid sequence of NCore with made numbers, in two stores, written without the
// program's export. Tests break parts of it.
#pragma once

#include <cmath>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/base/files/indexed_tar.h"
#include "redrive/image/jpeg.h"
#include "redrive/image/png.h"
#include "redrive/recording/core/recording_testing.h"

namespace redrive::testing {

/// Six frames at 10 Hz of two cameras and a LiDAR. The car drives along a line at 8 m/s while it
/// turns evenly, which linear interpolation has exactly.
class MadeNcore {
 public:
  using Json = nlohmann::json;
  static constexpr int kFrames = 6, kRays = 40, kWidth = 64, kHeight = 48;
  static constexpr std::int64_t kFirst_us = 1'600'000'000'000'000, kStep_us = 100'000,
                                kRead_us = 30'000;
  static constexpr double kSpeed_m_per_s = 8, kTurn_rad_per_s = 0.2, kCar_m_per_s = 5;

  static std::int64_t end_us(int frame) { return kFirst_us + kStep_us * (frame + 1); }

  static Rigid3d world_from_rig(std::int64_t us) {
    const double s = 1e-6 * static_cast<double>(us - kFirst_us);
    return Eigen::Translation3d(kSpeed_m_per_s * s, 0, 0) *
           Eigen::AngleAxisd(kTurn_rad_per_s * s, Eigen::Vector3d::UnitZ());
  }
  static Rigid3d world_global_from_world() {
    return Eigen::Translation3d(4e6, 3e6, 3.95e6) *
           Eigen::AngleAxisd(0.7, Eigen::Vector3d::UnitX());
  }
  static Rigid3d rig_from_camera(double y) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
    pose.translation() = Eigen::Vector3d(1.5, y, 1.25);
    return pose;
  }
  static Rigid3d rig_from_lidar() {
    return Eigen::Translation3d(1, 0, 1.75) * Eigen::AngleAxisd(0.1, Eigen::Vector3d::UnitZ());
  }
  static std::int64_t ray_us(int frame, int ray) { return end_us(frame) - kStep_us + 2500 * ray; }
  static Eigen::Vector3d ray_in_lidar(int ray) {
    const double azimuth = 2 * M_PI * ray / kRays;
    return Eigen::Vector3d(std::cos(azimuth), std::sin(azimuth), -0.1).normalized();
  }
  static double range_m(int ray) { return 4 + 0.125 * ray; }
  static bool is_lost(int ray) { return ray % 10 == 9; }
  static bool is_second_alone(int ray) { return ray % 10 == 4; }
  /// A car that drives ahead in the world's x.
  static Rigid3d world_from_car(std::int64_t us) {
    const double s = 1e-6 * static_cast<double>(us - kFirst_us);
    return Rigid3d(Eigen::Translation3d(20 + kCar_m_per_s * s, 3, 0.75));
  }

  MadeNcore() {
    for (const char* store : {"made.ncore4.zarr", "made.ncore4-sensors.zarr"}) {
      stores[store][".zgroup"] = group();
      attributes(store, "",
                 {{"sequence_id", "made"},
                  {"version", "v4"},
                  {"component_group_name", ""},
                  {"generic_meta_data", Json::object()},
                  {"sequence_timestamp_interval_us",
                   {{"start", kFirst_us}, {"stop", end_us(kFrames - 1) + 1}}}});
    }
    add_poses();
    add_intrinsics();
    add_images("front_wide", "jpeg", kRead_us);
    add_images("rear", "png", 0);
    add_scans();
    add_cuboids();
  }

  /// Writes the stores as folders or indexed tars, and the list of them.
  void write(const std::filesystem::path& folder, bool packed) const {
    Json listed = Json::array();
    for (const auto& [name, files] : stores) {
      if (packed) {
        IndexedTarWriter tar(folder / (name + ".itar"));
        for (const auto& [key, bytes] : files) tar.add(key, bytes);
        tar.finish();
      } else {
        for (const auto& [key, bytes] : files) {
          std::filesystem::create_directories((folder / name / key).parent_path());
          std::ofstream(folder / name / key, std::ios::binary) << bytes;
        }
      }
      listed.push_back({{"path", name + (packed ? ".itar" : "")}, {"md5", ""}});
    }
    std::ofstream(folder / "made.json")
        << Json({{"sequence_id", "made"}, {"component_stores", listed}}).dump();
  }

  static Json matrix(const Rigid3d& pose) {
    Json rows = Json::array();
    for (int r = 0; r < 4; ++r) {
      Json row = Json::array();
      for (int c = 0; c < 4; ++c) row.push_back(pose.matrix()(r, c));
      rows.push_back(row);
    }
    return rows;
  }
  void attributes(const std::string& store, const std::string& path, const Json& values) {
    stores[store][path.empty() ? ".zattrs" : path + "/.zattrs"] = values.dump();
    if (!path.empty()) stores[store].try_emplace(path + "/.zgroup", group());
  }
  /// Changes attributes that are there.
  template <class Change>
  void change(const std::string& store, const std::string& path, const Change& how) {
    Json values = Json::parse(stores.at(store).at(path + "/.zattrs"));
    how(&values);
    attributes(store, path, values);
  }
  template <class T>
  void array(const std::string& path, const char* dtype, const std::vector<std::size_t>& shape,
             const std::vector<T>& values) {
    std::string chunk = "0";
    for (std::size_t i = 1; i < shape.size(); ++i) chunk += ".0";
    describe(path, dtype, shape);
    stores[kSensors][path + "/" + chunk] =
        std::string(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T));
  }

  std::map<std::string, std::map<std::string, std::string>> stores;  ///< bytes by store and key
  static constexpr const char *kMain = "made.ncore4.zarr", *kSensors = "made.ncore4-sensors.zarr";

 private:
  static std::string group() { return Json({{"zarr_format", 2}}).dump(); }
  static Json fixed(const Rigid3d& pose) { return {{"pose", matrix(pose)}, {"dtype", "float64"}}; }
  void component(const std::string& store, const std::string& kind, const std::string& name) {
    attributes(store, kind + "/" + name,
               {{"component_name", kind},
                {"component_instance_name", name},
                {"component_version", "v1"},
                {"generic_meta_data", Json::object()}});
  }
  void describe(const std::string& path, const std::string& dtype,
                const std::vector<std::size_t>& shape, const char* store = kSensors) {
    stores[store][path + "/.zarray"] = Json({{"zarr_format", 2},
                                             {"dtype", dtype},
                                             {"shape", shape},
                                             {"chunks", shape},
                                             {"order", "C"},
                                             {"compressor", nullptr},
                                             {"filters", nullptr},
                                             {"fill_value", nullptr}})
                                           .dump();
  }
  void file(const std::string& path, const std::string& bytes, const char* format,
            const char* store = kSensors) {
    describe(path, "|S" + std::to_string(bytes.size()), {}, store);
    stores[store][path + "/0"] = bytes;
    stores[store][path + "/.zattrs"] = Json({{"format", format}}).dump();
  }

  void add_poses() {
    component(kMain, "poses", "default");
    Json poses = Json::array(), times = Json::array();
    for (std::int64_t us = kFirst_us; us <= end_us(kFrames - 1); us += kStep_us / 10) {
      poses.push_back(matrix(world_from_rig(us)));
      times.push_back(us);
    }
    attributes(
        kMain, "poses/default/dynamic_poses",
        {{"('rig', 'world')", {{"poses", poses}, {"timestamps_us", times}, {"dtype", "float64"}}}});
    // The rear camera stands on a mount, whose place is given the other way round.
    const Rigid3d rig_from_mount(Eigen::Translation3d(0, 0, 0.5));
    attributes(kMain, "poses/default/static_poses",
               {{"('front_wide', 'rig')", fixed(rig_from_camera(0.25))},
                {"('rear', 'mount')", fixed(rig_from_mount.inverse() * rig_from_camera(-0.25))},
                {"('rig', 'mount')", fixed(rig_from_mount.inverse())},
                {"('lidar_top', 'rig')", fixed(rig_from_lidar())},
                {"('world', 'world_global')", fixed(world_global_from_world())}});
  }
  void add_intrinsics() {
    component(kMain, "intrinsics", "default");
    attributes(kMain, "intrinsics/default/cameras/front_wide",
               {{"camera_model_type", "ftheta"},
                {"camera_model_parameters",
                 {{"resolution", {kWidth, kHeight}},
                  {"shutter_type", "ROLLING_TOP_TO_BOTTOM"},
                  {"principal_point", {31.25, 23.75}},
                  {"reference_poly", "ANGLE_TO_PIXELDIST"},
                  {"pixeldist_to_angle_poly", {0.0, 0.025, 0.0, 0.0, 0.0, 0.0}},
                  {"angle_to_pixeldist_poly", {0.0, 40.0, 0.0, -2.0, 0.0, 0.0}},
                  {"max_angle", 1.2},
                  {"linear_cde", {1.0, 0.0, 0.0}}}}});
    attributes(kMain, "intrinsics/default/cameras/rear",
               {{"camera_model_type", "opencv-pinhole"},
                {"camera_model_parameters",
                 {{"resolution", {kWidth, kHeight}},
                  {"shutter_type", "GLOBAL"},
                  {"external_distortion_parameters", nullptr},
                  {"principal_point", {32.0, 24.5}},
                  {"focal_length", {50.0, 51.0}},
                  {"radial_coeffs", {0.1, -0.02, 0.003, 0.01, 0.0, 0.0}},
                  {"tangential_coeffs", {0.001, -0.002}},
                  {"thin_prism_coeffs", {0.0, 0.0, 0.0, 0.0}}}}});
    component(kMain, "masks", "default");
    Image8 mask{kWidth, kHeight, std::vector<std::uint8_t>(3 * kWidth * kHeight), {}, {}};
    std::fill(mask.rgb.end() - 3 * kWidth * 8, mask.rgb.end(), std::uint8_t{255});
    attributes(kMain, "masks/default/cameras/front_wide", {{"mask_names", {"ego", "sky"}}});
    file("masks/default/cameras/front_wide/ego", encode_png(mask), "png", kMain);
    attributes(kMain, "masks/default/cameras/rear", {{"mask_names", Json::array()}});
  }
  static Json times(std::int64_t length_us) {
    Json rows = Json::array();
    for (int f = 0; f < kFrames; ++f) rows.push_back({end_us(f) - length_us, end_us(f)});
    return {{"frames_timestamps_us", rows}};
  }
  void add_images(const std::string& camera, const char* format, std::int64_t length_us) {
    component(kSensors, "cameras", camera);
    attributes(kSensors, "cameras/" + camera + "/frames", times(length_us));
    for (int f = 0; f < kFrames; ++f) {
      Image8 image{kWidth, kHeight, std::vector<std::uint8_t>(3 * kWidth * kHeight), {}, {}};
      for (std::size_t i = 0; i < image.rgb.size(); ++i)
        image.rgb[i] = static_cast<std::uint8_t>(i * (f + 3));
      const std::string path = "cameras/" + camera + "/frames/" + std::to_string(end_us(f));
      attributes(kSensors, path, Json::object());
      file(path + "/image", format[0] == 'j' ? encode_jpeg(image, 95) : encode_png(image), format);
    }
  }
  void add_scans() {
    component(kSensors, "lidars", "lidar_top");
    attributes(kSensors, "lidars/lidar_top/frames", times(kStep_us));
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    for (int f = 0; f < kFrames; ++f) {
      const std::string path = "lidars/lidar_top/frames/" + std::to_string(end_us(f)),
                        bundle = path + "/ray_bundle", returns = path + "/ray_bundle_returns";
      std::vector<float> directions, ranges(2 * kRays, kNan), intensities(2 * kRays, kNan);
      std::vector<std::uint64_t> t_us;
      std::vector<std::uint16_t> elements;
      for (int i = 0; i < kRays; ++i) {
        const Eigen::Vector3d ray = ray_in_lidar(i);
        for (int k = 0; k < 3; ++k) directions.push_back(static_cast<float>(ray[k]));
        t_us.push_back(static_cast<std::uint64_t>(ray_us(f, i)));
        elements.push_back(static_cast<std::uint16_t>(i % 4));
        elements.push_back(static_cast<std::uint16_t>(i / 4));
        if (is_lost(i)) continue;
        const int first = is_second_alone(i) ? kRays : 0;
        ranges[first + i] = static_cast<float>(range_m(i));
        intensities[first + i] = static_cast<float>(i) / kRays;
        if (first == 0) ranges[kRays + i] = 100, intensities[kRays + i] = 1;
      }
      attributes(kSensors, path, Json::object());
      attributes(kSensors, bundle, {{"n_rays", kRays}});
      attributes(kSensors, returns, {{"n_returns", 2}});
      array(bundle + "/direction", "<f4", {kRays, 3}, directions);
      array(bundle + "/timestamp_us", "<u8", {kRays}, t_us);
      array(bundle + "/model_element", "<u2", {kRays, 2}, elements);
      array(returns + "/distance_m", "<f4", {2, kRays}, ranges);
      array(returns + "/intensity", "<f4", {2, kRays}, intensities);
    }
  }
  /// The car at the times of the LiDAR's middles, in its axes at the end of the scan; a person who
  /// stands, in the world.
  void add_cuboids() {
    component(kMain, "cuboids", "default");
    Json observations = Json::array();
    const auto add = [&](const char* track, const char* type, std::int64_t us, const char* in,
                         std::int64_t reference_us, const Eigen::Vector3d& at, double yaw,
                         const Json& size) {
      observations.push_back(
          {{"track_id", track},
           {"class_id", type},
           {"timestamp_us", us},
           {"reference_frame_id", in},
           {"reference_frame_timestamp_us", reference_us},
           {"bbox3",
            {{"centroid", {at.x(), at.y(), at.z()}}, {"dim", size}, {"rot", {0.0, 0.0, yaw}}}},
           {"source", "AUTOLABEL"},
           {"source_version", nullptr}});
    };
    for (int f = 0; f < kFrames; ++f) {
      const std::int64_t us = end_us(f) - kStep_us / 2;
      const Rigid3d in_lidar =
          (world_from_rig(end_us(f)) * rig_from_lidar()).inverse() * world_from_car(us);
      add("car", "automobile", us, "lidar_top", end_us(f), in_lidar.translation(),
          std::atan2(in_lidar.linear()(1, 0), in_lidar.linear()(0, 0)), {4.5, 1.8, 1.5});
      add("walker", "person", us, "world", us, {12, -4, 0.9}, 0.5, {0.6, 0.7, 1.8});
    }
    attributes(kMain, "cuboids/default/cuboids", {{"cuboid_track_observations", observations}});
  }
};

}  // namespace redrive::testing
