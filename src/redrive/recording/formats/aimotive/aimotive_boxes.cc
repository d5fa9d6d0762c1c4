// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/aimotive/aimotive_boxes.h"

#include <charconv>
#include <cmath>
#include <set>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/json_field.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::aimotive {
namespace {

constexpr double kMinSize_m = 0.01, kMaxSize_m = 100;  // road trains are 50 m long
constexpr double kMaxDistance_m = 1e4;
constexpr double kMaxSpeed_m_per_s = 300;  // two cars in opposite directions
const std::string kOrientation = "BoundingBox3D Orientation Quat";

/// Reads "<name> X", "<name> Y" and "<name> Z".
Eigen::Vector3d vector_from_json(const JsonField& object, const std::string& name, double least,
                                 double most) {
  Eigen::Vector3d vector;
  for (int axis = 0; axis < 3; ++axis) {
    const JsonField field = object.at(name + " " + "XYZ"[axis]);
    vector[axis] = field.number();
    if (!(vector[axis] >= least && vector[axis] <= most)) {
      char rule[64];
      std::snprintf(rule, sizeof rule, "must be between %g and %g", least, most);
      field.fail(rule);
    }
  }
  return vector;
}

Eigen::Quaterniond rotation_from_json(const JsonField& object) {
  const Eigen::Vector3d xyz = vector_from_json(object, kOrientation, -2, 2);
  const JsonField w = object.at(kOrientation + " W");
  const Eigen::Quaterniond rotation(w.number(), xyz.x(), xyz.y(), xyz.z());
  if (!is_rotation(rotation))
    throw InputError(object.file(), object.field() + "." + kOrientation,
                     "norm " + std::to_string(rotation.norm()),
                     "must be a rotation, of any length but 0");
  return rotation.normalized();
}

std::int64_t t_ns_from_json(const JsonField& field) {
  const std::string digits = field.string();
  std::int64_t t_ns = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), t_ns);
  if (error != std::errc() || end != digits.data() + digits.size())
    field.fail("a text of whole nanoseconds was expected");
  return t_ns;
}

}  // namespace

std::vector<Box> parse_boxes(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  const std::int64_t t_ns = t_ns_from_json(root.at("Timestamp"));
  const JsonField objects = root.at("CapturedObjects");
  if (!objects.json().is_array()) objects.fail("an array was expected");
  std::vector<Box> boxes;
  std::set<std::int64_t> ids;
  for (std::size_t i = 0; i < objects.size(); ++i) {
    const JsonField object = objects.at(i);
    Box box;
    box.object_id = object.at("ObjectId").integer();
    if (box.object_id < 0)  // ids below 0 belong to found objects (perception/find_moving.h)
      object.at("ObjectId").fail("must be 0 or above");
    if (!ids.insert(box.object_id).second)
      object.at("ObjectId").fail("a second box of this object");
    box.type = object.at("ObjectType").string();
    box.actor_name = object.at("ActorName").string();
    box.t_ns = t_ns;
    box.body_from_box = Rigid3d::Identity();
    box.body_from_box.linear() = rotation_from_json(object).toRotationMatrix();
    box.body_from_box.translation() =
        vector_from_json(object, "BoundingBox3D Origin", -kMaxDistance_m, kMaxDistance_m);
    box.size_m = vector_from_json(object, "BoundingBox3D Extent", kMinSize_m, kMaxSize_m);
    box.velocity_in_body_m_per_s =
        vector_from_json(object, "Relative Velocity", -kMaxSpeed_m_per_s, kMaxSpeed_m_per_s);
    boxes.push_back(std::move(box));
  }
  return boxes;
}

std::vector<Box> read_boxes(const std::filesystem::path& file) {
  return parse_boxes(read_file(file), file);
}

nlohmann::json boxes_to_json(std::int64_t t_ns, const std::vector<Box>& boxes) {
  nlohmann::json objects = nlohmann::json::array();
  for (const Box& box : boxes) {
    nlohmann::json object = {{"ObjectId", box.object_id},
                             {"ObjectType", box.type},
                             {"ActorName", box.actor_name},
                             {"Occluded", 0},
                             {"Truncated", 0}};
    const Eigen::Quaterniond rotation(box.body_from_box.linear());
    object[kOrientation + " W"] = rotation.w();
    for (int axis = 0; axis < 3; ++axis) {
      const std::string end = std::string(" ") + "XYZ"[axis];
      object[kOrientation + end] = rotation.vec()[axis];
      object["BoundingBox3D Origin" + end] = box.body_from_box.translation()[axis];
      object["BoundingBox3D Extent" + end] = box.size_m[axis];
      object["Relative Velocity" + end] = box.velocity_in_body_m_per_s[axis];
    }
    objects.push_back(std::move(object));
  }
  return {{"Timestamp", std::to_string(t_ns)}, {"CapturedObjects", std::move(objects)}};
}

}  // namespace redrive::aimotive
