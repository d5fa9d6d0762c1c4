// SPDX-License-Identifier: Apache-2.0
// Camera paths in nerfstudio's layout, with keys of our own.
//   {"camera_type": "perspective" or "fisheye", "render_width", "render_height", "fps", "seconds",
//    "camera_path": [{"camera_to_world": [16 numbers, row by row], "fov"}, ..],
//    "keyframes": [{"camera", "frame_id", "shift_body_m": [x, y, z], "yaw_deg", "pitch_deg",
//                   "time_s"}, ..]}
// - camera_to_world: metres, OpenGL camera axes (x right, y up, z backward); its world is the world
// of the run (Scene::global_from_world).
//   the run (Scene::global_from_world).
// - fov: vertical, degrees. The focal length is (render_height / 2) / tan(fov / 2) for both types;
//   "fisheye" is equidistant, as nerfstudio's.
// - keyframes with frame_id are ours: views as `redrive render` places them. Where the first has
//   one, they are the path, and camera_path may be absent; else camera_path is.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/base/json_field.h"
#include "redrive/math/rigid3.h"

namespace redrive {

constexpr double kMinPathFps = 1, kMaxPathFps = 240;  ///< images a second
constexpr double kMaxPath_s = 3600;                   ///< duration
constexpr std::size_t kMaxPathKeyframes = 256;
constexpr std::size_t kMaxPathCameras = 100'000;

/// A view of the run at a time of the path.
struct PathKeyframe {
  double time_s = 0;  ///< 0..kMaxPath_s
  std::string camera;
  std::int64_t frame_id = 0;
  std::array<double, 3> shift_body_m{};  ///< each |x| <= kMaxShift_m
  double yaw_deg = 0, pitch_deg = 0;     ///< -360..360
};

/// An entry of camera_path.
struct PathCamera {
  Rigid3d world_from_camera;  ///< x right, y down, z forward
  double fov_deg = 0;         ///< vertical, 1..179
};

struct CameraPathFile {
  std::filesystem::path path;
  double fps = 24;
  double seconds = 0;               ///< duration
  bool fisheye = false;             ///< lens of `cameras`; else a pinhole
  int width = 0, height = 0;        ///< size of `cameras` in pixels; 0 where there are keyframes
  std::vector<PathCamera> cameras;  ///< evenly spaced in time; empty where there are keyframes
  std::vector<PathKeyframe> keyframes;  ///< times increase
};

/// InputError where a field is missing, of another type or out of range.
CameraPathFile parse_camera_path(std::string_view text, const std::filesystem::path& file);
CameraPathFile read_camera_path(const std::filesystem::path& file);

/// Parses a list of 1 to kMaxPathKeyframes keyframes with increasing times.
std::vector<PathKeyframe> path_keyframes_from_json(const JsonField& list);
nlohmann::json path_keyframe_to_json(const PathKeyframe& keyframe);

/// Returns the 16 numbers of camera_to_world.
nlohmann::json camera_to_world_json(const Rigid3d& world_from_camera);

}  // namespace redrive
