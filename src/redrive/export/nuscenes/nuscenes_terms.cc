// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/nuscenes/nuscenes_terms.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <string_view>
#include <utility>

#include "redrive/export/rig_names.h"
#include "redrive/recording/core/actor_kind.h"

namespace redrive::nuscenes {
namespace {

constexpr std::array<RigPlace, 6> kChannels{{{"CAM_FRONT", 0},
                                             {"CAM_FRONT_LEFT", 55},
                                             {"CAM_FRONT_RIGHT", -55},
                                             {"CAM_BACK_LEFT", 110},
                                             {"CAM_BACK_RIGHT", -110},
                                             {"CAM_BACK", 180}}};

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
  return names_in_rig(cameras, kChannels, own_channel);
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
