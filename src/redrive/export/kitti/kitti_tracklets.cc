// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/kitti/kitti_tracklets.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <set>
#include <sstream>
#include <tuple>

#include <pugixml.hpp>

#include "redrive/export/kitti/kitti_parts.h"
#include "redrive/math/angles.h"
#include "redrive/recording/formats/kitti360/kitti360_boxes.h"

namespace redrive::kitti {
namespace {

using Tracklet = std::vector<Label>;  ///< one object in consecutive frames

std::vector<Tracklet> cut_into_tracklets(std::vector<Label> labels) {
  std::ranges::stable_sort(
      labels, {}, [](const Label& label) { return std::pair(label.object_id, label.frame_id); });
  std::vector<Tracklet> tracklets;
  for (Label& label : labels) {
    const Label* const before = tracklets.empty() ? nullptr : &tracklets.back().back();
    if (!before || before->object_id != label.object_id || before->frame_id + 1 != label.frame_id ||
        before->type != label.type || before->size_m != label.size_m)
      tracklets.emplace_back();
    tracklets.back().push_back(std::move(label));
  }
  return tracklets;
}

void add(pugi::xml_node parent, const char* name, const std::string& text) {
  parent.append_child(name).text() = text.c_str();
}
void add(pugi::xml_node parent, const char* name, double value) {
  add(parent, name, formatted("%.17g", value));
}

/// Attributes of boost's archives, at the first element of each class.
void mark_class(pugi::xml_node node, int id) {
  constexpr std::array kVersions = {0, 1, 0, 2};
  node.append_attribute("class_id") = id;
  node.append_attribute("tracking_level") = 0;
  node.append_attribute("version") = kVersions[static_cast<std::size_t>(id)];
}

void add_pose(pugi::xml_node item, const Label& label) {
  const Eigen::Vector3d bottom =
      label.sensor_from_box * Eigen::Vector3d(0, 0, -label.size_m.z() / 2);
  add(item, "tx", bottom.x());
  add(item, "ty", bottom.y());
  add(item, "tz", bottom.z());
  const Eigen::Vector3d angles = roll_pitch_yaw(label.sensor_from_box.linear());
  for (int k = 0; k < 3; ++k) add(item, std::array{"rx", "ry", "rz"}[std::size_t(k)], angles[k]);
  add(item, "state", "1");  // interpolated: no annotator set it
  // The devkit's order and types; 99 is unset for parseTrackletXML.py, which refuses -1 here.
  add(item, "occlusion", "-1");
  add(item, "occlusion_kf", "0");
  add(item, "truncation", "99");
  for (const char* name :
       {"amt_occlusion", "amt_occlusion_kf", "amt_border_l", "amt_border_r", "amt_border_kf"})
    add(item, name, "-1");
}

}  // namespace

std::string type_of(const std::string& type) {
  constexpr std::array kOwn = {"Car",     "Van",  "Truck", "Pedestrian", "Person (sitting)",
                               "Cyclist", "Tram", "Misc"};
  const auto lower = [](std::string_view text) {
    std::string out(text);
    std::ranges::transform(out, out.begin(), [](unsigned char c) { return std::tolower(c); });
    return out;
  };
  for (const char* const own : kOwn)
    if (lower(own) == lower(type)) return own;
  if (type == "Person_sitting") return "Person (sitting)";
  const std::string_view named = kitti360::class_named(type).name;
  for (const auto& [ours, theirs] :
       {std::pair("car", "Car"), std::pair("truck", "Truck"), std::pair("train", "Tram"),
        std::pair("person", "Pedestrian"), std::pair("rider", "Cyclist"),
        std::pair("bicycle", "Cyclist"), std::pair("motorcycle", "Cyclist")})
    if (named == ours) return theirs;
  return "Misc";
}

std::vector<Label> tracklets_of(const Recording& drive, const std::vector<FramePose>& frames,
                                std::int64_t earlier_ids, const Rigid3d& body_from_velodyne,
                                const std::map<std::int64_t, ScanTime>& scans, DriveNotes* notes) {
  constexpr int kIterations = 4;  // the car moves far less than objects are away
  std::set<std::string> renamed;
  std::vector<Label> labels;
  for (const FrameFile& file : drive.box_files) {
    const std::int64_t id = file.frame_id - earlier_ids;
    const auto frame = std::ranges::lower_bound(frames, id, {}, &FramePose::id);
    if (frame == frames.end() || frame->id != id) continue;
    const auto scan = scans.find(id);
    for (const Box& box : drive.reader->read_boxes(file)) {
      Label label;
      label.frame_id = id;
      label.object_id = box.object_id;
      label.type = type_of(box.type);
      if (label.type != box.type) renamed.insert(box.type + " as " + label.type);
      label.size_m = box.size_m;
      std::int64_t t_ns = frame->t_ns;
      for (int i = 0; i < kIterations; ++i) {
        label.sensor_from_box =
            (pose_at(frames, t_ns) * body_from_velodyne).inverse(Eigen::Isometry) *
            global_from_box_at(box, drive.frames, t_ns);
        if (scan == scans.end()) break;
        t_ns = time_of_direction(scan->second, label.sensor_from_box.translation());
      }
      labels.push_back(std::move(label));
    }
  }
  for (const std::string& names : renamed) notes->changed.push_back("boxes of type " + names);
  return labels;
}

std::string make_tracklets(std::vector<Label> labels) {
  const std::vector<Tracklet> tracklets = cut_into_tracklets(std::move(labels));
  pugi::xml_document document;
  pugi::xml_node declaration = document.append_child(pugi::node_declaration);
  declaration.append_attribute("version") = "1.0";
  declaration.append_attribute("encoding") = "UTF-8";
  document.append_child(pugi::node_doctype).set_value("boost_serialization");
  pugi::xml_node root = document.append_child("boost_serialization");
  root.append_attribute("signature") = "serialization::archive";
  root.append_attribute("version") = 9;
  pugi::xml_node list = root.append_child("tracklets");
  mark_class(list, 0);
  add(list, "count", std::to_string(tracklets.size()));
  add(list, "item_version", "1");
  for (std::size_t k = 0; k < tracklets.size(); ++k) {
    const Tracklet& tracklet = tracklets[k];
    const Label& first = tracklet.front();
    pugi::xml_node item = list.append_child("item");
    if (k == 0) mark_class(item, 1);
    add(item, "objectType", first.type);
    add(item, "h", first.size_m.z());
    add(item, "w", first.size_m.y());
    add(item, "l", first.size_m.x());
    add(item, "first_frame", std::to_string(first.frame_id));
    pugi::xml_node poses = item.append_child("poses");
    if (k == 0) mark_class(poses, 2);
    add(poses, "count", std::to_string(tracklet.size()));
    add(poses, "item_version", "2");
    for (std::size_t i = 0; i < tracklet.size(); ++i) {
      pugi::xml_node pose = poses.append_child("item");
      if (k == 0 && i == 0) mark_class(pose, 3);
      add_pose(pose, tracklet[i]);
    }
    add(item, "finished", "1");
  }
  std::ostringstream text;
  document.save(text, "\t");
  return text.str();
}

}  // namespace redrive::kitti
