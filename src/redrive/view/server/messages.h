// SPDX-License-Identifier: Apache-2.0
// Messages from the page: JSON texts over the WebSocket, parsed and checked only here.
//   {"type": "view", "id", "camera", "frame", "shift_m": [forward, left, up], "yaw_deg",
//    "pitch_deg", "layer", "exposure", "overlays": [NAME, ..], "reference": bool,
//    "novel": null or {"set": NAME, "index"},
//    "mount": null or {"at": "X,Y,Z,YAW,PITCH,ROLL", "lens": TEXT}}, as of `redrive render`,
//    "object": null or ID, "scan": null or {"sensor", "colour": "range", "intensity" or "error"}}
//   {"type": "shown", "sequence"}
//   {"type": "pick", "id", "at": [u, v]}
//   {"type": "train", "paused": bool}
//   {"type": "path", "fps", "keyframes": [as of a camera path], "save": null or {"name",
//   "overwrite"}}
//   {"type": "load_path", "name"}
//   {"type": "edit", "id", "file": NAME, "text": TEXT of an EDIT.json}
//   {"type": "drag", "id", "object": ID, "turns": bool, "from": [u, v], "to": [u, v],
//    "shift_m": [forward, left, up], "turn_deg"}
// A view with "path_s" is at that time of the page's last path.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "redrive/camera/mount.h"
#include "redrive/edit/camera_path_file.h"

namespace redrive::view {

/// Maximum length of a message: an EDIT.json with some 10,000 points of tracks.
constexpr std::size_t kMaxMessageBytes = 1 << 20;

/// The quantity that the colours of an image show.
enum class Layer { kImage, kDepth, kNormals, kOpacity, kCoverage, kActors };

/// What is drawn over an image.
struct Overlays {
  bool trajectory = false;  ///< the body's path, on the ground
  bool frusta = false;      ///< frusta of the rig's cameras at the frame
  bool lidar = false;       ///< the frame's revolution
  bool cloud = false;       ///< the revolutions of all frames, thinned
  bool boxes = false;       ///< the frame's annotated objects
  bool masks = false;       ///< the pixels of the recorded image that training excludes
};

/// A view with ground truth: entry `index` of a novel set.
struct NovelView {
  std::string set;
  std::size_t index = 0;
  bool operator==(const NovelView&) const = default;
};

/// A user-defined camera.
struct OwnMount {
  Mount mount;
  Lens lens;
};

/// A LiDAR scan that is rendered at the frame, by a sensor in the recorded LiDAR's place.
struct ScanRequest {
  enum class Colour { kRange, kIntensity, kError };
  std::string sensor;  ///< recorded, estimated, or as parse_lidar_sensor
  Colour colour = Colour::kRange;
  bool operator==(const ScanRequest&) const = default;
};

/// The view that a page wants to see.
struct ViewRequest {
  std::uint64_t id = 0;  ///< id of the page; comes back with the image
  std::string camera;
  std::int64_t frame = 0;
  std::array<double, 3> shift_m{};    ///< in body axes: forward, left, up; |shift| <= kMaxShift_m
  double yaw_deg = 0, pitch_deg = 0;  ///< turn_sensor; left and up positive
  Layer layer = Layer::kImage;
  std::string exposure = "own";  ///< as render --exposure
  Overlays overlays;
  bool reference = false;          ///< also sends the recorded image
  std::optional<NovelView> novel;  ///< takes the place of camera, frame, shift and angles
  std::optional<OwnMount> mount;   ///< takes the place of the camera
  std::optional<double> path_s;  ///< time on the path, whose pose replaces frame, shift and angles
  std::optional<std::int64_t> object;  ///< id of the moving object whose box is drawn
  std::optional<ScanRequest> scan;     ///< its points are drawn

  bool is_driven() const {
    return !novel && !mount && !path_s && shift_m == std::array<double, 3>{} && yaw_deg == 0 &&
           pitch_deg == 0;
  }
};

/// The page has drawn the image with this number.
struct Shown {
  std::uint64_t sequence = 0;
};

/// Asks for the surface in the last sent image.
struct Pick {
  std::uint64_t id = 0;  ///< comes back with the answer
  double u = 0, v = 0;   ///< 0..1: from the left and upper edge of the image to the opposite ones
};

/// Pauses or continues training.
struct TrainCommand {
  bool paused = false;
};

/// The page's camera path.
struct PathMessage {
  double fps = 24;
  std::vector<PathKeyframe> keyframes;  ///< 1..kMaxPathKeyframes
  struct Save {
    std::string name;  ///< valid_path_name
    bool overwrite = false;
  };
  std::optional<Save> save;  ///< writes it into the run
};

/// Asks for a saved path.
struct LoadPath {
  std::string name;  ///< valid_path_name
};

/// The page's changes to moving objects, which its later views show.
struct EditMessage {
  std::uint64_t id = 0;  ///< comes back with the answer
  std::string file;      ///< name of the file, for errors
  std::string text;      ///< text of an EDIT.json (edit/traffic_edit.h), not yet parsed
};

/// Asks for the place of an object that is dragged in the last sent image.
struct DragMessage {
  std::uint64_t id = 0;  ///< comes back with the answer
  std::int64_t object = 0;
  bool turns = false;                  ///< its handle is dragged, which turns it
  std::array<double, 2> from{}, to{};  ///< ends of the pointer's motion: u, v as in Pick
  std::array<double, 3> shift_m{};     ///< ActorChange::shift_m when the drag began
  double turn_deg = 0;                 ///< ActorChange::turn_deg when the drag began
};

using ClientMessage = std::variant<ViewRequest, Shown, Pick, TrainCommand, PathMessage, LoadPath,
                                   EditMessage, DragMessage>;

/// Whether a saved path may have this name: 1 to 64 of A-Z a-z 0-9 _ -.
bool valid_path_name(std::string_view name);

/// Throws InputError for everything that is not one of the messages above, with numbers in range.
ClientMessage parse_client_message(std::string_view text);

}  // namespace redrive::view
