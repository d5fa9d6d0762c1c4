// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/view_requests.h"

#include <algorithm>
#include <set>

#include "redrive/base/files/files.h"
#include "redrive/base/json_field.h"
#include "redrive/recording/formats/calibration_json.h"
#include "redrive/recording/formats/egomotion_json.h"

namespace redrive {
namespace {

// The name may come from an untrusted file, and a file of this name is written. It must stay inside
// the output folder and have one spelling only, so that equal files have equal names.
std::string output_name_from_json(const JsonField& field) {
  const std::string name = field.string();
  const std::filesystem::path path(name);
  const auto odd = [](unsigned char c) { return c < 0x20 || c == 0x7f || c == '\\'; };
  constexpr std::size_t kMaxLength = 1000;
  if (name.size() > kMaxLength) field.fail("expected a file name of at most 1000 characters");
  if (name.empty() || path.is_absolute() || std::any_of(name.begin(), name.end(), odd)) {
    field.fail("expected a relative file name");
  }
  const bool detour = std::any_of(path.begin(), path.end(),
                                  [](const auto& part) { return part == ".." || part == "."; });
  if (detour || name.find("//") != name.npos)
    field.fail("expected a relative file name without \"..\", \".\" or \"//\"");
  if (!has_extension(path, {".png", ".jpg", ".jpeg"}))
    field.fail("expected a file name that ends in .png, .jpg or .jpeg");
  return name;
}

RequestedView view_from_json(const JsonField& entry) {
  RequestedView view;
  view.file = output_name_from_json(entry.at("file"));
  view.camera = entry.at("camera").string();
  view.frame_id = entry.at("frame_id").integer();
  if (view.frame_id < 0) entry.at("frame_id").fail("expected a frame id, >= 0");
  view.global_from_body = global_from_body_from_json(entry);
  if (entry.has("shift_body_m")) {
    const std::vector<double> shift = entry.at("shift_body_m").numbers(3);
    view.shift_body_m = Eigen::Vector3d(shift[0], shift[1], shift[2]);
    if (view.shift_body_m->lpNorm<Eigen::Infinity>() > kMaxShift_m) {
      entry.at("shift_body_m").fail("expected metres, at most 1e4 along each axis");
    }
  }
  if (!view.global_from_body && !view.shift_body_m)
    entry.fail("has neither RT_ECEF_body nor shift_body_m");
  return view;
}

}  // namespace

ViewRequests parse_view_requests(std::string_view text, const std::filesystem::path& file) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  ViewRequests poses;
  poses.path = file;
  if (root.has("calibration")) poses.cameras = cameras_from_json(root.at("calibration"), nullptr);
  const JsonField images = root.at("images");
  if (!images.json().is_array() || images.size() == 0)
    images.fail("expected a list of at least one image");
  std::set<std::string> names;
  for (std::size_t i = 0; i < images.size(); ++i) {
    poses.views.push_back(view_from_json(images.at(i)));
    if (!names.insert(poses.views.back().file).second) {
      images.at(i).at("file").fail("two images of this name: one would overwrite the other");
    }
  }
  for (std::size_t i = 0; i < poses.views.size(); ++i) {
    for (std::filesystem::path folder = std::filesystem::path(poses.views[i].file).parent_path();
         !folder.empty(); folder = folder.parent_path()) {
      if (names.contains(folder.string()))
        images.at(i).at("file").fail("its folder is the name of another image");
    }
  }
  return poses;
}

ViewRequests read_view_requests(const std::filesystem::path& file) {
  return parse_view_requests(read_file(file), file);
}

}  // namespace redrive
