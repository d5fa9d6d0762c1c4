// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/pandaset/pandaset_boxes.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "redrive/recording/core/labels.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/kitti/kitti_scan.h"
#include "redrive/recording/formats/pandaset/pandaset_scan.h"
#include "redrive/recording/parse/data_frame.h"

namespace redrive::pandaset {
namespace {

constexpr std::int64_t kHalfRevolution_ns = 50'000'000;
constexpr double kMaxSize_m = 100;
/// PandaSet's annotation instructions for cuboids, version of 2020.
constexpr std::array<std::string_view, 28> kLabels = {"Animals - Bird",
                                                      "Animals - Other",
                                                      "Bicycle",
                                                      "Bus",
                                                      "Car",
                                                      "Cones",
                                                      "Construction Signs",
                                                      "Emergency Vehicle",
                                                      "Medium-sized Truck",
                                                      "Motorcycle",
                                                      "Motorized Scooter",
                                                      "Other Vehicle - Construction Vehicle",
                                                      "Other Vehicle - Pedicab",
                                                      "Other Vehicle - Uncommon",
                                                      "Pedestrian",
                                                      "Pedestrian with Object",
                                                      "Personal Mobility Device",
                                                      "Pickup Truck",
                                                      "Pylons",
                                                      "Road Barriers",
                                                      "Rolling Containers",
                                                      "Semi-truck",
                                                      "Signs",
                                                      "Temporary Construction Barriers",
                                                      "Towed Object",
                                                      "Train",
                                                      "Tram / Subway",
                                                      "Trolley"};

/// Name of the object that a cuboid and its sibling are.
using Names = std::map<std::string, std::string>;

Names names_of_objects(const std::map<std::int64_t, std::vector<Cuboid>>& cuboids) {
  Names names;
  for (const auto& [frame, of_frame] : cuboids)
    for (const Cuboid& cuboid : of_frame) {
      const auto known = [&](const std::string& uuid) {
        const auto found = names.find(uuid);
        return found == names.end() ? uuid : found->second;
      };
      std::string name = known(cuboid.uuid);
      if (!cuboid.sibling.empty()) {
        name = std::min(name, known(cuboid.sibling));
        names[cuboid.sibling] = name;
      }
      names[cuboid.uuid] = name;
    }
  return names;
}

}  // namespace

bool is_known_label(std::string_view label) {
  return std::ranges::find(kLabels, label) != kLabels.end();
}

std::vector<Cuboid> parse_cuboids(std::string_view pickle, const std::filesystem::path& file,
                                  std::vector<std::string>* impossible) {
  const DataFrame table(pickle, file);
  constexpr const char* kNumbers[] = {"position.x",   "position.y",   "position.z", "dimensions.x",
                                      "dimensions.y", "dimensions.z", "yaw"};
  std::vector<Cuboid> cuboids;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const auto text = [&](const char* column) {
      return table.has(column) ? std::string(table.texts(column)[i]) : "";
    };
    double values[7];
    std::string fault;
    for (int k = 0; k < 7; ++k) {
      values[k] = table.numbers(kNumbers[k])[i];
      const bool is_size = k >= 3 && k < 6;
      const double most = is_size ? kMaxSize_m : kMaxCoordinate_m;
      if (fault.empty() && !(std::abs(values[k]) <= most && (!is_size || values[k] > 0)))
        fault = std::string(kNumbers[k]) + " = " + std::to_string(values[k]);
    }
    Cuboid cuboid;
    cuboid.uuid = text("uuid");
    cuboid.label = text("label");
    if (cuboid.uuid.empty()) fault = "no uuid";
    if (cuboid.label.empty()) fault = "no label";
    if (!fault.empty()) {
      impossible->push_back(file.filename().string() + " row " + std::to_string(i) + ": " + fault);
      continue;
    }
    cuboid.has_rider = text("attributes.rider_status") == "With Rider";
    cuboid.sibling = text("cuboids.sibling_id");
    if (cuboid.sibling == "-") cuboid.sibling.clear();
    if (table.has("cuboids.sensor_id") && table.numbers("cuboids.sensor_id")[i] >= 0)
      cuboid.sensor = table.numbers("cuboids.sensor_id")[i] == 0 ? 0 : 1;
    // Their y axis is the object's length and looks ahead.
    cuboid.world_from_box = Eigen::Translation3d(values[0], values[1], values[2]) *
                            Eigen::AngleAxisd(values[6] + M_PI / 2, Eigen::Vector3d::UnitZ());
    cuboid.size_m = {values[4], values[3], values[5]};
    cuboids.push_back(std::move(cuboid));
  }
  return cuboids;
}

std::map<std::int64_t, std::vector<Box>> boxes_of_frames(
    const std::map<std::int64_t, std::vector<Cuboid>>& cuboids, const Rigid3d& body_from_lidar,
    const std::vector<FramePose>& frames) {
  const Names names = names_of_objects(cuboids);
  std::map<std::string, std::int64_t> ids;
  std::vector<Label> labels;
  std::map<std::pair<std::int64_t, std::int64_t>, std::int64_t> times_ns;  // frame, object
  for (const auto& [frame_id, of_frame] : cuboids) {
    const auto frame = std::ranges::lower_bound(frames, frame_id, {}, &FramePose::id);
    if (frame == frames.end() || frame->id != frame_id) continue;
    const Rigid3d lidar_from_world =
        (frame->global_from_body * body_from_lidar).inverse(Eigen::Isometry);
    std::vector<const Cuboid*> sorted;
    for (const Cuboid& cuboid : of_frame) sorted.push_back(&cuboid);
    std::ranges::stable_sort(sorted, {}, [](const Cuboid* cuboid) { return cuboid->sensor; });
    for (const Cuboid* cuboid : sorted) {
      const std::int64_t id =
          ids.try_emplace(names.at(cuboid->uuid), std::ssize(ids)).first->second;
      std::int64_t t_ns = frame->t_ns;
      if (cuboid->sensor != static_cast<int>(Lidar::kPandarGt))
        t_ns = kitti::time_of_direction({t_ns - kHalfRevolution_ns, t_ns + kHalfRevolution_ns},
                                        lidar_from_world * cuboid->world_from_box.translation());
      if (!times_ns.try_emplace({frame_id, id}, t_ns).second) continue;
      Label label;
      label.frame_id = frame_id;
      label.object_id = id;
      label.type = cuboid->label + (cuboid->has_rider ? " with rider" : "");
      label.size_m = cuboid->size_m;
      label.sensor_from_box =
          pose_at(frames, t_ns).inverse(Eigen::Isometry) * cuboid->world_from_box;
      labels.push_back(std::move(label));
    }
  }
  return place_boxes(labels, Rigid3d::Identity(), frames,
                     [&](const Label& label, const FramePose&) {
                       return times_ns.at({label.frame_id, label.object_id});
                     });
}

}  // namespace redrive::pandaset
