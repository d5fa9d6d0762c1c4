// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/messages.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/json_field.h"
#include "redrive/edit/traffic_edit.h"
#include "redrive/edit/view_requests.h"
#include "redrive/recording/core/lidar_sensor.h"
#include "redrive/recording/parse/json_numbers.h"

namespace redrive::view {
namespace {

constexpr std::size_t kMaxName = 256;  ///< characters of a camera, a novel set or an exposure
constexpr const char* kFile = "message";

std::string name_of(const JsonField& field) {
  std::string name = field.string();
  if (name.size() > kMaxName) field.fail("must have at most 256 characters");
  return name;
}

std::uint64_t count_of(const JsonField& field) {
  const std::int64_t value = field.integer();
  if (value < 0) field.fail("must be 0 or more");
  return static_cast<std::uint64_t>(value);
}

bool boolean_of(const JsonField& field) {
  if (!field.json().is_boolean()) field.fail("must be true or false");
  return field.json().get<bool>();
}

double bounded(const JsonField& field, double least, double most) {
  const double value = field.number();
  if (!(value >= least && value <= most)) field.fail("is out of range");
  return value;
}

Layer layer_of(const JsonField& field) {
  const std::string name = field.string();
  if (name == "image") return Layer::kImage;
  if (name == "depth") return Layer::kDepth;
  if (name == "normals") return Layer::kNormals;
  if (name == "opacity") return Layer::kOpacity;
  if (name == "coverage") return Layer::kCoverage;
  if (name == "actors") return Layer::kActors;
  field.fail("must be image, depth, normals, opacity, coverage or actors");
}

Overlays overlays_of(const JsonField& field) {
  if (!field.json().is_array() || field.size() > 8) field.fail("must be a list of names");
  constexpr std::pair<const char*, bool Overlays::*> kNames[] = {
      {"trajectory", &Overlays::trajectory}, {"frusta", &Overlays::frusta},
      {"lidar", &Overlays::lidar},           {"cloud", &Overlays::cloud},
      {"boxes", &Overlays::boxes},           {"masks", &Overlays::masks}};
  Overlays overlays;
  for (std::size_t i = 0; i < field.size(); ++i) {
    const std::string name = field.at(i).string();
    const auto* const known =
        std::ranges::find(kNames, name, &std::pair<const char*, bool Overlays::*>::first);
    if (known == std::end(kNames))
      field.at(i).fail("must be trajectory, frusta, lidar, cloud, boxes or masks");
    overlays.*known->second = true;
  }
  return overlays;
}

ScanRequest scan_of(const JsonField& field) {
  const JsonField sensor = field.at("sensor"), colour = field.at("colour");
  ScanRequest scan{name_of(sensor)};
  if (scan.sensor != "recorded" && scan.sensor != "estimated" && !parse_lidar_sensor(scan.sensor))
    sensor.fail(lidar_sensor_rule());
  constexpr const char* kColours[] = {"range", "intensity", "error"};
  const auto* const known = std::ranges::find(kColours, colour.string());
  if (known == std::end(kColours)) colour.fail("must be range, intensity or error");
  scan.colour = static_cast<ScanRequest::Colour>(known - kColours);
  if (scan.colour == ScanRequest::Colour::kError && scan.sensor != "recorded")
    colour.fail("needs the sensor recorded: nobody recorded this one's scan");
  return scan;
}

ViewRequest view_of(const JsonField& message) {
  ViewRequest view;
  view.id = count_of(message.at("id"));
  view.camera = name_of(message.at("camera"));
  view.frame = message.at("frame").integer();
  const JsonField shift = message.at("shift_m");
  if (!shift.json().is_array() || shift.size() != 3) shift.fail("must be three numbers");
  for (std::size_t k = 0; k < 3; ++k)
    view.shift_m[k] = bounded(shift.at(k), -kMaxShift_m, kMaxShift_m);
  view.yaw_deg = bounded(message.at("yaw_deg"), -360, 360);
  view.pitch_deg = bounded(message.at("pitch_deg"), -360, 360);
  view.layer = layer_of(message.at("layer"));
  view.exposure = name_of(message.at("exposure"));
  view.overlays = overlays_of(message.at("overlays"));
  view.reference = boolean_of(message.at("reference"));
  if (message.has("novel") && !message.at("novel").json().is_null()) {
    const JsonField novel = message.at("novel");
    view.novel = {name_of(novel.at("set")), count_of(novel.at("index"))};
  }
  if (message.has("mount") && !message.at("mount").json().is_null()) {
    const JsonField at = message.at("mount").at("at"), lens_text = message.at("mount").at("lens");
    const auto mount = parse_mount(name_of(at));
    if (!mount) at.fail(kMountRule);
    const auto lens = parse_lens(name_of(lens_text));
    if (!lens) lens_text.fail(kLensRule);
    view.mount = {*mount, *lens};
  }
  if (message.has("path_s") && !message.at("path_s").json().is_null())
    view.path_s = bounded(message.at("path_s"), 0, kMaxPath_s);
  if (message.has("object") && !message.at("object").json().is_null())
    view.object = message.at("object").integer();
  if (message.has("scan") && !message.at("scan").json().is_null())
    view.scan = scan_of(message.at("scan"));
  return view;
}

/// Returns u and v.
std::array<double, 2> pointer_of(const JsonField& field) {
  return numbers_within<2>(field, 0, 1, "must be two numbers in 0..1");
}

Pick pick_of(const JsonField& message) {
  const auto [u, v] = pointer_of(message.at("at"));
  return {count_of(message.at("id")), u, v};
}

DragMessage drag_of(const JsonField& message) {
  DragMessage drag;
  drag.id = count_of(message.at("id"));
  drag.object = message.at("object").integer();
  drag.turns = boolean_of(message.at("turns"));
  drag.from = pointer_of(message.at("from"));
  drag.to = pointer_of(message.at("to"));
  drag.shift_m = numbers_within<3>(message.at("shift_m"), -kMaxActorShift_m, kMaxActorShift_m,
                                   "must be three numbers in -1e4..1e4");
  drag.turn_deg = bounded(message.at("turn_deg"), -360, 360);
  return drag;
}

std::string path_name_of(const JsonField& field) {
  std::string name = field.string();
  if (!valid_path_name(name)) field.fail("must be 1 to 64 letters, digits, _ or -");
  return name;
}

PathMessage path_of(const JsonField& message) {
  PathMessage path;
  path.fps = bounded(message.at("fps"), kMinPathFps, kMaxPathFps);
  path.keyframes = path_keyframes_from_json(message.at("keyframes"));
  if (const JsonField save = message.at("save"); !save.json().is_null())
    path.save = {path_name_of(save.at("name")), boolean_of(save.at("overwrite"))};
  return path;
}

}  // namespace

bool valid_path_name(std::string_view name) {
  return !name.empty() && name.size() <= 64 &&
         name.find_first_not_of(
             "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_-") == name.npos;
}

ClientMessage parse_client_message(std::string_view text) {
  if (text.size() > kMaxMessageBytes)
    throw InputError(kFile, "", "", "must have at most 1048576 bytes");
  const nlohmann::json json = parse_json(text, kFile);
  const JsonField message(json, kFile);
  const std::string type = message.at("type").string();
  if (type == "view") return view_of(message);
  if (type == "shown") return Shown{count_of(message.at("sequence"))};
  if (type == "pick") return pick_of(message);
  if (type == "train") return TrainCommand{boolean_of(message.at("paused"))};
  if (type == "path") return path_of(message);
  if (type == "load_path") return LoadPath{path_name_of(message.at("name"))};
  if (type == "edit")
    return EditMessage{count_of(message.at("id")), name_of(message.at("file")),
                       message.at("text").string()};
  if (type == "drag") return drag_of(message);
  message.at("type").fail("must be view, shown, pick, train, path, load_path, edit or drag");
}

}  // namespace redrive::view
