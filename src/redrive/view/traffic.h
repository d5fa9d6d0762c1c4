// SPDX-License-Identifier: Apache-2.0
// Moving objects as a page edits them: their description, the page's edit within bounds, the object
// that a ray meets, and the place of a dragged one.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/edit/actor_body.h"
#include "redrive/edit/traffic_edit.h"
#include "redrive/scene/scene.h"
#include "redrive/view/server/messages.h"
#include "redrive/view/view_renderer.h"

namespace redrive::view {

// Bounds of a page's edit besides the format's own: it is applied while others wait for images.
constexpr std::size_t kMaxPageCopies = 100;  ///< with objects that are added
/// time of a track's last key after the drive's end, at most
constexpr double kMaxAfterDrive_s = 60;

/// Changes with which pages begin.
struct FirstEdit {
  std::string text;                  ///< text of an EDIT.json; empty: there are none
  std::filesystem::path file;        ///< file of --edit; may be empty
  std::string saved_as;              ///< the file, if it has this text
  std::vector<std::string> remarks;  ///< as edit_actors
};

/// Returns the changes of --edit, a file or empty, and --actors: objects that it excludes are
/// removed. UsageError, InputError as in `redrive render`; InputError where no page could send it.
FirstEdit first_edit(const Scene& scene, const std::string& actors,
                     const std::filesystem::path& edit);

/// Throws InputError where an edit has a body from a file that `known` does not have: pages must
/// not make the program read other files.
void check_body_files(const TrafficEdit& edit, const TrafficEdit& known);

/// The objects of a run as edited.
struct Traffic {
  Scene scene;                       ///< frames and actors only
  std::vector<std::string> remarks;  ///< as edit_actors
};
/// InputError as edit_actors, which uses `bodies`, and for an edit beyond the bounds above.
Traffic edited_traffic(const Scene& scene, const TrafficEdit& edit, ActorBodies* bodies = nullptr);

/// Returns [{"id", "type", "frames": [first, last], "size_m", "nearest": null or {"camera",
/// "frame"}}, ..]: ids of its first and last frame, and the image that shows its centre nearest.
nlohmann::json objects_to_json(const Scene& scene);

/// An object that a ray meets.
struct ObjectOnRay {
  std::int64_t id = 0;
  double from_m = 0;  ///< along the ray, to its box
};
/// Returns the object whose box a ray enters first. `direction`: a unit vector.
std::optional<ObjectOnRay> object_on_ray(const Scene& traffic, std::int64_t t_ns,
                                         const Eigen::Vector3d& origin,
                                         const Eigen::Vector3d& direction);

/// Returns the point that turns an object, in the axes of its box: on the road around it, ahead of
/// it where that lies outside its outline in the image, else further around. Nothing where no such
/// point is in the image.
std::optional<Eigen::Vector3d> handle_in_box(const Placement& placement,
                                             const Rigid3d& world_from_box,
                                             const Eigen::Vector3d& size_m);

/// Returns {"shift_m"}, or {"turn_deg"} where the drag turns: the change of an object that follows
/// the pointer on the plane under its box, as if it were held there, or turns as far around it.
/// Neither where the object does not exist or the pointer is not on that plane within 200 m.
/// `edit`: the edit of `traffic`.
nlohmann::json dragged(const DragMessage& drag, const Placement& placement, const Scene& traffic,
                       const TrafficEdit& edit);

}  // namespace redrive::view
