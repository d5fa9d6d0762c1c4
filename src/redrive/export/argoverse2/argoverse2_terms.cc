// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/argoverse2/argoverse2_terms.h"

#include <array>
#include <cctype>
#include <cstdio>
#include <string_view>
#include <utility>

#include "redrive/export/rig_names.h"
#include "redrive/recording/core/actor_kind.h"
#include "redrive/recording/formats/argoverse2/argoverse2_boxes.h"

namespace redrive::argoverse2 {
namespace {

constexpr std::array<RigPlace, 7> kRing{{{"ring_front_center", 0},
                                         {"ring_front_left", 45},
                                         {"ring_front_right", -45},
                                         {"ring_side_left", 100},
                                         {"ring_side_right", -100},
                                         {"ring_rear_left", 153},
                                         {"ring_rear_right", -153}}};

/// Makes a name that is one folder.
std::string own_name(const std::string& name) {
  std::string own;
  for (const unsigned char c : name)
    own += std::isalnum(c) || c == '-' || c == '_' ? static_cast<char>(c) : '_';
  return own.empty() ? "camera" : own;
}

}  // namespace

std::vector<std::string> ring_names(const std::vector<RecordedCamera>& cameras) {
  return names_in_rig(cameras, kRing, own_name);
}

std::string category_of(const std::string& type) {
  if (is_known_category(type)) return type;
  std::string words = " ";
  for (const unsigned char c : type)
    words += std::isalpha(c) ? static_cast<char>(std::tolower(c)) : ' ';
  words += ' ';
  const auto has = [&](const char* part) { return words.find(part) != words.npos; };
  constexpr std::pair<const char*, const char*> kParts[] = {
      {"motorcyclist", "MOTORCYCLIST"},
      {"motorcycle with rider", "MOTORCYCLIST"},
      {"bicycle with rider", "BICYCLIST"},
      {"motor", "MOTORCYCLE"},
      {"cyclist", "BICYCLIST"},
      {"rider", "BICYCLIST"},
      {"cycl", "BICYCLE"},
      {"bike", "BICYCLE"},
      {"scooter", "WHEELED_DEVICE"},
      {"mobility device", "WHEELED_DEVICE"},
      {"personal mobility", "WHEELED_RIDER"},
      {"stroller", "STROLLER"},
      {"wheelchair", "WHEELCHAIR"},
      {" dog ", "DOG"},
      {"animal", "ANIMAL"},
      {"bendy", "ARTICULATED_BUS"},
      {"bus", "BUS"},
      {"trailer", "VEHICULAR_TRAILER"},
      {"rail", "RAILED_VEHICLE"},
      {" tram ", "RAILED_VEHICLE"},
      {" train ", "RAILED_VEHICLE"},
      {"pickup", "REGULAR_VEHICLE"},
      {"construction vehicle", "LARGE_VEHICLE"},
      {"vehicle construction", "LARGE_VEHICLE"},
      {"truck", "TRUCK"},
      {"cone", "CONSTRUCTION_CONE"},
      {"barrel", "CONSTRUCTION_BARREL"},
      {" sign ", "SIGN"},
      {" signs ", "SIGN"},
      {"bollard", "BOLLARD"}};
  for (const auto& [part, category] : kParts)
    if (has(part)) return category;
  if (std::string_view(kind_of(type).name) == "person") return "PEDESTRIAN";
  for (const char* const vehicle :
       {" automobile ", " car ", " suv ", " taxi ", " van ", " vehicle "})
    if (has(vehicle)) return "REGULAR_VEHICLE";
  return type;
}

std::string track_uuid(std::int64_t object_id) {
  const auto bits = static_cast<unsigned long long>(object_id);
  char text[40];
  std::snprintf(text, sizeof text, "00000000-0000-4000-%04llx-%012llx",
                0x8000 | (bits >> 48 & 0x3fff), bits & 0xffff'ffff'ffff);
  return text;
}

}  // namespace redrive::argoverse2
