// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/traffic_edit.h"

#include <algorithm>
#include <charconv>
#include <string>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/parse/json_numbers.h"

namespace redrive {
namespace {

constexpr double kMaxWorld_m = 1e6;
constexpr std::size_t kMaxFileName = 4096;
constexpr const char* kDegreesRule = "expected -360 to 360 degrees";

bool boolean(const JsonField& field) {
  if (!field.json().is_boolean()) field.fail("expected true or false");
  return field.json().get<bool>();
}

std::vector<TrackPoint> track_from_json(const JsonField& list) {
  if (!list.json().is_array() || list.size() < 2 || list.size() > kMaxTrackPoints)
    list.fail("expected a list of 2 to 10000 points");
  std::vector<TrackPoint> track;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const JsonField entry = list.at(i);
    TrackPoint point;
    point.time_s = number_within(entry.at("time_s"), 0, kMaxEdit_s,
                                 "expected seconds after the first frame, 0 to 86400");
    if (i > 0 && !(point.time_s >= track.back().time_s + 1e-3))
      entry.at("time_s").fail("expected times that increase by 0.001 s at least");
    point.position_m = numbers_within<3>(entry.at("position_m"), -kMaxWorld_m, kMaxWorld_m,
                                         "expected three metres in the run's world, at most 1e6");
    for (const auto& [name, degrees] :
         {std::pair("yaw_deg", &point.yaw_deg), std::pair("pitch_deg", &point.pitch_deg),
          std::pair("roll_deg", &point.roll_deg)})
      if (entry.has(name)) *degrees = number_within(entry.at(name), -360, 360, kDegreesRule);
    track.push_back(point);
  }
  return track;
}

/// Returns the file of {"file": FILE}.
std::filesystem::path body_file(const JsonField& body) {
  for (const std::string& key : body.keys())
    if (key != "file") body.at(key).fail("is unknown; a body is an id or {\"file\": FILE}");
  const JsonField file = body.at("file");
  const std::string name = file.string();
  if (name.empty() || name.size() > kMaxFileName ||
      std::ranges::any_of(name, [](char c) { return static_cast<unsigned char>(c) < ' '; }))
    file.fail("expected the name of a file");
  return name;
}

/// `known`: further fields of the object.
ActorChange change_from_json(const JsonField& json, const std::vector<std::string>& known) {
  if (!json.json().is_object()) json.fail("expected an object");
  ActorChange change;
  for (const std::string& key : json.keys()) {
    const JsonField field = json.at(key);
    if (key == "remove")
      change.remove = boolean(field);
    else if (key == "track")
      change.track = track_from_json(field);
    else if (key == "speed")
      change.speed = number_within(field, 0, kMaxSpeed, "expected a factor, 0 to 100");
    else if (key == "shift_m")
      change.shift_m = numbers_within<3>(field, -kMaxActorShift_m, kMaxActorShift_m,
                                         "expected metres forward, left and up, at most 1e4");
    else if (key == "shift_road_m")
      change.shift_road_m =
          numbers_within<3>(field, -kMaxActorShift_m, kMaxActorShift_m,
                            "expected metres along the road, to its left and up, at most 1e4");
    else if (key == "turn_deg")
      change.turn_deg = number_within(field, -360, 360, kDegreesRule);
    else if (key == "hide_s")
      change.hide_s = numbers_within<2>(field, 0, kMaxEdit_s,
                                        "expected two times in seconds after the first frame");
    else if (key == "body" && field.json().is_object())
      change.body_file = body_file(field);
    else if (key == "body")
      change.body = field.integer();
    else if (key == "gain")
      change.gain = numbers_within<3>(field, 0, 100, "expected factors of r, g, b, 0 to 100");
    else if (std::ranges::find(known, key) == known.end())
      field.fail(
          "is no change; known are remove, track, speed, shift_m, shift_road_m, turn_deg, hide_s, "
          "body, gain");
  }
  if (change.hide_s && !((*change.hide_s)[0] < (*change.hide_s)[1]))
    json.at("hide_s").fail("expected times that increase");
  return change;
}

}  // namespace

TrafficEdit parse_traffic_edit(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  if (!document.is_object()) root.fail("expected an object with actors or copies");
  TrafficEdit edit;
  edit.file = file;
  for (const std::string& key : root.keys()) {
    const JsonField field = root.at(key);
    if (key == "actors") {
      if (!field.json().is_object() || field.size() > kMaxEditedActors)
        field.fail("expected an object of at most 1000 ids");
      for (const std::string& id : field.keys()) {
        std::int64_t number = 0;
        const auto [end, error] = std::from_chars(id.data(), id.data() + id.size(), number);
        if (error != std::errc{} || end != id.data() + id.size() || id != std::to_string(number))
          field.at(id).fail("expected the id of an object as its name");
        edit.actors[number] = change_from_json(field.at(id), {});
      }
    } else if (key == "copies") {
      if (!field.json().is_array() || field.size() > kMaxEditedActors)
        field.fail("expected a list of at most 1000 copies");
      for (std::size_t i = 0; i < field.size(); ++i) {
        const JsonField copy = field.at(i);
        edit.copies.push_back({copy.at("of").integer(), copy.at("id").integer(),
                               change_from_json(copy, {"of", "id"})});
      }
    } else if (key == "added") {
      if (!field.json().is_array() || field.size() > kMaxEditedActors)
        field.fail("expected a list of at most 1000 objects");
      for (std::size_t i = 0; i < field.size(); ++i) {
        const JsonField added = field.at(i);
        edit.added.push_back({added.at("id").integer(), change_from_json(added, {"id"})});
        const ActorChange& change = edit.added.back().change;
        if (change.body_file.empty()) added.fail("expected a body {\"file\": FILE}");
        if (change.track.empty()) added.fail("expected a track");
      }
    } else {
      field.fail("is unknown; known are actors, copies and added");
    }
  }
  return edit;
}

TrafficEdit read_traffic_edit(const std::filesystem::path& file) {
  return parse_traffic_edit(read_file(file), file);
}

}  // namespace redrive
