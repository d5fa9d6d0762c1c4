// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/kitti/kitti_boxes.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <set>

#include "redrive/base/error.h"
#include "redrive/recording/parse/text_lines.h"
#include "redrive/recording/parse/xml_element.h"

namespace redrive::kitti {
namespace {

constexpr double kMinSize_m = 0.01, kMaxSize_m = 100;
constexpr double kMaxLabelDistance_m = 1000;
constexpr double kMaxAngle_rad = 10;  // some files have turns beyond pi
constexpr std::int64_t kMaxId = 1'000'000'000;
constexpr std::size_t kMaxPoses = 1'000'000;

constexpr std::array kTypes = {"Car",    "Van",     "Truck", "Pedestrian", "Person_sitting",
                               "Person", "Cyclist", "Tram",  "Misc",       "Person (sitting)"};

bool known_type(std::string_view type) { return std::ranges::find(kTypes, type) != kTypes.end(); }

constexpr const char* kTypeRule =
    "unknown; known are Car, Van, Truck, Pedestrian, Person_sitting, Person, Cyclist, Tram, Misc "
    "and DontCare";

/// InputError if an object has two labels in a frame.
class SeenOnce {
 public:
  bool insert(const Label& label) { return seen_.emplace(label.frame_id, label.object_id).second; }

 private:
  std::set<std::pair<std::int64_t, std::int64_t>> seen_;
};

}  // namespace

std::vector<Label> parse_labels(std::string_view text, const std::filesystem::path& file) {
  // Axes of a box whose rotation_y is 0: forward, left and up are x, z and -y of the camera.
  const Eigen::Matrix3d camera_from_level =
      (Eigen::Matrix3d() << 1, 0, 0, 0, 0, -1, 0, 1, 0).finished();
  std::vector<Label> labels;
  SeenOnce seen;
  for (const TextLine& line : text_lines(text, file)) {
    if (line.size() == 0) continue;
    if (line.size() != 18)
      line.expect_size(17,
                       "frame, track, type, truncated, occluded, alpha, 4 of the box in the "
                       "image, 3 sizes, 3 positions, rotation_y");
    Label label;
    label.frame_id = line.integer(0, "frame", 0, kMaxId);
    label.type = line.word(2);
    if (label.type == "DontCare") continue;
    if (!known_type(label.type)) line.fail(2, "type", kTypeRule);
    label.object_id = line.integer(1, "track", 0, kMaxId);
    label.size_m.z() = line.number(10, "height", kMinSize_m, kMaxSize_m);
    label.size_m.y() = line.number(11, "width", kMinSize_m, kMaxSize_m);
    label.size_m.x() = line.number(12, "length", kMinSize_m, kMaxSize_m);
    Eigen::Vector3d bottom;
    for (int axis = 0; axis < 3; ++axis)
      bottom[axis] = line.number(13 + static_cast<std::size_t>(axis), std::string(1, "xyz"[axis]),
                                 -kMaxLabelDistance_m, kMaxLabelDistance_m);
    const double angle_rad = line.number(16, "rotation_y", -kMaxAngle_rad, kMaxAngle_rad);
    label.sensor_from_box = Rigid3d::Identity();
    label.sensor_from_box.linear() =
        Eigen::AngleAxisd(angle_rad, Eigen::Vector3d::UnitY()) * camera_from_level;
    label.sensor_from_box.translation() = bottom - Eigen::Vector3d(0, label.size_m.z() / 2, 0);
    if (!seen.insert(label)) line.fail(1, "track", "a second label of this object in its frame");
    labels.push_back(std::move(label));
  }
  return labels;
}

std::vector<Label> parse_tracklets(std::string_view text, const std::filesystem::path& file) {
  const XmlDocument document(text, file);
  const XmlElement root = document.root("boost_serialization");
  std::vector<Label> labels;
  std::int64_t object_id = 0;
  for (const XmlElement& tracklet : root.child("tracklets").children("item")) {
    Label label;
    label.object_id = object_id++;
    label.type = tracklet.child("objectType").text();
    if (!known_type(label.type)) tracklet.child("objectType").fail(kTypeRule);
    label.size_m = {tracklet.child("l").number(kMinSize_m, kMaxSize_m),
                    tracklet.child("w").number(kMinSize_m, kMaxSize_m),
                    tracklet.child("h").number(kMinSize_m, kMaxSize_m)};
    label.frame_id = tracklet.child("first_frame").integer(0, kMaxId);
    for (const XmlElement& pose : tracklet.child("poses").children("item")) {
      const auto number = [&](const char* name, double most) {
        return pose.child(name).number(-most, most);
      };
      label.sensor_from_box =
          Eigen::Translation3d(number("tx", kMaxLabelDistance_m), number("ty", kMaxLabelDistance_m),
                               number("tz", kMaxLabelDistance_m)) *
          Eigen::AngleAxisd(number("rz", kMaxAngle_rad), Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(number("ry", kMaxAngle_rad), Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(number("rx", kMaxAngle_rad), Eigen::Vector3d::UnitX()) *
          Eigen::Translation3d(0, 0, label.size_m.z() / 2);
      if (labels.size() >= kMaxPoses)
        throw InputError(file, "tracklets", "", "hold more than a million poses");
      labels.push_back(label);
      ++label.frame_id;
    }
  }
  return labels;
}

TimeOfLabel time_in_scans(const Rigid3d& velodyne_from_sensor,
                          std::map<std::int64_t, ScanTime> scans) {
  return
      [velodyne_from_sensor, scans = std::move(scans)](const Label& label, const FramePose& frame) {
        const auto scan = scans.find(frame.id);
        if (scan == scans.end()) return frame.t_ns;
        return time_of_direction(scan->second,
                                 velodyne_from_sensor * label.sensor_from_box.translation());
      };
}

}  // namespace redrive::kitti
