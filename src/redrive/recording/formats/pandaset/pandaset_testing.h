// SPDX-License-Identifier: Apache-2.0
// A small valid sequence in PandaSet's layout with made numbers, for tests, which then break one.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "redrive/base/files/gzip.h"
#include "redrive/image/image_io.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/formats/pandaset/pandaset_rig.h"
#include "redrive/recording/parse/data_frame_testing.h"

namespace redrive::testing {

/// Four frames at 8 Hz: times in the files' seconds and in nanoseconds are exact. The car drives
/// along a line at 8 m/s while it turns evenly, which linear interpolation has exactly.
class PandaSetDrive {
 public:
  static constexpr int kFrames = 4;
  static constexpr std::int64_t kFirst_ns = 1'557'539'924'500'000'000, kStep_ns = 125'000'000,
                                kHalf_ns = kStep_ns / 2;
  static constexpr int kWidth = 192, kHeight = 108;

  PandaSetDrive() {
    std::int64_t offset_ns = -31'250'000;
    for (const std::string& name : pandaset::camera_names()) {
      offsets_ns[name] = name == "front_camera" ? 0 : offset_ns;
      offset_ns += 15'625'000;
      body_from_camera[name] = body_from_lidar() * pandaset::camera_from_lidar(name)->inverse();
    }
  }

  static Rigid3d world_from_body(std::int64_t t_ns) {
    const double t_s = 1e-9 * static_cast<double>(t_ns - kFirst_ns);
    Rigid3d pose = Rigid3d::Identity();
    pose.linear() = so3_exp({0.01, -0.02, 0.7}) * so3_exp(t_s * Eigen::Vector3d(0.01, 0.02, 0.3));
    pose.translation() = Eigen::Vector3d(3, -2, 0.5) + t_s * Eigen::Vector3d(6, 5, 0.3);
    return pose;
  }
  static Rigid3d body_from_lidar() { return pandaset::usual_body_from_lidar(); }
  static std::int64_t t_ns(int frame) { return kFirst_ns + frame * kStep_ns; }

  /// A point of one of the LiDARs.
  struct Point {
    Eigen::Vector3d in_world;
    double intensity;
    std::int64_t t_ns, sensor;
  };
  /// Returns points around the car within 8 m, in no order of time.
  static std::vector<Point> points(int frame) {
    std::vector<Point> points;
    for (int i = 0; i < 40; ++i) {
      const int k = i * 7 % 40;
      const std::int64_t at_ns = t_ns(frame) - kHalf_ns + k * 1'953'125;
      const Eigen::Vector3d in_body(6 * std::cos(0.15 * k) + 0.3, 6 * std::sin(0.15 * k), 0.05 * k);
      points.push_back({world_from_body(at_ns) * in_body, 3.0 * k, at_ns, i % 5 == 4});
    }
    return points;
  }

  nlohmann::json poses_of(const std::string& sensor) const {
    nlohmann::json poses = nlohmann::json::array();
    for (int f = 0; f < kFrames; ++f) {
      if (sensor == "lidar") {
        const Rigid3d car_from_body = pandaset::body_of_car(Rigid3d::Identity());
        poses.push_back(as_json(world_from_body(t_ns(f) + kHalf_ns) * car_from_body.inverse()));
      } else {
        poses.push_back(as_json(world_from_body(t_ns(f) + offsets_ns.at(sensor)) *
                                body_from_camera.at(sensor)));
      }
    }
    return poses;
  }
  nlohmann::json times_of(const std::string& sensor) const {
    nlohmann::json times = nlohmann::json::array();
    for (int f = 0; f < kFrames; ++f)
      times.push_back(seconds(t_ns(f) + (sensor == "lidar" ? kHalf_ns : offsets_ns.at(sensor))));
    return times;
  }

  void write(const TemporaryFolder& folder) const {
    for (const auto& [name, offset_ns] : offsets_ns) {
      const std::string camera = "camera/" + name + "/";
      folder.write(camera + "poses.json", poses_of(name).dump());
      folder.write(camera + "timestamps.json", times_of(name).dump());
      folder.write(camera + "intrinsics.json",
                   R"({"fx": 193.5, "fy": 194.25, "cx": 96.5, "cy": 50.75})");
      for (int f = 0; f < kFrames; ++f) {
        Image8 image{kWidth, kHeight, std::vector<std::uint8_t>(3 * kWidth * kHeight), {}, {}};
        for (std::size_t i = 0; i < image.rgb.size(); ++i)
          image.rgb[i] = static_cast<std::uint8_t>((i * 31 + std::size_t(f) * 7919) % 251);
        write_image(folder.path / (camera + "0" + std::to_string(f) + ".jpg"), image);
      }
    }
    folder.write("lidar/poses.json", poses_of("lidar").dump());
    folder.write("lidar/timestamps.json", times_of("lidar").dump());
    for (int f = 0; f < kFrames; ++f) {
      write_scan(folder, f, points(f));
      write_cuboids(folder, f);
    }
    folder.write("annotations/semseg/00.pkl.gz", "");
    folder.write("annotations/semseg/classes.json", "{}");
  }

  static void write_scan(const TemporaryFolder& folder, int frame,
                         const std::vector<Point>& points) {
    std::vector<double> columns[5];
    std::vector<std::int64_t> sensors;
    for (const Point& point : points) {
      for (int k = 0; k < 3; ++k) columns[k].push_back(point.in_world[k]);
      columns[3].push_back(point.intensity);
      columns[4].push_back(seconds(point.t_ns));
      sensors.push_back(point.sensor);
    }
    PickledTable table;
    const char* const names[] = {"x", "y", "z", "i", "t"};
    for (int k = 0; k < 5; ++k) table.add(names[k], columns[k]);
    table.add("d", sensors);
    folder.write("lidar/0" + std::to_string(frame) + ".pkl.gz", gzip(table.pickle()));
  }

  /// A cuboid as a row of its table.
  struct Row {
    std::string uuid, label, sibling = "-", rider = "";
    std::int64_t sensor = -1;
    Eigen::Vector3d at, size;  ///< size: width, length, height
    double yaw = 0;
  };
  /// A car that drives at 4 m/s along world y, which both LiDARs see, a parked van, a cyclist.
  std::vector<Row> rows(int frame) const {
    const double y = 20 + 4 * 0.125 * frame;
    std::vector<Row> rows = {
        {"far", "Car", "near", "", 1, {12, y + 0.1, 1}, {1.8, 4.2, 1.5}},
        {"near", "Car", "far", "", 0, {12, y, 1}, {1.8, 4.2, 1.5}},
        {"van", "Pickup Truck", "-", "", -1, {5, -9, 1.2}, {2, 5, 2.2}, 0.5},
        {"bike", "Bicycle", "-", "With Rider", -1, {-6, 3, 1}, {0.6, 1.8, 1.7}}};
    if (frame == 3) rows.erase(rows.begin() + 1);  // one LiDAR alone
    return rows;
  }
  void write_cuboids(const TemporaryFolder& folder, int frame) const {
    write_rows(folder, frame, rows(frame));
  }
  static void write_rows(const TemporaryFolder& folder, int frame, const std::vector<Row>& rows) {
    std::map<std::string, std::vector<double>> numbers;
    std::map<std::string, std::vector<std::string>> texts;
    std::vector<std::int64_t> sensors;
    for (const Row& row : rows) {
      texts["uuid"].push_back(row.uuid);
      texts["label"].push_back(row.label);
      texts["cuboids.sibling_id"].push_back(row.sibling);
      texts["attributes.rider_status"].push_back(row.rider);
      sensors.push_back(row.sensor);
      numbers["yaw"].push_back(row.yaw);
      for (int k = 0; k < 3; ++k) {
        numbers[std::string("position.") + "xyz"[k]].push_back(row.at[k]);
        numbers[std::string("dimensions.") + "xyz"[k]].push_back(row.size[k]);
      }
    }
    PickledTable table;
    for (const auto& [name, values] : texts) table.add(name, values);
    for (const auto& [name, values] : numbers) table.add(name, values);
    table.add("cuboids.sensor_id", sensors);
    folder.write("annotations/cuboids/0" + std::to_string(frame) + ".pkl.gz", gzip(table.pickle()));
  }

  static double seconds(std::int64_t t_ns) {
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    return double(t_ns / kSecond_ns) + double(t_ns % kSecond_ns) / double(kSecond_ns);
  }

  std::map<std::string, std::int64_t> offsets_ns;
  std::map<std::string, Rigid3d> body_from_camera;

 private:
  static nlohmann::json as_json(const Rigid3d& pose) {
    const Eigen::Quaterniond q(pose.linear());
    const Eigen::Vector3d t = pose.translation();
    return {{"position", {{"x", t.x()}, {"y", t.y()}, {"z", t.z()}}},
            {"heading", {{"w", q.w()}, {"x", q.x()}, {"y", q.y()}, {"z", q.z()}}}};
  }
};

}  // namespace redrive::testing
