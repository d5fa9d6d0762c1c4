// SPDX-License-Identifier: Apache-2.0
// A small valid excerpt of nuScenes with made numbers, for tests, which then break one value.
#pragma once

#include <array>
#include <map>
#include <string>
#include <vector>

#include "redrive/recording/core/recording_testing.h"

namespace redrive::testing {

/// Two scenes of three key frames in half a second each, with five images of each camera between
/// two key frames and a revolution for each image. The car drives at 10 m/s along x of the map.
/// CAM_BACK is 25 ms after CAM_FRONT, LIDAR_TOP 35 ms. A car 20 m ahead of the first key frame
/// drives at 8 m/s, a person stands 4 m to the left of it. Tables by name.
class NuScenesTables : public std::map<std::string, nlohmann::json> {
 public:
  NuScenesTables() {
    NuScenesTables& t = *this;
    for (const char* table : {"scene", "sample", "sample_data", "calibrated_sensor", "sensor",
                              "ego_pose", "sample_annotation", "instance", "category"})
      t[table] = nlohmann::json::array();
    add_sensor("CAM_FRONT", "camera", {1.7, 0, 1.5}, {0.5, -0.5, 0.5, -0.5});
    add_sensor("CAM_BACK", "camera", {0, 0, 1.5}, {0.5, -0.5, -0.5, 0.5});
    add_sensor("LIDAR_TOP", "lidar", {0.9, 0, 1.8}, {kRoot, 0, 0, -kRoot});
    add_sensor("RADAR_FRONT", "radar", {3.4, 0, 0.5}, {1, 0, 0, 0});
    t["category"] = {{{"token", "c0"}, {"name", "vehicle.car"}},
                     {{"token", "c1"}, {"name", "human.pedestrian.adult"}}};
    add_scene("scene-0061", 0);
    add_scene("scene-0103", 100);
  }

  /// Writes tables into v1.0-mini and empty files for images; each revolution has 32 points 10 m
  /// ahead of it.
  void write(const TemporaryFolder& folder) const {
    for (const auto& [table, records] : *this)
      folder.write("v1.0-mini/" + table + ".json", records.dump(0));
    for (const nlohmann::json& file : at("sample_data")) {
      const std::string name = file["filename"];
      folder.write(name, name.find("LIDAR") == name.npos ? "" : scan_of_one_column());
    }
  }

  static std::string scan_of_one_column() {
    std::string bytes;
    for (int ring = 0; ring < 32; ++ring) {
      const std::array<float, 5> point = {0, 10, 0, 7, static_cast<float>(ring)};
      bytes.append(reinterpret_cast<const char*>(point.data()), sizeof point);
    }
    return bytes;
  }

  static constexpr std::int64_t kFirst_us = 1'532'402'927'000'000;
  static constexpr double kRoot = 0.70710678118654752;

 private:
  void add_sensor(const std::string& channel, const std::string& modality,
                  const std::array<double, 3>& position, const std::array<double, 4>& rotation) {
    (*this)["sensor"].push_back(
        {{"token", "s-" + channel}, {"channel", channel}, {"modality", modality}});
    nlohmann::json intrinsic = nlohmann::json::array();
    if (modality == "camera") intrinsic = {{1260, 0, 800}, {0, 1260, 450}, {0, 0, 1}};
    (*this)["calibrated_sensor"].push_back({{"token", "k-" + channel},
                                            {"sensor_token", "s-" + channel},
                                            {"translation", position},
                                            {"rotation", rotation},
                                            {"camera_intrinsic", intrinsic}});
  }

  void add_file(const std::string& scene, const std::string& channel, int sample, std::int64_t t_us,
                bool key_frame) {
    const std::string token = channel + std::to_string(t_us), folder = channel + "/" + channel;
    const bool camera = channel.starts_with("CAM");
    (*this)["sample_data"].push_back(
        {{"token", token},
         {"sample_token", scene + "-" + std::to_string(sample)},
         {"ego_pose_token", token},
         {"calibrated_sensor_token", "k-" + channel},
         {"filename", (key_frame ? "samples/" : "sweeps/") + folder + std::to_string(t_us) +
                          (camera ? ".jpg" : ".pcd.bin")},
         {"timestamp", t_us},
         {"is_key_frame", key_frame},
         {"width", camera ? 1600 : 0},
         {"height", camera ? 900 : 0}});
    (*this)["ego_pose"].push_back(
        {{"token", token},
         {"timestamp", t_us},
         {"rotation", {1, 0, 0, 0}},
         {"translation", {1000 + 1e-5 * static_cast<double>(t_us - kFirst_us), 600, 0}}});
  }

  void add_scene(const std::string& name, int later_s) {
    (*this)["scene"].push_back({{"token", "t-" + name}, {"name", name}});
    const std::int64_t first_us = kFirst_us + 1'000'000ll * later_s;
    for (const char* object : {"car", "person"})
      (*this)["instance"].push_back(
          {{"token", name + object},
           {"category_token", object == std::string("car") ? "c0" : "c1"}});
    for (int s = 0; s < 3; ++s) {
      const std::int64_t t_us = first_us + 500'000ll * s;
      const std::string sample = name + "-" + std::to_string(s);
      (*this)["sample"].push_back(
          {{"token", sample}, {"scene_token", "t-" + name}, {"timestamp", t_us + 35'000}});
      // Sweeps belong to the key frame that follows them.
      for (const int before_ms : s == 0 ? std::vector{0} : std::vector{400, 350, 250, 150, 100, 0})
        for (const auto& [channel, later_us] :
             {std::pair("CAM_FRONT", 0), std::pair("CAM_BACK", 25'000),
              std::pair("LIDAR_TOP", 35'000), std::pair("RADAR_FRONT", 1'000)})
          add_file(name, channel, s, t_us - 1000 * before_ms + later_us, before_ms == 0);
      add_box(name + "car", sample, 1020 + 10.0 * later_s + 4.0 * s, 600, {2, 4.5, 1.5});
      add_box(name + "person", sample, 1020 + 10.0 * later_s, 604, {0.7, 0.6, 1.8});
    }
  }

  void add_box(const std::string& object, const std::string& sample, double x, double y,
               const std::array<double, 3>& wlh) {
    (*this)["sample_annotation"].push_back({{"token", object + sample},
                                            {"sample_token", sample},
                                            {"instance_token", object},
                                            {"translation", {x, y, 0.9}},
                                            {"size", wlh},
                                            {"rotation", {1, 0, 0, 0}}});
  }
};

}  // namespace redrive::testing
