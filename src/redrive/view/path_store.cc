// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/path_store.h"

#include <algorithm>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"

namespace redrive::view {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMostNames = 1000;
constexpr std::size_t kMostPaths = 100;  ///< paths a client may save, up to 8 MB each
constexpr int kMostImages = 20'000;      ///< entries of camera_path, about 400 bytes each

}  // namespace

fs::path PathStore::file(const std::string& name) const {
  REDRIVE_CHECK(valid_path_name(name));
  return folder() / (name + ".json");
}

std::vector<std::string> PathStore::names() const {
  std::vector<std::string> names;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder(), error))
    if (entry.path().extension() == ".json" && valid_path_name(entry.path().stem().string()))
      names.push_back(entry.path().stem().string());
  std::ranges::sort(names);
  if (names.size() > kMostNames) names.resize(kMostNames);
  return names;
}

std::vector<PathKey> PathStore::keys(const std::vector<PathKeyframe>& keyframes) const {
  std::vector<PathKey> keys;
  for (std::size_t i = 0; i < keyframes.size(); ++i)
    keys.push_back(path_key(keyframes[i], run_.scene, "message", i));
  return keys;
}

void PathStore::save(const PathMessage& message) const {
  const fs::path to = file(message.save->name);
  const bool exists = fs::exists(to);
  if (exists && !message.save->overwrite)
    throw InputError(to, "", "", "exists; overwriting it was not asked for");
  if (!exists && names().size() >= kMostPaths)
    throw InputError(folder(), "", "",
                     "has 100 paths, which is the most; delete one of its files or overwrite one");
  CameraPath path;
  path.keys = keys(message.keyframes);
  path.fps = message.fps;
  path.seconds = path.keys.back().t_s - path.keys.front().t_s;
  if (path.images() > kMostImages)
    throw InputError("message", "fps", std::to_string(message.fps),
                     "the path has more than 20000 images");
  const Camera& lens =
      run_.scene.rig[run_.scene.camera_index(message.keyframes.front().camera)].camera;
  const double fov_deg = fov_of(lens), aspect = static_cast<double>(lens.width) / lens.height;
  nlohmann::json cameras = nlohmann::json::array(), keyframes = nlohmann::json::array();
  for (int i = 0; i < path.images(); ++i)
    cameras.push_back(
        {{"camera_to_world", camera_to_world_json(path.at_image(i).world_from_camera)},
         {"fov", fov_deg},
         {"aspect", aspect}});
  for (std::size_t i = 0; i < path.keys.size(); ++i) {
    nlohmann::json keyframe = path_keyframe_to_json(message.keyframes[i]);
    keyframe["matrix"] = camera_to_world_json(path.keys[i].world_from_camera);
    keyframe["fov"] = fov_deg;
    keyframe["aspect"] = aspect;
    keyframes.push_back(keyframe);
  }
  const nlohmann::json document = {
      {"camera_type", lens.info().perspective ? "perspective" : "fisheye"},
      {"render_width", lens.width},
      {"render_height", lens.height},
      {"fps", path.fps},
      {"seconds", path.seconds},
      {"is_cycle", false},
      {"smoothness_value", 0},
      {"keyframes", keyframes},
      {"camera_path", cameras}};
  make_folders_within(folder().parent_path(), folder().filename());
  write_file(to, document.dump() + "\n");
}

nlohmann::json PathStore::load(const std::string& name) const {
  const CameraPathFile path = read_camera_path(file(name));
  if (path.keyframes.empty())
    throw InputError(path.path, "keyframes", "", "has none with a frame_id, which the page needs");
  nlohmann::json keyframes = nlohmann::json::array();
  for (const PathKeyframe& keyframe : path.keyframes)
    keyframes.push_back(path_keyframe_to_json(keyframe));
  return {{"fps", path.fps}, {"keyframes", keyframes}};
}

}  // namespace redrive::view
