// SPDX-License-Identifier: Apache-2.0
// A small valid log in Argoverse 2's layout with made numbers, for tests, which then break one.
#pragma once

#include <map>
#include <numbers>
#include <string>
#include <vector>

#include "redrive/image/image_io.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/parse/arrow_testing.h"

namespace redrive::testing {

/// Eight images of each camera at 20 Hz and four scans at 10 Hz. The car drives along a line at 8
/// m/s while it turns evenly, which linear interpolation has exactly.
class Argoverse2Drive {
 public:
  static constexpr int kFrames = 8, kScans = 4;
  static constexpr std::int64_t kFirst_ns = 315'966'253'572'412'942, kStep_ns = 50'000'000,
                                kFirstReturn_ns = 2'654'000;
  static constexpr double kUpAtFirst_rad = 2.3;  ///< azimuth of the up_lidar's first return
  static constexpr double kTurn_rad = 2 * std::numbers::pi;

  /// A row of a table of poses, whose rotation is a quaternion.
  struct Row {
    std::string name;  ///< sensor, or track
    std::int64_t t_ns = 0;
    Eigen::Vector4d wxyz = {1, 0, 0, 0};
    Eigen::Vector3d at = Eigen::Vector3d::Zero();
    std::string category = {};
    Eigen::Vector3d size = Eigen::Vector3d::Zero();  ///< length, width, height
  };
  struct Intrinsics {
    std::string name;
    double fx = 96.5, fy = 97.25, cx = 63.5, cy = 47.75;
    std::uint16_t width = 128, height = 96;
  };
  struct Point {
    Eigen::Vector3d in_vehicle;  ///< at the time of its scan; exact in 16 bits
    int intensity, laser;
    std::int32_t offset_ns;
  };

  Argoverse2Drive() {
    const std::pair<const char*, double> cameras[] = {
        {"ring_front_center", 0},  {"ring_front_left", 45},   {"ring_front_right", -45},
        {"ring_side_left", 100},   {"ring_side_right", -100}, {"ring_rear_left", 153},
        {"ring_rear_right", -153}, {"stereo_front_left", 1},  {"stereo_front_right", -1}};
    std::int64_t offset_ns = -24'900'000;
    for (const auto& [name, yaw_deg] : cameras) {
      const bool first = std::string(name) == "ring_front_center";
      offsets_ns[name] = first ? 0 : offset_ns;
      offset_ns += first ? 0 : 6'250'000;
      Rigid3d pose = Rigid3d::Identity();
      const double yaw = yaw_deg * std::numbers::pi / 180;
      Eigen::Matrix3d axes;  // axes of a camera that looks ahead
      axes << 0, 0, 1, -1, 0, 0, 0, -1, 0;
      pose.linear() = so3_exp({0.01, -0.02, yaw}) * axes;
      pose.translation() = Eigen::Vector3d(1.3 + 0.3 * std::cos(yaw), 0.3 * std::sin(yaw), 1.4);
      extrinsics.push_back(row_of(name, 0, pose));
      intrinsics.push_back({.name = name});
      if (first) std::swap(intrinsics.back().width, intrinsics.back().height);
    }
    Rigid3d lidar = Rigid3d::Identity();
    lidar.translation() = Eigen::Vector3d(1.35, 0, 1.64);
    extrinsics.push_back(row_of("up_lidar", 0, lidar));
    lidar.linear() = so3_exp({std::numbers::pi, 0, 0});
    lidar.translation().z() = 1.53;
    extrinsics.push_back(row_of("down_lidar", 0, lidar));
    for (int f = 0; f < kFrames; ++f)
      for (const auto& [name, offset_of_camera_ns] : offsets_ns) {
        poses.push_back(row_of("", t_ns(f) + offset_of_camera_ns));
        if (name == "stereo_front_left") poses.push_back(row_of("", poses.back().t_ns + 2));
      }
    for (int s = 0; s < kScans; ++s) poses.push_back(row_of("", scan_ns(s)));
    std::ranges::sort(poses, {}, &Row::t_ns);
    for (int s = 0; s < kScans; ++s) add_annotations(s);
  }

  static std::int64_t t_ns(int frame) { return kFirst_ns + frame * kStep_ns; }
  static std::int64_t scan_ns(int scan) { return kFirst_ns + 2 * scan * kStep_ns - 12'000'000; }
  static Rigid3d world_from_body(std::int64_t t_ns) {
    const double t_s = 1e-9 * static_cast<double>(t_ns - kFirst_ns);
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp({0.01, -0.02, 0.7}) * so3_exp(t_s * Eigen::Vector3d(0.01, 0.02, 0.3));
    pose.translation() = Eigen::Vector3d(5172, 2419, 67) + t_s * Eigen::Vector3d(6, 5, 0.3);
    return pose;
  }
  static Rigid3d world_from_vehicle(std::int64_t t_ns) {
    return world_from_body(t_ns) * Eigen::Translation3d(0, 0, 0.33);
  }
  Rigid3d vehicle_from(const std::string& sensor) const {
    const auto row = std::ranges::find(extrinsics, sensor, &Row::name);
    return pose_of(*row);
  }
  static Rigid3d pose_of(const Row& row) {
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = Eigen::Quaterniond(row.wxyz[0], row.wxyz[1], row.wxyz[2], row.wxyz[3])
                        .normalized()
                        .toRotationMatrix();
    pose.translation() = row.at;
    return pose;
  }

  /// Returns 120 returns of both LiDARs, which turn clockwise half a revolution apart, in no order
  /// of time.
  static std::vector<Point> points(int scan) {
    std::vector<Point> points;
    for (int i = 0; i < 120; ++i) {
      const int k = i * 7 % 60, down = i % 2;
      const std::int32_t offset_ns = kFirstReturn_ns + k * 1'600'000;
      const double azimuth = kUpAtFirst_rad - kTurn_rad * (k * 0.016 + 0.5 * down);
      Eigen::Vector3d in_vehicle(1.35 + 3.5 * std::cos(azimuth), 3.5 * std::sin(azimuth),
                                 0.05 * k - 0.3 + 0.25 * scan);
      for (double& x : in_vehicle) x = double(float(Eigen::half(float(x))));
      points.push_back({in_vehicle, 2 * k, 32 * down + i % 32, offset_ns});
    }
    return points;
  }

  void write(const TemporaryFolder& folder) const {
    write_tables(folder);
    for (const auto& [name, offset_ns] : offsets_ns) {
      const auto size = std::ranges::find(intrinsics, name, &Intrinsics::name);
      const bool grey = name.starts_with("stereo");
      std::filesystem::create_directories(folder.path / "sensors/cameras" / name);
      for (int f = 0; f < kFrames; ++f) {
        Image8 image{size->width, size->height, {}, {}, {}};
        image.rgb.resize(3 * std::size_t(image.width) * std::size_t(image.height));
        for (std::size_t i = 0; i < image.rgb.size(); ++i)
          image.rgb[i] = static_cast<std::uint8_t>((i / (grey ? 3 : 1) * 31 + f * 7919) % 251);
        write_image(folder.path / ("sensors/cameras/" + name + "/" +
                                   std::to_string(t_ns(f) + offset_ns) + ".jpg"),
                    image);
      }
    }
    for (int s = 0; s < kScans; ++s) write_scan(folder, s, points(s));
  }
  void write_tables(const TemporaryFolder& folder) const {
    ArrowFile table;
    add_times(poses, &table);
    add_poses(poses, &table);
    folder.write("city_SE3_egovehicle.feather", table.bytes());
    ArrowFile sensors(std::nullopt);
    add_names("sensor_name", extrinsics, &sensors);
    add_poses(extrinsics, &sensors);
    folder.write("calibration/egovehicle_SE3_sensor.feather", sensors.bytes());
    ArrowFile cuboids(arrow::Codec::kZstd);
    add_times(annotations, &cuboids);
    add_names("track_uuid", annotations, &cuboids);
    std::vector<std::string> categories;
    for (const Row& row : annotations) categories.push_back(row.category);
    cuboids.add("category", categories);
    for (int k = 0; k < 3; ++k) {
      std::vector<double> sizes;
      for (const Row& row : annotations) sizes.push_back(row.size[k]);
      cuboids.add(k == 0 ? "length_m" : k == 1 ? "width_m" : "height_m", sizes);
    }
    add_poses(annotations, &cuboids);
    folder.write("annotations.feather", cuboids.bytes());
    write_intrinsics(folder);
  }
  static void write_scan(const TemporaryFolder& folder, int scan,
                         const std::vector<Point>& points) {
    std::vector<Eigen::half> xyz[3];
    std::vector<std::uint8_t> intensity, laser;
    std::vector<std::int32_t> offset_ns;
    for (const Point& point : points) {
      for (int k = 0; k < 3; ++k) xyz[k].emplace_back(float(point.in_vehicle[k]));
      intensity.push_back(static_cast<std::uint8_t>(point.intensity));
      laser.push_back(static_cast<std::uint8_t>(point.laser));
      offset_ns.push_back(point.offset_ns);
    }
    ArrowFile table(arrow::Codec::kLz4Frame, 2);
    for (int k = 0; k < 3; ++k) table.add(std::string(1, "xyz"[k]), xyz[k]);
    table.add("intensity", intensity);
    table.add("laser_number", laser);
    table.add("offset_ns", offset_ns);
    folder.write("sensors/lidar/" + std::to_string(scan_ns(scan)) + ".feather", table.bytes());
  }

  std::map<std::string, std::int64_t> offsets_ns;
  std::vector<Row> poses, extrinsics, annotations;
  std::vector<Intrinsics> intrinsics;

 private:
  static Row row_of(const std::string& name, std::int64_t t_ns, const Rigid3d& pose) {
    const Eigen::Quaterniond q(pose.linear());
    return {name, t_ns, {q.w(), q.x(), q.y(), q.z()}, pose.translation()};
  }
  static Row row_of(const std::string& name, std::int64_t t_ns) {
    return row_of(name, t_ns, world_from_vehicle(t_ns));
  }
  /// A car that drives at 4 m/s along world y, a parked van, a cyclist, a sign: where they are at
  /// the middle of the scan.
  void add_annotations(int scan) {
    const std::int64_t t_ns = scan_ns(scan);
    const Rigid3d vehicle_from_world = world_from_vehicle(t_ns).inverse();
    const auto add = [&](const char* track, const char* category, Eigen::Vector3d at, double yaw,
                         Eigen::Vector3d size) {
      Rigid3d pose(Eigen::Translation3d{at});
      pose.linear() = so3_exp({0, 0, yaw});
      annotations.push_back(row_of(track, t_ns, vehicle_from_world * pose));
      annotations.back().category = category;
      annotations.back().size = size;
    };
    add("car", "REGULAR_VEHICLE", {5184, 2437 + 0.4 * scan, 68}, std::numbers::pi / 2,
        {4.2, 1.8, 1.5});
    add("van", "BOX_TRUCK", {5177, 2410, 68.2}, 0.5, {6, 2.2, 2.8});
    add("bike", "BICYCLIST", {5166, 2422, 68}, 1, {1.8, 0.6, 1.7});
    add("sign", "MOBILE_PEDESTRIAN_SIGN", {5180, 2420, 68}, 0, {0.5, 0.5, 1});
  }

  static void add_times(const std::vector<Row>& rows, ArrowFile* table) {
    std::vector<std::int64_t> times_ns;
    for (const Row& row : rows) times_ns.push_back(row.t_ns);
    table->add("timestamp_ns", times_ns);
  }
  static void add_names(const std::string& column, const std::vector<Row>& rows, ArrowFile* table) {
    std::vector<std::string> names;
    for (const Row& row : rows) names.push_back(row.name);
    table->add(column, names);
  }
  static void add_poses(const std::vector<Row>& rows, ArrowFile* table) {
    const char* const names[] = {"qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"};
    for (int k = 0; k < 7; ++k) {
      std::vector<double> values;
      for (const Row& row : rows) values.push_back(k < 4 ? row.wxyz[k] : row.at[k - 4]);
      table->add(names[k], values);
    }
  }
  void write_intrinsics(const TemporaryFolder& folder) const {
    std::vector<std::string> names;
    std::vector<double> focal[2], centre[2], distortion;
    std::vector<std::uint16_t> width, height;
    for (const Intrinsics& camera : intrinsics) {
      names.push_back(camera.name);
      focal[0].push_back(camera.fx);
      focal[1].push_back(camera.fy);
      centre[0].push_back(camera.cx);
      centre[1].push_back(camera.cy);
      distortion.push_back(-0.24);
      width.push_back(camera.width);
      height.push_back(camera.height);
    }
    ArrowFile table;
    table.add("sensor_name", names);
    table.add("fx_px", focal[0]);
    table.add("fy_px", focal[1]);
    table.add("cx_px", centre[0]);
    table.add("cy_px", centre[1]);
    for (const char* name : {"k1", "k2", "k3"}) table.add(name, distortion);
    table.add("height_px", height);
    table.add("width_px", width);
    folder.write("calibration/intrinsics.feather", table.bytes());
  }
};

}  // namespace redrive::testing
