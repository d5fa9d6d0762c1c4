// SPDX-License-Identifier: Apache-2.0
#include "redrive/perception/moving_file.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/math/angles.h"
#include "redrive/recording/parse/json_numbers.h"

namespace redrive {
namespace {

constexpr double kMaxWorld_m = 1e6, kMaxSize_m = 1000;
constexpr std::int64_t kMaxTime_ns = 4'000'000'000'000'000'000;
constexpr std::size_t kMaxObjects = 100'000, kMaxKeys = 1'000'000;

MovingObject object_from_json(const JsonField& json) {
  MovingObject object;
  object.type = kFound;
  object.id = json.at("id").integer();
  if (object.id >= 0) json.at("id").fail("expected an id below 0; others are annotated objects");
  const auto size =
      numbers_within<3>(json.at("size_m"), 0, kMaxSize_m, "expected three metres, 0 to 1000");
  object.size_m = Eigen::Vector3d(size.data());
  const JsonField keys = json.at("keys");
  if (!keys.json().is_array() || keys.size() == 0 || keys.size() > kMaxKeys)
    keys.fail("expected a list of 1 to 1000000 keys");
  for (std::size_t k = 0; k < keys.size(); ++k) {
    const JsonField entry = keys.at(k);
    MovingObject::Key key{entry.at("t_ns").integer(), Rigid3d::Identity(), Eigen::Vector3d::Zero()};
    if (key.t_ns < 0 || key.t_ns > kMaxTime_ns)
      entry.at("t_ns").fail("expected nanoseconds, 0 to 4e18");
    if (k > 0 && key.t_ns <= object.keys.back().t_ns)
      entry.at("t_ns").fail("expected times that increase");
    const auto position = numbers_within<3>(entry.at("position_m"), -kMaxWorld_m, kMaxWorld_m,
                                            "expected three metres, at most 1e6");
    key.world_from_box.translation() = Eigen::Vector3d(position.data());
    const double yaw_rad = kRadiansPerDegree * number_within(entry.at("yaw_deg"), -360, 360,
                                                             "expected -360 to 360 degrees");
    key.world_from_box.linear() = Eigen::AngleAxisd(yaw_rad, Eigen::Vector3d::UnitZ()).matrix();
    object.keys.push_back(key);
  }
  set_velocities(&object);
  return object;
}

/// Rounds yaws to 1e-9 degrees, so that reading and writing again gives the same text.
std::string moving_file_text(const std::vector<MovingObject>& objects) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const MovingObject& object : objects) {
    nlohmann::ordered_json keys = nlohmann::ordered_json::array();
    for (const MovingObject::Key& key : object.keys) {
      const Eigen::Vector3d at = key.world_from_box.translation(),
                            ahead = key.world_from_box.linear().col(0);
      const double yaw_deg = kDegreesPerRadian * std::atan2(ahead.y(), ahead.x());
      keys.push_back({{"t_ns", key.t_ns},
                      {"position_m", {at.x(), at.y(), at.z()}},
                      {"yaw_deg", std::round(yaw_deg * 1e9) / 1e9}});
    }
    const Eigen::Vector3d& size = object.size_m;
    list.push_back({{"id", object.id}, {"size_m", {size.x(), size.y(), size.z()}}, {"keys", keys}});
  }
  return nlohmann::ordered_json{{"objects", list}}.dump(1) + "\n";
}

}  // namespace

void set_velocities(MovingObject* object) {
  std::vector<MovingObject::Key>& keys = object->keys;
  for (std::size_t k = 0; k < keys.size(); ++k) {
    const MovingObject::Key &from = keys[k - std::min<std::size_t>(k, 2)],
                            &to = keys[std::min(k + 2, keys.size() - 1)];
    const double seconds = 1e-9 * static_cast<double>(to.t_ns - from.t_ns);
    keys[k].velocity_in_world_m_per_s.setZero();
    if (seconds > 0)
      keys[k].velocity_in_world_m_per_s =
          (to.world_from_box.translation() - from.world_from_box.translation()) / seconds;
  }
}

std::vector<MovingObject> parse_moving_objects(std::string_view text,
                                               const std::filesystem::path& file) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField list = JsonField(document, file).at("objects");
  if (!list.json().is_array() || list.size() > kMaxObjects)
    list.fail("expected a list of at most 100000 objects");
  std::vector<MovingObject> objects;
  std::set<std::int64_t> ids;
  for (std::size_t i = 0; i < list.size(); ++i) {
    objects.push_back(object_from_json(list.at(i)));
    if (!ids.insert(objects.back().id).second)
      list.at(i).at("id").fail("expected an id that no other object has");
  }
  return objects;
}

std::filesystem::path moving_file(const std::filesystem::path& masks) {
  return masks / "moving.json";
}

std::vector<MovingObject> read_moving_file(const std::filesystem::path& file) {
  if (!file_bytes(file)) return {};
  return parse_moving_objects(read_file(file), file);
}

std::vector<MovingObject> as_in_moving_file(const std::vector<MovingObject>& objects) {
  return parse_moving_objects(moving_file_text(objects), "moving.json");
}

void write_moving_file(const std::filesystem::path& file,
                       const std::vector<MovingObject>& objects) {
  write_file(file, moving_file_text(objects));
}

}  // namespace redrive
