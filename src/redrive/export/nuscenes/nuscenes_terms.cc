// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/nuscenes/nuscenes_terms.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <numbers>
#include <set>
#include <string_view>
#include <utility>

#include "redrive/recording/core/actor_kind.h"

namespace redrive::nuscenes {
namespace {

struct Channel {
  const char* name;
  double heading_deg;  ///< to the left of ahead
};
constexpr std::array<Channel, 6> kChannels{{{"CAM_FRONT", 0},
                                            {"CAM_FRONT_LEFT", 55},
                                            {"CAM_FRONT_RIGHT", -55},
                                            {"CAM_BACK_LEFT", 110},
                                            {"CAM_BACK_RIGHT", -110},
                                            {"CAM_BACK", 180}}};

/// Degrees between a camera's axis and a channel's heading, in the plane.
double apart_deg(const CameraCalibration& camera, const Channel& channel) {
  const Eigen::Vector3d axis = camera.body_from_sensor.linear().col(2);
  const double heading_deg = std::atan2(axis.y(), axis.x()) * 180 / std::numbers::pi;
  return std::abs(std::remainder(heading_deg - channel.heading_deg, 360.0));
}

std::string own_channel(const std::string& name) {
  std::string channel = name.starts_with("CAM_") ? "" : "CAM_";
  for (const unsigned char c : name)
    channel += std::isalnum(c) ? static_cast<char>(std::toupper(c)) : '_';
  return channel;
}

bool is_category(std::string_view name) {
  return std::ranges::find(categories(), name, [](const Term& term) {
           return std::string_view(term.name);
         }) != categories().end();
}

}  // namespace

std::vector<std::string> channels_of(const std::vector<RecordedCamera>& cameras) {
  constexpr double kMost_deg = 30;
  std::vector<std::string> channels(cameras.size());
  std::set<std::string> taken;
  for (std::size_t c = 0; c < cameras.size(); ++c)
    for (const Channel& channel : kChannels)
      if (cameras[c].calibration.name == channel.name) taken.insert(channels[c] = channel.name);
  while (true) {  // the nearest pair of a camera and a channel
    double least_deg = kMost_deg;
    std::pair<std::size_t, const char*> nearest{cameras.size(), nullptr};
    for (std::size_t c = 0; c < cameras.size(); ++c)
      for (const Channel& channel : kChannels)
        if (const double deg = apart_deg(cameras[c].calibration, channel);
            channels[c].empty() && !taken.contains(channel.name) && deg < least_deg) {
          least_deg = deg;
          nearest = {c, channel.name};
        }
    if (!nearest.second) break;
    taken.insert(channels[nearest.first] = nearest.second);
  }
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    if (!channels[c].empty()) continue;
    const std::string own = own_channel(cameras[c].calibration.name);
    std::string channel = own;
    for (int n = 2; taken.contains(channel); ++n) channel = own + "_" + std::to_string(n);
    taken.insert(channels[c] = channel);
  }
  return channels;
}

const std::vector<Term>& categories() {
  static const std::vector<Term> all = {
      {"human.pedestrian.adult", "adult"},
      {"human.pedestrian.child", "child"},
      {"human.pedestrian.wheelchair", "person in a wheelchair"},
      {"human.pedestrian.stroller", "stroller"},
      {"human.pedestrian.personal_mobility", "person on a small vehicle"},
      {"human.pedestrian.police_officer", "police officer"},
      {"human.pedestrian.construction_worker", "construction worker"},
      {"animal", "animal"},
      {"vehicle.car", "car, van, pickup, SUV"},
      {"vehicle.motorcycle", "motorcycle, with its rider"},
      {"vehicle.bicycle", "bicycle, with its rider"},
      {"vehicle.bus.bendy", "bus with a joint"},
      {"vehicle.bus.rigid", "bus"},
      {"vehicle.truck", "truck"},
      {"vehicle.construction", "construction vehicle"},
      {"vehicle.emergency.ambulance", "ambulance"},
      {"vehicle.emergency.police", "police car"},
      {"vehicle.trailer", "trailer"},
      {"movable_object.barrier", "barrier"},
      {"movable_object.trafficcone", "traffic cone"},
      {"movable_object.pushable_pullable", "bin, cart"},
      {"movable_object.debris", "debris"},
      {"static_object.bicycle_rack", "bicycle rack"}};
  return all;
}

const std::vector<Term>& attributes() {
  static const std::vector<Term> all = {{"vehicle.moving", "the vehicle moves"},
                                        {"vehicle.stopped", "the vehicle stands, with a driver"},
                                        {"vehicle.parked", "the vehicle is parked"},
                                        {"cycle.with_rider", "somebody rides"},
                                        {"cycle.without_rider", "nobody rides"},
                                        {"pedestrian.sitting_lying_down", "sits or lies"},
                                        {"pedestrian.standing", "stands"},
                                        {"pedestrian.moving", "moves"}};
  return all;
}

std::string category_of(const std::string& type) {
  if (is_category(type)) return type;
  std::string text;
  for (const unsigned char c : type)
    text += std::isalpha(c) ? static_cast<char>(std::tolower(c)) : ' ';
  const auto has = [&](const char* part) { return text.find(part) != text.npos; };
  constexpr std::pair<const char*, const char*> kParts[] = {
      {"motor", "vehicle.motorcycle"},
      {"scooter", "vehicle.motorcycle"},
      {"cycl", "vehicle.bicycle"},
      {"bike", "vehicle.bicycle"},
      {"rider", "vehicle.bicycle"},
      {"child", "human.pedestrian.child"},
      {"stroller", "human.pedestrian.stroller"},
      {"wheelchair", "human.pedestrian.wheelchair"},
      {"animal", "animal"},
      {"dog", "animal"},
      {"bus", "vehicle.bus.rigid"},
      {"trailer", "vehicle.trailer"},
      {"construction vehicle", "vehicle.construction"},
      {"ambulance", "vehicle.emergency.ambulance"},
      {"police", "vehicle.emergency.police"},
      {"pickup", "vehicle.car"},
      {"truck", "vehicle.truck"},
      {"cone", "movable_object.trafficcone"},
      {"barrier", "movable_object.barrier"}};
  for (const auto& [part, category] : kParts)
    if (has(part)) return category;
  if (has("rail") || has("emergency")) return type;
  if (std::string_view(kind_of(type).name) == "person") return "human.pedestrian.adult";
  const std::string words = " " + text + " ";
  for (const char* const vehicle :
       {" automobile ", " car ", " suv ", " taxi ", " van ", " vehicle "})
    if (words.find(vehicle) != words.npos) return "vehicle.car";
  return type;
}

std::string moving_attribute(const std::string& category) {
  if (category == "vehicle.bicycle" || category == "vehicle.motorcycle") return "cycle.with_rider";
  if (category.starts_with("vehicle.")) return "vehicle.moving";
  if (category.starts_with("human.")) return "pedestrian.moving";
  return "";
}

}  // namespace redrive::nuscenes
