// SPDX-License-Identifier: Apache-2.0
#include "redrive/edit/edit_actors.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <memory>
#include <set>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"

namespace redrive {
namespace {

constexpr double kKeys_s = 0.1;  // seconds between keys of a changed track

std::string known_ids(const std::vector<MovingObject>& actors) {
  if (actors.empty()) return "there is no moving object";
  std::string ids;
  for (const MovingObject& actor : actors)
    ids += (ids.empty() ? "" : ", ") + std::to_string(actor.id);
  return "there is no such moving object; there are " + ids;
}

std::int64_t ns_of(double seconds, const Scene& scene) {
  return scene.frames.front().t_ns + std::llround(1e9 * seconds);
}

/// Returns keys at even times, at most kKeys_s apart. pose_at: pose at a time in seconds after
/// `first_ns`.
template <class PoseAt>
std::vector<MovingObject::Key> keys_of(std::int64_t first_ns, double seconds,
                                       const PoseAt& pose_at) {
  if (seconds <= 0) return {{first_ns, pose_at(0.0), Eigen::Vector3d::Zero()}};
  const int steps = std::max(1, static_cast<int>(std::ceil(seconds / kKeys_s)));
  std::vector<MovingObject::Key> keys;
  for (int i = 0; i <= steps; ++i) {
    const double t_s = seconds * i / steps;
    keys.push_back({first_ns + std::llround(1e9 * t_s), pose_at(t_s), Eigen::Vector3d::Zero()});
  }
  for (std::size_t i = 0; i + 1 < keys.size(); ++i)
    keys[i].velocity_in_world_m_per_s =
        (keys[i + 1].world_from_box.translation() - keys[i].world_from_box.translation()) /
        (1e-9 * static_cast<double>(keys[i + 1].t_ns - keys[i].t_ns));
  if (keys.size() > 1)
    keys.back().velocity_in_world_m_per_s = keys[keys.size() - 2].velocity_in_world_m_per_s;
  return keys;
}

Rigid3d pose_of(const TrackPoint& point) {
  const auto turned = [](double deg, const Eigen::Vector3d& axis) {
    return Eigen::AngleAxisd(kRadiansPerDegree * deg, axis);
  };
  Rigid3d pose = Rigid3d::Identity();
  pose.linear() = (turned(point.yaw_deg, Eigen::Vector3d::UnitZ()) *
                   turned(-point.pitch_deg, Eigen::Vector3d::UnitY()) *
                   turned(point.roll_deg, Eigen::Vector3d::UnitX()))
                      .toRotationMatrix();
  pose.translation() = Eigen::Vector3d(point.position_m.data());
  return pose;
}

void set_track(const std::vector<TrackPoint>& track, const Scene& scene, MovingObject* actor) {
  actor->keys =
      keys_of(ns_of(track.front().time_s, scene), track.back().time_s - track.front().time_s,
              [&](double t_s) {
                const double at_s = track.front().time_s + t_s;
                auto next = std::ranges::find_if(
                    track, [&](const TrackPoint& p) { return p.time_s > at_s; });
                next = std::clamp(next, track.begin() + 1, track.end() - 1);
                const TrackPoint &a = *(next - 1), &b = *next;
                return interpolate(pose_of(a), pose_of(b),
                                   std::clamp((at_s - a.time_s) / (b.time_s - a.time_s), 0.0, 1.0));
              });
}

/// Makes the object follow its track at another speed until the track or the drive ends.
void set_speed(double speed, const Scene& scene, MovingObject* actor) {
  const MovingObject before = *actor;
  const std::int64_t first_ns = before.keys.front().t_ns, last_ns = before.keys.back().t_ns;
  const double own_s = 1e-9 * static_cast<double>(last_ns - first_ns),
               drive_s = 1e-9 * static_cast<double>(scene.frames.back().t_ns - first_ns);
  double seconds = speed > 0 ? own_s / speed : drive_s;
  seconds = std::max(std::min(seconds, std::max(drive_s, own_s)), 0.0);
  actor->keys = keys_of(first_ns, seconds, [&](double t_s) {
    const std::int64_t t_ns = first_ns + std::llround(1e9 * std::min(t_s * speed, own_s));
    if (const auto pose = before.world_from_box(t_ns)) return *pose;
    // In a gap of its track.
    const auto next = std::ranges::lower_bound(before.keys, t_ns, {}, &MovingObject::Key::t_ns);
    return (next == before.keys.end() ? before.keys.back() : *next).world_from_box;
  });
}

/// Returns the axes of the drive at its frame nearest to a point: x forward, y left, z up.
Eigen::Matrix3d road_axes(const Scene& scene, const Eigen::Vector3d& at) {
  const std::vector<PosedFrame> frames = scene.posed_frames();
  const auto nearest = std::ranges::min_element(frames, {}, [&](const PosedFrame& frame) {
    return (frame.world_from_body.translation() - at).squaredNorm();
  });
  return nearest->world_from_body.linear();
}

/// Returns the body of ActorChange::body_file.
using BodyOfFile =
    std::function<std::shared_ptr<const ActorBody>(const std::filesystem::path& file)>;

/// Shows other Gaussians, which stand where the own ones stood: on its own track the centre of a
/// higher box is higher. A track of the edit places the centre.
void set_body(const ActorChange& change, const std::vector<MovingObject>& own,
              const BodyOfFile& body_of_file, MovingObject* actor) {
  Eigen::Vector3d size_m;
  if (change.body) {
    const MovingObject& other = *std::ranges::find(own, *change.body, &MovingObject::id);
    actor->body = other.body.value_or(other.id);
    actor->imported = other.imported;
    size_m = other.size_m;
  } else if (!change.body_file.empty()) {
    actor->imported = body_of_file(change.body_file);
    size_m = actor->imported->size_m;
  } else {
    return;
  }
  const Eigen::Translation3d raised(0, 0, (size_m.z() - actor->size_m.z()) / 2);
  if (change.track.empty())
    for (MovingObject::Key& key : actor->keys) key.world_from_box = key.world_from_box * raised;
  actor->size_m = size_m;
}

/// `own`: the objects before the edit.
void apply(const ActorChange& change, const Scene& scene, const std::vector<MovingObject>& own,
           const BodyOfFile& body_of_file, MovingObject* actor) {
  actor->apply_corrections();
  if (!change.track.empty()) set_track(change.track, scene, actor);
  if (change.speed != 1) set_speed(change.speed, scene, actor);
  const Rigid3d moved = own_motion(change);
  const Eigen::Vector3d along_road(change.shift_road_m.data());
  for (MovingObject::Key& key : actor->keys) {
    if (!along_road.isZero(0))
      key.world_from_box.pretranslate(road_axes(scene, key.world_from_box.translation()) *
                                      along_road);
    key.world_from_box = key.world_from_box * moved;
  }
  if (change.hide_s)
    actor->hidden_ns.emplace_back(ns_of((*change.hide_s)[0], scene),
                                  ns_of((*change.hide_s)[1], scene));
  set_body(change, own, body_of_file, actor);
  for (std::size_t c = 0; c < 3; ++c) actor->gain[c] *= static_cast<float>(change.gain[c]);
}

/// Whether two boxes overlap, by the separating axis theorem.
bool overlap(const Rigid3d& a, const Eigen::Vector3d& half_a, const Rigid3d& b,
             const Eigen::Vector3d& half_b) {
  const Eigen::Vector3d apart = b.translation() - a.translation();
  if (apart.norm() > half_a.norm() + half_b.norm()) return false;
  const auto separates = [&](const Eigen::Vector3d& axis) {
    if (axis.norm() < 1e-9) return false;
    const double reach = (a.linear().transpose() * axis).cwiseAbs().dot(half_a) +
                         (b.linear().transpose() * axis).cwiseAbs().dot(half_b);
    return std::abs(apart.dot(axis)) > reach;
  };
  for (int i = 0; i < 3; ++i) {
    if (separates(a.linear().col(i)) || separates(b.linear().col(i))) return false;
    for (int j = 0; j < 3; ++j)
      if (separates(a.linear().col(i).cross(b.linear().col(j)))) return false;
  }
  return true;
}

using Pair = std::pair<std::int64_t, std::int64_t>;

/// Returns the pairs of objects that overlap at a frame of the scene, one of them `changed` at
/// least.
std::set<Pair> overlapping(const Scene& scene, const std::set<std::int64_t>& changed) {
  struct Standing {
    const MovingObject* actor;
    bool is_changed;
    Rigid3d world_from_box;
    double radius_m;
    double first() const { return world_from_box.translation().x() - radius_m; }
    double last() const { return world_from_box.translation().x() + radius_m; }
  };
  std::set<Pair> pairs;
  for (const Frame& frame : scene.frames) {
    std::vector<Standing> there;
    for (const MovingObject& actor : scene.actors)
      if (const auto pose = actor.world_from_box(frame.t_ns))
        there.push_back({&actor, changed.contains(actor.id), *pose, actor.size_m.norm() / 2});
    // Sorted along x: each is compared only with those that begin before it ends.
    std::ranges::sort(there, {}, &Standing::first);
    for (auto a = there.begin(); a != there.end(); ++a)
      for (auto b = a + 1; b != there.end() && b->first() <= a->last(); ++b)
        if ((a->is_changed || b->is_changed) && overlap(a->world_from_box, a->actor->size_m / 2,
                                                        b->world_from_box, b->actor->size_m / 2))
          pairs.insert(std::minmax(a->actor->id, b->actor->id));
  }
  return pairs;
}

/// Returns an object by its id; `field` names where the edit asks for it.
const MovingObject& find_own(const std::vector<MovingObject>& own, std::int64_t id,
                             const TrafficEdit& edit, const std::string& field) {
  const auto found = std::ranges::find(own, id, &MovingObject::id);
  if (found == own.end()) throw InputError(edit.file, field, std::to_string(id), known_ids(own));
  return *found;
}

/// Refuses an edit that the objects of a drive of this length cannot take. Reads bodies, too.
void check_edit(const TrafficEdit& edit, const std::vector<MovingObject>& own, double drive_s,
                const BodyOfFile& body_of_file) {
  const auto check = [&](const ActorChange& change, const std::string& field) {
    const auto within = [&](double t_s, const std::string& name) {
      if (t_s > drive_s)
        throw InputError(edit.file, field + name, std::to_string(t_s),
                         "must be within the drive, which takes " + std::to_string(drive_s) + " s");
    };
    if (change.hide_s) within((*change.hide_s)[0], ".hide_s[0]");
    if (!change.track.empty()) within(change.track.front().time_s, ".track[0].time_s");
    if (change.body) find_own(own, *change.body, edit, field + ".body");
    if (!change.body_file.empty()) body_of_file(change.body_file);
  };
  for (const auto& [id, change] : edit.actors) {
    const std::string field = "actors." + std::to_string(id);
    find_own(own, id, edit, field);
    check(change, field);
  }
  std::set<std::int64_t> ids;
  for (const MovingObject& actor : own) ids.insert(actor.id);
  const auto check_new = [&](std::int64_t id, const std::string& field) {
    if (!ids.insert(id).second)
      throw InputError(edit.file, field + ".id", std::to_string(id),
                       "must be an id that no object has");
  };
  for (std::size_t i = 0; i < edit.copies.size(); ++i) {
    const std::string field = "copies[" + std::to_string(i) + "]";
    find_own(own, edit.copies[i].of, edit, field + ".of");
    check(edit.copies[i].change, field);
    check_new(edit.copies[i].id, field);
  }
  for (std::size_t i = 0; i < edit.added.size(); ++i) {
    const std::string field = "added[" + std::to_string(i) + "]";
    check(edit.added[i].change, field);
    check_new(edit.added[i].id, field);
  }
}

/// Returns what somebody who edits should know: changed objects that are never there, and pairs
/// that overlap and did not `before`.
std::vector<std::string> remarks_on(const Scene& scene, const std::set<std::int64_t>& changed,
                                    const std::set<Pair>& before) {
  std::vector<std::string> remarks;
  for (const MovingObject& actor : scene.actors)
    if (changed.contains(actor.id) && std::ranges::none_of(scene.frames, [&](const Frame& frame) {
          return actor.world_from_box(frame.t_ns).has_value();
        }))
      remarks.push_back("object " + std::to_string(actor.id) + " is at no frame of the drive");
  for (const Pair& pair : overlapping(scene, changed))
    if (!before.contains(pair))
      remarks.push_back("objects " + std::to_string(pair.first) + " and " +
                        std::to_string(pair.second) + " overlap");
  return remarks;
}

}  // namespace

void check_added(const TrafficEdit& edit, bool draws_actors) {
  if (!edit.added.empty() && !draws_actors)
    throw InputError(edit.file, "added", "", "the run draws no moving objects");
}

Rigid3d own_motion(const ActorChange& change) {
  Rigid3d box_from_moved = Rigid3d::Identity();
  box_from_moved.translation() = Eigen::Vector3d(change.shift_m.data());
  box_from_moved.linear() =
      Eigen::AngleAxisd(kRadiansPerDegree * change.turn_deg, Eigen::Vector3d::UnitZ()).matrix();
  return box_from_moved;
}

std::vector<std::string> edit_actors(const TrafficEdit& edit, Scene* scene, ActorBodies* bodies) {
  std::set<std::int64_t> changed;
  for (const auto& [id, change] : edit.actors) changed.insert(id);
  for (const ActorCopy& copy : edit.copies) changed.insert(copy.id);
  for (const AddedActor& added : edit.added) changed.insert(added.id);
  const std::set<Pair> before = overlapping(*scene, changed);
  const std::vector<MovingObject> own = scene->actors;
  const double drive_s =
      1e-9 * static_cast<double>(scene->frames.back().t_ns - scene->frames.front().t_ns);
  ActorBodies of_this_edit;
  const BodyOfFile body_of_file = [&](const std::filesystem::path& file) {
    return (bodies ? *bodies : of_this_edit).read(edit.file.parent_path() / file);
  };
  check_edit(edit, own, drive_s, body_of_file);

  scene->actors.clear();
  for (const MovingObject& actor : own) {
    const auto change = edit.actors.find(actor.id);
    if (change != edit.actors.end() && change->second.remove) continue;
    scene->actors.push_back(actor);
    if (change != edit.actors.end())
      apply(change->second, *scene, own, body_of_file, &scene->actors.back());
  }
  const auto add = [&](const ActorChange& change, MovingObject actor) {
    if (change.remove) return;
    apply(change, *scene, own, body_of_file, &actor);
    scene->actors.push_back(std::move(actor));
  };
  for (const ActorCopy& copy : edit.copies) {
    MovingObject actor = find_own(own, copy.of, edit, "");
    if (!actor.body) actor.body = copy.of;
    actor.id = copy.id;
    add(copy.change, std::move(actor));
  }
  for (const AddedActor& added : edit.added) {
    MovingObject actor;
    actor.id = added.id;
    add(added.change, std::move(actor));
  }
  return remarks_on(*scene, changed, before);
}

const MovingObject& find_actor(const Scene& scene, const char* option, std::int64_t id) {
  const auto found = std::ranges::find(scene.actors, id, &MovingObject::id);
  if (found == scene.actors.end())
    throw UsageError(option, std::to_string(id), known_ids(scene.actors));
  return *found;
}

void select_actors(std::string_view chosen, Scene* scene) {
  if (chosen == "all") return;
  std::set<std::int64_t> ids;
  for (std::size_t begin = 0; chosen != "none" && begin <= chosen.size();) {
    const std::size_t end = std::min(chosen.find(',', begin), chosen.size());
    std::int64_t id = 0;
    const auto [last, error] = std::from_chars(chosen.data() + begin, chosen.data() + end, id);
    if (error != std::errc{} || last != chosen.data() + end)
      throw UsageError("--actors", std::string(chosen), "must be all, none or ids such as 3,17");
    find_actor(*scene, "--actors", id);
    ids.insert(id);
    begin = end + 1;
  }
  std::erase_if(scene->actors, [&](const MovingObject& actor) { return !ids.contains(actor.id); });
}

}  // namespace redrive
