// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/traffic.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/math/angles.h"
#include "redrive/scene/moving_objects.h"

namespace redrive::view {
namespace {

constexpr double kHandle_m = 1;  // from the object's corners
// distance of the handle from the outline, in widths of the image
constexpr double kHandleMargin = 0.025;
constexpr double kNearestTurn_m = 0.2;                  // to the middle, from where a drag turns
constexpr double kMaxDragged_m = 200;                   // from the camera
constexpr std::size_t kMaxEdit = kMaxMessageBytes / 2;  // quotes take two bytes in a message

/// Returns the part of a scene that an edit needs.
Scene part_of(const Scene& scene) {
  Scene part;
  part.frames = scene.frames;
  part.actors = scene.actors;
  return part;
}

/// Calls see(change, its field) for each change.
template <class See>
void for_each_change(const TrafficEdit& edit, const See& see) {
  for (const auto& [id, change] : edit.actors) see(change, "actors." + std::to_string(id));
  for (std::size_t i = 0; i < edit.copies.size(); ++i)
    see(edit.copies[i].change, "copies[" + std::to_string(i) + "]");
  for (std::size_t i = 0; i < edit.added.size(); ++i)
    see(edit.added[i].change, "added[" + std::to_string(i) + "]");
}

void check_bounds(const TrafficEdit& edit, const Scene& scene) {
  if (const std::size_t made = edit.copies.size() + edit.added.size(); made > kMaxPageCopies)
    throw InputError(edit.file, edit.copies.empty() ? "added" : "copies", std::to_string(made),
                     "the viewer takes at most 100 copies and added objects");
  const double last_s =
      1e-9 * static_cast<double>(scene.frames.back().t_ns - scene.frames.front().t_ns) +
      kMaxAfterDrive_s;
  for_each_change(edit, [&](const ActorChange& change, const std::string& field) {
    if (!change.track.empty() && change.track.back().time_s > last_s)
      throw InputError(
          edit.file, field + ".track[" + std::to_string(change.track.size() - 1) + "].time_s",
          std::to_string(change.track.back().time_s),
          "the viewer takes times until 60 s after the drive's end, " + std::to_string(last_s));
  });
}

/// Returns the change of an object, also of one that the edit made.
ActorChange change_of(const TrafficEdit& edit, std::int64_t id) {
  if (const auto own = edit.actors.find(id); own != edit.actors.end()) return own->second;
  if (const auto copy = std::ranges::find(edit.copies, id, &ActorCopy::id);
      copy != edit.copies.end())
    return copy->change;
  const auto added = std::ranges::find(edit.added, id, &AddedActor::id);
  return added == edit.added.end() ? ActorChange{} : added->change;
}

/// Returns the point of a plane at `height` in its axes that a pixel shows; nothing beyond the
/// horizon or too far away.
std::optional<Eigen::Vector3d> on_plane(const Placement& placement, const Rigid3d& plane_from_world,
                                        double height, const Eigen::Vector2d& pixel) {
  const auto direction = placement.camera.unproject(pixel);
  if (!direction) return std::nullopt;
  const Rigid3d plane_from_camera = plane_from_world * placement.world_from_camera;
  const Eigen::Vector3d eye = plane_from_camera.translation(),
                        ray = plane_from_camera.linear() * *direction;
  const double range_m = (height - eye.z()) / ray.z();
  if (!(range_m > 0 && range_m < kMaxDragged_m)) return std::nullopt;
  return eye + range_m * ray;
}

std::optional<Eigen::Vector2d> pixel_of(const Placement& placement,
                                        const Eigen::Vector3d& in_world) {
  return placement.camera.project(placement.world_from_camera.inverse(Eigen::Isometry) * in_world);
}

/// Whether a point lies outside of the convex hull of others, by at least `margin`.
bool is_outside(const Eigen::Vector2d& point, const std::vector<Eigen::Vector2d>& others,
                double margin) {
  constexpr int kDirections = 64;
  for (int i = 0; i < kDirections; ++i) {
    const double angle_rad = 2 * M_PI * i / kDirections;
    const Eigen::Vector2d direction(std::cos(angle_rad), std::sin(angle_rad));
    if (std::ranges::all_of(others, [&](const Eigen::Vector2d& other) {
          return direction.dot(point - other) >= margin;
        }))
      return true;
  }
  return false;
}

}  // namespace

FirstEdit first_edit(const Scene& scene, const std::string& actors,
                     const std::filesystem::path& edit) {
  FirstEdit first;
  if (edit.empty() && actors == "all") return first;
  first.file = edit;
  if (actors == "all") first.saved_as = edit.string();
  first.text = edit.empty() ? "{}" : read_file(edit);
  const TrafficEdit parsed = parse_traffic_edit(first.text, edit);
  Traffic traffic = edited_traffic(scene, parsed);
  first.remarks = traffic.remarks;
  const std::vector<MovingObject> all = traffic.scene.actors;
  select_actors(actors, &traffic.scene);
  if (actors != "all") {
    std::set<std::int64_t> chosen;
    for (const MovingObject& actor : traffic.scene.actors) chosen.insert(actor.id);
    nlohmann::json json = nlohmann::json::parse(first.text);
    for (const MovingObject& actor : scene.actors)
      if (!chosen.contains(actor.id)) json["actors"][std::to_string(actor.id)]["remove"] = true;
    for (const char* const made : {"copies", "added"})
      if (json.contains(made))
        for (nlohmann::json& one : json[made])
          if (!chosen.contains(one["id"].get<std::int64_t>())) one["remove"] = true;
    first.text = json.dump();
    parse_traffic_edit(first.text, edit);  // the number of objects is bounded
  }
  if (first.text.size() > kMaxEdit)
    throw InputError(edit, "", std::to_string(first.text.size()) + " bytes",
                     "the viewer takes at most " + std::to_string(kMaxEdit));
  return first;
}

void check_body_files(const TrafficEdit& edit, const TrafficEdit& known) {
  std::set<std::filesystem::path> files;
  for_each_change(known, [&](const ActorChange& change, const std::string&) {
    files.insert(change.body_file);
  });
  for_each_change(edit, [&](const ActorChange& change, const std::string& field) {
    if (!change.body_file.empty() && !files.contains(change.body_file))
      throw InputError(edit.file, field + ".body.file", change.body_file.string(),
                       "pages show bodies of the files that redrive view --edit names alone");
  });
}

Traffic edited_traffic(const Scene& scene, const TrafficEdit& edit, ActorBodies* bodies) {
  check_bounds(edit, scene);
  Traffic traffic{part_of(scene), {}};
  traffic.remarks = edit_actors(edit, &traffic.scene, bodies);
  return traffic;
}

nlohmann::json objects_to_json(const Scene& scene) {
  nlohmann::json objects = nlohmann::json::array();
  for (const MovingObject& actor : scene.actors) {
    nlohmann::json nearest;
    const Frame *first = nullptr, *last = nullptr;
    double nearest_m = std::numeric_limits<double>::infinity();
    for (const Frame& frame : scene.frames) {
      if (!actor.world_from_box(frame.t_ns)) continue;
      if (!first) first = &frame;
      last = &frame;
      for (const RigCamera& rig : scene.rig) {
        const auto world_from_box = actor.world_from_box(frame.t_ns + rig.time_offset_ns);
        if (!world_from_box) continue;
        const Eigen::Vector3d in_camera =
            (scene.world_from_body(frame.t_ns) * rig.body_from_sensor).inverse(Eigen::Isometry) *
            world_from_box->translation();
        const auto pixel = rig.camera.project(in_camera);
        if (!pixel || pixel->minCoeff() < 0 || pixel->x() >= rig.camera.width ||
            pixel->y() >= rig.camera.height || in_camera.norm() >= nearest_m)
          continue;
        nearest_m = in_camera.norm();
        nearest = {{"camera", rig.name}, {"frame", frame.id}};
      }
    }
    nlohmann::json frames;
    if (first) frames = {first->id, last->id};
    objects.push_back({{"id", actor.id},
                       {"type", actor.type},
                       {"frames", frames},
                       {"size_m", {actor.size_m.x(), actor.size_m.y(), actor.size_m.z()}},
                       {"nearest", nearest}});
  }
  return objects;
}

std::optional<ObjectOnRay> object_on_ray(const Scene& traffic, std::int64_t t_ns,
                                         const Eigen::Vector3d& origin,
                                         const Eigen::Vector3d& direction) {
  std::optional<ObjectOnRay> nearest;
  for (const MovingObject& actor : traffic.actors) {
    const auto world_from_box = actor.world_from_box(t_ns);
    if (!world_from_box) continue;
    const MovingBox box{actor.id, world_from_box->inverse(Eigen::Isometry), actor.size_m / 2};
    const auto from_m = box.entry(origin, direction);
    if (from_m && (!nearest || *from_m < nearest->from_m)) nearest = {actor.id, *from_m};
  }
  return nearest;
}

std::optional<Eigen::Vector3d> handle_in_box(const Placement& placement,
                                             const Rigid3d& world_from_box,
                                             const Eigen::Vector3d& size_m) {
  const Camera& camera = placement.camera;
  const double margin = kHandleMargin * camera.width;
  std::vector<Eigen::Vector2d> outline;
  for (int corner = 0; corner < 8; ++corner) {
    const Eigen::Vector3d sides(corner & 1 ? 0.5 : -0.5, corner & 2 ? 0.5 : -0.5,
                                corner & 4 ? 0.5 : -0.5);
    if (const auto pixel = pixel_of(placement, world_from_box * sides.cwiseProduct(size_m)))
      outline.push_back(*pixel);
  }
  const double radius_m = size_m.head<2>().norm() / 2 + kHandle_m;
  for (const double wider : {1.0, 1.5, 2.0})
    for (const double angle_deg : {0, 45, -45, 90, -90, 135, -135, 180}) {
      const double angle_rad = kRadiansPerDegree * angle_deg;
      const Eigen::Vector3d handle(wider * radius_m * std::cos(angle_rad),
                                   wider * radius_m * std::sin(angle_rad), -size_m.z() / 2);
      const auto pixel = pixel_of(placement, world_from_box * handle);
      if (pixel && pixel->x() > margin && pixel->x() < camera.width - margin &&
          pixel->y() > margin && pixel->y() < camera.height - margin &&
          is_outside(*pixel, outline, margin))
        return handle;
    }
  return std::nullopt;
}

nlohmann::json dragged(const DragMessage& drag, const Placement& placement, const Scene& traffic,
                       const TrafficEdit& edit) {
  nlohmann::json answer = nlohmann::json::object();
  const auto actor = std::ranges::find(traffic.actors, drag.object, &MovingObject::id);
  if (actor == traffic.actors.end()) return answer;
  const auto world_from_box = actor->world_from_box(placement.t_ns);
  if (!world_from_box) return answer;
  // The box without its change: its axes are the axes of shift_m, its plane the plane of the drag.
  const Rigid3d world_from_own =
      *world_from_box * own_motion(change_of(edit, drag.object)).inverse(Eigen::Isometry);
  const Rigid3d own_from_world = world_from_own.inverse(Eigen::Isometry);
  const Eigen::Vector3d shift_m(drag.shift_m.data());
  const Eigen::Vector3d base = shift_m - Eigen::Vector3d(0, 0, actor->size_m.z() / 2);
  const Eigen::Vector2d size(placement.camera.width, placement.camera.height);
  const Eigen::Vector2d from = Eigen::Vector2d(drag.from.data()).cwiseProduct(size),
                        to = Eigen::Vector2d(drag.to.data()).cwiseProduct(size),
                        half(0.5, 0.5);  // u, v count from the edge, pixels from their centres
  if (drag.turns) {
    const auto held = on_plane(placement, own_from_world, base.z(), from - half),
               there = on_plane(placement, own_from_world, base.z(), to - half);
    if (!held || !there) return answer;
    const Eigen::Vector2d a = (*held - base).head<2>(), b = (*there - base).head<2>();
    if (std::min(a.norm(), b.norm()) < kNearestTurn_m) return answer;
    const double turned_deg =
        kDegreesPerRadian * std::atan2(a.x() * b.y() - a.y() * b.x(), a.dot(b));
    answer["turn_deg"] = std::remainder(drag.turn_deg + turned_deg, 360.0);
  } else if (const auto pixel = pixel_of(placement, world_from_own * base)) {
    const auto there = on_plane(placement, own_from_world, base.z(), *pixel + to - from);
    if (!there) return answer;
    const Eigen::Vector3d shifted = shift_m + *there - base;
    if (shifted.cwiseAbs().maxCoeff() <= kMaxActorShift_m)
      answer["shift_m"] = {shifted.x(), shifted.y(), shift_m.z()};
  }
  return answer;
}

}  // namespace redrive::view
