// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti360/kitti360_boxes.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cstdio>
#include <map>
#include <optional>

#include "redrive/recording/parse/xml_element.h"

namespace redrive::kitti360 {
namespace {

constexpr double kMinSize_m = 0.01, kMaxSize_m = 100;
constexpr double kMaxRadius_m = 1e7;
constexpr double kSkew = 0.05;  // skew of annotators' axes: sine of the angle off a right one
constexpr std::int64_t kMaxId = 1'000'000'000;
constexpr std::size_t kMaxVertices = 10'000, kMaxObjects = 1'000'000;
// Ids of objects without instances.
constexpr std::int64_t kStaticIds = 1'000'000, kDynamicIds = 2'000'000;
constexpr std::int64_t kInstances = 1000;  // instances of a label

// helpers/labels.py of the data set's scripts.
constexpr std::array kClasses = {
    ObjectClass{36, 43, "unknown vehicle"}, ObjectClass{13, 26, "car"},
    ObjectClass{14, 27, "truck"},           ObjectClass{34, 28, "bus"},
    ObjectClass{16, 29, "caravan"},         ObjectClass{15, 30, "trailer"},
    ObjectClass{33, 31, "train"},           ObjectClass{17, 32, "motorcycle"},
    ObjectClass{18, 33, "bicycle"},         ObjectClass{19, 24, "person", true},
    ObjectClass{20, 25, "rider", true},
};

/// Names of other data sets, in lower case.
constexpr std::array<std::array<std::string_view, 2>, 13> kSynonyms = {
    {{"van", "car"},
     {"pedestrian", "person"},
     {"person_sitting", "person"},
     {"person (sitting)", "person"},
     {"cyclist", "rider"},
     {"tram", "train"},
     {"truck/bus", "truck"},
     {"motorbike", "motorcycle"},
     {"bike", "bicycle"},
     {"trolley", "trailer"},
     {"human", "person"},
     {"pickup", "car"},
     {"suv", "car"}}};

struct Identity {
  std::int64_t id = 0;
  std::string type;
};

/// Returns nothing for a standing object that is neither a vehicle nor a person.
std::optional<Identity> identity_of(const XmlElement& object, bool moves,
                                    std::int64_t number_in_file) {
  if (object.has("semanticId")) {
    const auto semantic = static_cast<int>(object.child("semanticId").integer(-1, 1000));
    const ObjectClass* what = find_class(semantic);
    if (!what && !moves) return std::nullopt;
    const std::int64_t label = what ? what->label_id : kInstances + semantic;
    return Identity{kInstances * label + object.child("instanceId").integer(0, kInstances - 1),
                    what ? std::string(what->name) : "class " + std::to_string(semantic)};
  }
  const std::string label = object.child("label").text();
  const auto what = std::ranges::find(kClasses, label, &ObjectClass::name);
  if (what == kClasses.end() && !moves) return std::nullopt;
  return Identity{moves ? kDynamicIds + object.child("dynamicSeq").integer(0, kMaxId)
                        : kStaticIds + number_in_file,
                  label};
}

/// Sets world_from_box and size_m.
void read_box(const XmlElement& element, Object* object) {
  const XmlElement transform = element.child("transform");
  const std::vector<double> m = transform.matrix(4, 4);
  if (m.size() != 16) transform.fail("4 rows are expected");
  const std::vector<double> vertices = element.child("vertices").matrix(3, kMaxVertices);
  Eigen::AlignedBox3d bounds;
  for (std::size_t i = 0; i < vertices.size(); i += 3)
    bounds.extend(Eigen::Vector3d(vertices[i], vertices[i + 1], vertices[i + 2]));
  Eigen::Matrix3d axes;
  axes << m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10];
  const Eigen::Vector3d origin(m[3], m[7], m[11]);
  const Eigen::Vector3d scale = axes.colwise().norm();
  object->size_m = scale.cwiseProduct(bounds.sizes());
  if (!(object->size_m.minCoeff() >= kMinSize_m && object->size_m.maxCoeff() <= kMaxSize_m))
    transform.fail("the sides of the box must be between 0.01 and 100 m");
  Eigen::Matrix3d rotation = axes * scale.cwiseInverse().asDiagonal();
  if (rotation.determinant() < 0) rotation.col(1) *= -1;  // a box is its own mirror image
  if (!((rotation.transpose() * rotation - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() <=
        kSkew))
    transform.fail("the axes of the box are not perpendicular");
  const Eigen::Vector3d center = origin + axes * bounds.center();
  if (!(center.norm() <= kMaxRadius_m)) transform.fail("places the box further than 1e7 m away");
  object->world_from_box = Rigid3d::Identity();
  object->world_from_box.linear() = Eigen::Quaterniond(rotation).normalized().toRotationMatrix();
  object->world_from_box.translation() = center;
}

void add_matrix(const char* name, int rows, int cols, char type, const std::string& numbers,
                std::string* text) {
  *text += std::string("  <") + name + " type_id=\"opencv-matrix\">\n    <rows>" +
           std::to_string(rows) + "</rows>\n    <cols>" + std::to_string(cols) +
           "</cols>\n    <dt>" + type + "</dt>\n    <data>\n      " + numbers + "</data></" + name +
           ">\n";
}

void add_element(const char* name, const std::string& value, std::string* text) {
  *text += std::string("  <") + name + ">" + value + "</" + name + ">\n";
}

// Corners and triangles in the order of the data set.
constexpr const char* kUnitCube =
    "5.e-01 5.e-01 5.e-01 5.e-01 5.e-01 -5.e-01 5.e-01 -5.e-01 5.e-01 5.e-01 -5.e-01 -5.e-01 "
    "-5.e-01 5.e-01 -5.e-01 -5.e-01 5.e-01 5.e-01 -5.e-01 -5.e-01 -5.e-01 -5.e-01 -5.e-01 5.e-01";
constexpr const char* kTriangles =
    "0 2 1 2 3 1 4 6 5 6 7 5 4 5 1 5 0 1 7 6 2 6 3 2 5 7 0 7 2 0 1 3 4 3 6 4";

}  // namespace

const ObjectClass* find_class(int semantic_id) {
  const auto found = std::ranges::find(kClasses, semantic_id, &ObjectClass::semantic_id);
  return found == kClasses.end() ? nullptr : &*found;
}

const ObjectClass& class_named(std::string_view name) {
  std::string lower(name);
  std::ranges::transform(lower, lower.begin(), [](unsigned char c) { return std::tolower(c); });
  // prefix of nuScenes' names, as in "vehicle.bus.rigid"
  constexpr std::string_view kVehicle = "vehicle.";
  if (lower.starts_with(kVehicle)) {
    lower.erase(0, kVehicle.size());
    lower.resize(std::min(lower.find('.'), lower.size()));
  }
  if (lower.starts_with("human.") || lower.starts_with("animal")) lower = "person";
  for (const auto& [other, ours] : kSynonyms)
    if (lower == other) lower = ours;
  const auto found = std::ranges::find(kClasses, lower, &ObjectClass::name);
  return found != kClasses.end() ? *found : kClasses[0];
}

std::vector<Object> parse_objects(std::string_view text, const std::filesystem::path& file) {
  const XmlDocument document(text, file);
  const XmlElement root = document.root("opencv_storage");
  std::map<std::pair<std::int64_t, std::int64_t>, Object> objects;  // key: id and frame
  std::int64_t number = 0;
  for (const XmlElement& element : root.children()) {
    if (!element.has("transform")) continue;
    if (objects.size() >= kMaxObjects) root.fail("holds more than a million boxes");
    Object object;
    object.frame_id = element.child("timestamp").integer(kStatic, kMaxId);
    const std::optional<Identity> identity =
        identity_of(element, object.frame_id != kStatic, number++);
    if (!identity) continue;
    object.id = identity->id;
    object.type = identity->type;
    object.first_frame =
        element.has("start_frame") ? element.child("start_frame").integer(kStatic, kMaxId) : 0;
    object.last_frame =
        element.has("end_frame") ? element.child("end_frame").integer(kStatic, kMaxId) : kMaxId;
    read_box(element, &object);
    objects[{object.id, object.frame_id}] = std::move(object);
  }
  std::vector<Object> all;
  for (auto& [key, object] : objects) all.push_back(std::move(object));
  return all;
}

std::string make_objects(const std::vector<Object>& objects) {
  std::string text = "<?xml version=\"1.0\"?>\n<opencv_storage>\n";
  int index = 0;
  for (const Object& object : objects) {
    const ObjectClass& what = class_named(object.type);
    const std::string element = "object" + std::to_string(++index);
    text += "<" + element + ">\n";
    add_element("index", std::to_string(index), &text);
    add_element("label", std::string(what.name), &text);
    add_element("category", what.is_human ? "human" : "vehicle", &text);
    add_element("dynamic", object.frame_id == kStatic ? "0" : "1", &text);
    add_element("timestamp", std::to_string(object.frame_id), &text);
    add_element("start_frame", std::to_string(object.first_frame), &text);
    add_element("end_frame", std::to_string(object.last_frame), &text);
    add_element("semanticId", std::to_string(what.semantic_id), &text);
    add_element("instanceId", std::to_string(object.id % kInstances), &text);
    std::string numbers;
    Eigen::Matrix4d transform = object.world_from_box.matrix();
    transform.topLeftCorner<3, 3>() *= object.size_m.asDiagonal();
    for (int i = 0; i < 16; ++i) {
      char word[40];
      std::snprintf(word, sizeof word, "%.17g ", transform(i / 4, i % 4));
      numbers += word;
    }
    add_matrix("transform", 4, 4, 'd', numbers, &text);
    add_matrix("vertices", 8, 3, 'f', kUnitCube, &text);
    add_matrix("faces", 12, 3, 'u', kTriangles, &text);
    text += "</" + element + ">\n";
  }
  return text + "</opencv_storage>\n";
}

}  // namespace redrive::kitti360
