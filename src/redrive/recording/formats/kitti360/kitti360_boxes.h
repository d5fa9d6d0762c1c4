// SPDX-License-Identifier: Apache-2.0
// Annotated objects of KITTI-360, data_3d_bboxes/train/<drive>.xml: meshes in the world of the
// poses. Standing objects have one for all frames, others one for each frame.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/math/rigid3.h"

namespace redrive::kitti360 {

/// A class of objects that may move.
struct ObjectClass {
  int semantic_id;        ///< as the file has it (kittiId of the data set's labels)
  int label_id;           ///< as label images have it
  std::string_view name;  ///< "car", "person", ...
  bool is_human = false;
};
/// Returns null for buildings, poles and everything else that stands, and for unknown numbers.
const ObjectClass* find_class(int semantic_id);
/// Returns the class of a name, in upper or lower case, including other data sets' names:
/// "Pedestrian" is a person. An unknown name is an unknown vehicle.
const ObjectClass& class_named(std::string_view name);

constexpr std::int64_t kStatic = -1;

/// An object at one time, or a standing one.
struct Object {
  std::int64_t id = 0;  ///< 1000 label_id + instance, as in instance images
  std::string type;
  std::int64_t frame_id = kStatic;  ///< frame at which it is there
  /// frames of the window in which it was annotated
  std::int64_t first_frame = 0, last_frame = -1;
  Rigid3d world_from_box;  ///< axes and origin of the box as in Box
  Eigen::Vector3d size_m = Eigen::Vector3d::Zero();
};

/// Returns vehicles, people, and whatever has a time. Of two objects with the same id and time the
/// later one counts, as in the data set's own tools. A mesh becomes the box around its vertices.
/// Files without semanticId (drive 0004) are read by label and dynamicSeq. InputError: malformed
/// XML, missing elements, numbers that are not finite, sizes outside 0.01..100 m, axes that are not
/// perpendicular.
std::vector<Object> parse_objects(std::string_view text, const std::filesystem::path& file);

/// The file of these objects. Sizes become scales of a unit cube.
std::string make_objects(const std::vector<Object>& objects);

}  // namespace redrive::kitti360
