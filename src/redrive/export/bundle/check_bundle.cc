// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/check_bundle.h"

#include <algorithm>
#include <cmath>

#include <yaml-cpp/yaml.h>
#include <nlohmann/json.hpp>
#include <pugixml.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/zip.h"
#include "redrive/export/bundle/scene_bundle.h"
#include "redrive/render/open_to_render.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

/// Kinds of JSON values.
constexpr const char *kText = "text", *kNumber = "number", *kList = "list", *kObject = "object",
                     *kMatrix = "4 x 4 matrix", *kAny = "value";

bool is_kind(const json& value, const std::string_view kind) {
  if (kind == kText) return value.is_string();
  if (kind == kNumber) return value.is_number();
  if (kind == kList) return value.is_array();
  if (kind == kObject) return value.is_object();
  if (kind != kMatrix) return true;
  return value.is_array() && value.size() == 4 && std::ranges::all_of(value, [](const json& row) {
           return row.is_array() && row.size() == 4 &&
                  std::ranges::all_of(row, [](const json& x) { return x.is_number(); });
         });
}

/// Returns a text of a stranger's file for terminals and JSON: what is not printable ASCII becomes
/// "?".
std::string printable(std::string text) {
  for (char& c : text)
    if (c < ' ' || c > '~') c = '?';
  return text;
}

/// Reads a member's fields for AlpaSim or CARLA, and notes which are missing.
class FieldCheck {
 public:
  FieldCheck(std::string member, std::vector<BundleGap>* gaps)
      : member_(std::move(member)), gaps_(*gaps) {}

  void miss(const std::string& field, const std::string& what) {
    constexpr std::size_t kMost = 50;
    if (gaps_.size() < kMost) gaps_.push_back({member_, printable(field), printable(what)});
  }
  /// Returns the field `key` of an object; null, with a note, where it is missing or has another
  /// kind; null where there is no object.
  const json* need(const json* object, const std::string& where, const char* key,
                   const char* kind) {
    if (!object) return nullptr;
    const std::string field = where.empty() ? key : where + "." + key;
    const auto found = object->is_object() ? object->find(key) : object->end();
    if (found == object->end()) return miss(field, "is missing"), nullptr;
    if (!is_kind(*found, kind)) return miss(field, std::string("is no ") + kind), nullptr;
    return &*found;
  }

 private:
  std::string member_;
  std::vector<BundleGap>& gaps_;
};

/// A member as it was read: nothing where it is missing or damaged, with the reason.
struct ReadMember {
  std::optional<json> value;
  std::string why;
};

class BundleCheck {
 public:
  explicit BundleCheck(const fs::path& file) : file_(file), zip_(file) {}

  BundleReport report() {
    for (const std::string& name : zip_.names())
      report_.members.push_back({printable(name), zip_.size(file_ / name).value_or(0)});
    report_.has_run = has((fs::path(kRunOfBundle) / "config.json").string());
    if (report_.has_run) try {
        open_to_render(file_);
      } catch (const InputError& error) {
        report_.run_damage = printable(error.what());
      }
    metadata_ = read_yaml(kMetadata);
    info_ = read_json_member(kDataInfo);
    rig_ = read_json_member(kRigTrajectories);
    tracks_ = read_json_member(kSequenceTracks);
    check_alpasim();
    check_carla();
    check_map();
    check_ids();
    return std::move(report_);
  }

 private:
  bool has(const std::string& name) const { return zip_.size(file_ / name).has_value(); }

  std::optional<std::string> text_of(const char* name, std::string* why) const {
    if (!has(name)) return *why = "is missing", std::nullopt;
    try {
      return zip_.read(file_ / name, kMaxTextBytes);
    } catch (const InputError& error) {
      return *why = error.rule, std::nullopt;
    }
  }

  ReadMember read_json_member(const char* name) const {
    ReadMember member;
    const auto text = text_of(name, &member.why);
    if (!text) return member;
    try {
      member.value = parse_json(*text, file_ / name);
    } catch (const InputError& error) {
      member.why = error.rule;
    }
    return member;
  }

  /// Scalars become text; what may be a number, one. `left`: nodes that may still come: an alias
  /// stands for all nodes that it names, and few of them can stand for more than fit into memory.
  static json json_of(const YAML::Node& node, int* left) {
    if (--*left < 0) throw YAML::Exception(node.Mark(), "its aliases stand for too many values");
    if (node.IsMap()) {
      json object = json::object();
      for (const auto& entry : node)
        object[entry.first.as<std::string>()] = json_of(entry.second, left);
      return object;
    }
    if (node.IsSequence()) {
      json list = json::array();
      for (const auto& entry : node) list.push_back(json_of(entry, left));
      return list;
    }
    if (!node.IsScalar()) return nullptr;
    double number = 0;
    if (node.Tag() != "!" && YAML::convert<double>::decode(node, number)) return number;
    return node.Scalar();
  }

  ReadMember read_yaml(const char* name) const {
    ReadMember member;
    const auto text = text_of(name, &member.why);
    constexpr std::size_t kMost = 1 << 20;
    constexpr int kMostNodes = 1 << 18;
    if (!text) return member;
    if (text->size() > kMost) return member.why = "is larger than 1 MiB", member;
    try {
      int left = kMostNodes;
      member.value = json_of(YAML::Load(*text), &left);
    } catch (const YAML::Exception& error) {
      member.why = std::string("is no YAML: ") + error.what();
    }
    return member;
  }

  /// Returns the member's content for a reader; null, with a note, where there is none.
  static const json* content(const ReadMember& member, FieldCheck* check) {
    if (!member.value) check->miss("", member.why);
    return member.value ? &*member.value : nullptr;
  }

  void check_alpasim() {
    FieldCheck meta(kMetadata, &report_.alpasim);
    const json* const m = content(metadata_, &meta);
    for (const char* const key :
         {"scene_id", "version_string", "training_date", "dataset_hash", "uuid", "is_resumable"})
      meta.need(m, "", key, kAny);
    meta.need(m, "", "sensors", kObject);
    meta.need(m, "", "logger", kObject);
    const json* const range = meta.need(m, "", "time_range", kObject);
    for (const char* const key : {"start", "end"}) meta.need(range, "time_range", key, kNumber);
    check_rig(&report_.alpasim, /*carla=*/false);
    check_tracks(&report_.alpasim, /*carla=*/false);
    if (!has(kMesh)) report_.alpasim.push_back({kMesh, "", "is missing: physics needs it"});
    if (!has(kGroundMesh))
      report_.remarks.push_back({kGroundMesh, "", "is missing; AlpaSim may be told to use it"});
  }

  void check_carla() {
    FieldCheck info(kDataInfo, &report_.carla);
    const json* const d = content(info_, &info);
    info.need(d, "", "sequence_id", kText);
    const json* const range = info.need(d, "", "pose-range", kObject);
    for (const char* const key : {"start-timestamp_us", "end-timestamp_us"})
      info.need(range, "pose-range", key, kNumber);
    check_rig(&report_.carla, /*carla=*/true);
    check_tracks(&report_.carla, /*carla=*/true);
    if (!has(kMap)) report_.carla.push_back({kMap, "", "is missing: CARLA's world is made of it"});
  }

  void check_rig(std::vector<BundleGap>* gaps, bool carla) {
    FieldCheck check(kRigTrajectories, gaps);
    const json* const rig = content(rig_, &check);
    if (carla || has(kMap)) check.need(rig, "", "T_world_base", kMatrix);
    const json* const cameras = check.need(rig, "", "camera_calibrations", kObject);
    if (!carla)
      check.need(check.need(rig, "", "world_to_nre", kObject), "world_to_nre", "matrix", kMatrix);
    if (cameras && cameras->empty()) check.miss("camera_calibrations", "has no camera");
    if (cameras)
      for (const auto& [id, camera] : cameras->items())
        check_camera("camera_calibrations." + id, camera, carla, &check);
    const json* const list = check.need(rig, "", "rig_trajectories", kList);
    if (!list) return;
    if (list->empty() || (!carla && list->size() != 1))
      return check.miss("rig_trajectories",
                        "has " + std::to_string(list->size()) + " entries, one is needed");
    check_trajectory(list->at(0), cameras, carla, &check);
  }

  static void check_camera(const std::string& where, const json& camera, bool carla,
                           FieldCheck* check) {
    check->need(&camera, where, "logical_sensor_name", kText);
    if (!carla) return;
    check->need(&camera, where, "sequence_id", kAny);
    check->need(&camera, where, "unique_sensor_idx", kAny);
    check->need(&camera, where, "T_sensor_rig", kMatrix);
    const json* const model = check->need(&camera, where, "camera_model", kObject);
    check->need(model, where + ".camera_model", "type", kText);
    const json* const parameters =
        check->need(model, where + ".camera_model", "parameters", kObject);
    for (const char* const key : {"resolution", "shutter_type", "external_distortion_parameters",
                                  "principal_point", "reference_poly", "pixeldist_to_angle_poly",
                                  "angle_to_pixeldist_poly", "max_angle", "linear_cde"})
      check->need(parameters, where + ".camera_model.parameters", key, kAny);
  }

  static void check_trajectory(const json& trajectory, const json* cameras, bool carla,
                               FieldCheck* check) {
    const std::string where = "rig_trajectories[0]";
    const json* const poses = check->need(&trajectory, where, "T_rig_worlds", kList);
    const json* const times = check->need(&trajectory, where, "T_rig_world_timestamps_us", kList);
    if (poses && times && poses->size() != times->size())
      check->miss(where + ".T_rig_worlds", "has " + std::to_string(poses->size()) + " poses for " +
                                               std::to_string(times->size()) +
                                               " T_rig_world_timestamps_us");
    if (poses && poses->empty()) check->miss(where + ".T_rig_worlds", "is empty");
    if (poses)
      for (std::size_t i = 0; i < poses->size(); ++i)
        if (!is_kind((*poses)[i], kMatrix)) {
          check->miss(where + ".T_rig_worlds[" + std::to_string(i) + "]", "is no 4 x 4 matrix");
          break;
        }
    if (carla) return;
    check->need(&trajectory, where, "sequence_id", kText);
    const json* const frames =
        check->need(&trajectory, where, "cameras_frame_timestamps_us", kObject);
    if (!frames) return;
    for (const auto& [id, ranges] : frames->items()) {
      const std::string of = where + ".cameras_frame_timestamps_us." + id;
      if (cameras && !cameras->contains(id)) check->miss(of, "is not among camera_calibrations");
      const bool good = ranges.is_array() && std::ranges::all_of(ranges, [](const json& range) {
                          return range.is_array() && range.size() >= 2 &&
                                 range[0].is_number_integer() && range[1].is_number_integer() &&
                                 range[1].get<double>() > range[0].get<double>();
                        });
      if (!good)
        check->miss(of, "must be pairs of whole microseconds, the end after the start");
      else if (ranges.empty())
        check->miss(of, "is empty: no frame can begin a rollout");
    }
  }

  void check_tracks(std::vector<BundleGap>* gaps, bool carla) {
    FieldCheck check(kSequenceTracks, gaps);
    const json* const tracks = content(tracks_, &check);
    if (!tracks) return;
    if (!carla && (!tracks->is_object() || tracks->size() != 1))
      return check.miss("", "must be an object with one entry");
    const std::string chunk =
        carla || tracks->contains(kTracksKey) ? kTracksKey : tracks->items().begin().key();
    const json* const part = check.need(tracks, "", chunk.c_str(), kObject);
    const json* const data = check.need(part, chunk, "tracks_data", kObject);
    const json* const cuboids = check.need(part, chunk, "cuboidtracks_data", kObject);
    const std::string in_data = chunk + ".tracks_data";
    const json* const ids = check.need(data, in_data, "tracks_id", kList);
    const json* const sizes =
        check.need(cuboids, chunk + ".cuboidtracks_data", "cuboids_dims", kList);
    if (ids && sizes && sizes->size() != ids->size())
      check.miss(chunk + ".cuboidtracks_data.cuboids_dims", "is not as long as tracks_id");
    const json *times = nullptr, *poses = nullptr;
    for (const char* const key :
         {"tracks_label_class", "tracks_flags", "tracks_timestamps_us", "tracks_poses"}) {
      const json* const list = check.need(data, in_data, key, kList);
      if (ids && list && list->size() != ids->size())
        return check.miss(in_data + "." + key, "is not as long as tracks_id");
      if (key == std::string_view("tracks_timestamps_us")) times = list;
      if (key == std::string_view("tracks_poses")) poses = list;
    }
    if (!ids || !times || !poses) return;
    for (std::size_t i = 0; i < ids->size(); ++i) {
      const json& own = (*poses)[i];
      const bool good = own.is_array() && (*times)[i].is_array() &&
                        own.size() == (*times)[i].size() && !own.empty() &&
                        std::ranges::all_of(own, [](const json& pose) {
                          return pose.is_array() && pose.size() == 7;
                        });
      if (!good)
        check.miss(in_data + ".tracks_poses[" + std::to_string(i) + "]",
                   "must have a pose [x, y, z, qx, qy, qz, qw] for each time");
    }
  }

  void check_map() {
    std::string why;
    const auto text = text_of(kMap, &why);
    const bool other_map = std::ranges::any_of(report_.members, [](const auto& member) {
      return member.name.starts_with("clipgt/") || member.name.starts_with("map_data/");
    });
    if (!text) {
      if (has(kMap))
        report_.carla.push_back({kMap, "", why});
      else if (!other_map)
        report_.remarks.push_back(
            {kMap, "", "is missing; AlpaSim needs route_generator_type RECORDED or NONE then"});
      return;
    }
    pugi::xml_document document;
    const auto parsed = document.load_buffer(text->data(), text->size());
    const pugi::xml_node map = document.child("OpenDRIVE");
    if (!parsed || !map) {
      const char* const what = parsed ? "is no OpenDRIVE" : parsed.description();
      report_.carla.push_back({kMap, "", what});
      report_.alpasim.push_back({kMap, "", what});
      return;
    }
    if (!map.child("road")) report_.carla.push_back({kMap, "road", "is missing"});
    const std::string place = map.child("header").child("geoReference").text().get();
    if (place.empty())
      report_.remarks.push_back(
          {kMap, "header.geoReference", "is missing: the map must lie in the scene's world"});
    else
      for (const char* const word : {"+lat_0=", "+lon_0=", "+=alt_0="})
        if (place.find(word) == place.npos)
          report_.remarks.push_back(
              {kMap, "header.geoReference",
               std::string("has no ") + word + ": CARLA takes the map for the scene's world then"});
  }

  void check_ids() {
    const auto id_in = [](const ReadMember& member, const char* key) -> std::string {
      if (!member.value || !member.value->is_object() || !member.value->contains(key)) return "";
      const json& id = member.value->at(key);
      return printable(id.is_string() ? id.get<std::string>()
                                      : id.dump(-1, ' ', false, json::error_handler_t::replace));
    };
    const std::string scene = id_in(metadata_, "scene_id"), sequence = id_in(info_, "sequence_id");
    report_.scene_id = scene.empty() ? sequence : scene;
    if (!scene.empty() && !sequence.empty() && scene != sequence)
      report_.remarks.push_back({kDataInfo, "sequence_id",
                                 "is " + sequence + ", scene_id of " + kMetadata + " is " + scene +
                                     ": the service has to know both"});
  }

  fs::path file_;
  ZipFile zip_;
  ReadMember metadata_, info_, rig_, tracks_;
  BundleReport report_;
};

}  // namespace

BundleReport check_bundle(const fs::path& file) { return BundleCheck(file).report(); }

}  // namespace redrive
