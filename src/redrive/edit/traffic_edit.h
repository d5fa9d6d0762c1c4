// SPDX-License-Identifier: Apache-2.0
// Changes to the moving objects of a run:
//   {"actors": {"ID": CHANGE, ..}, "copies": [{"of": ID, "id": ID, CHANGE}, ..],
//    "added": [{"id": ID, "body": {"file": FILE}, "track": [..], CHANGE}, ..]}
// ID: the id of the object. The fields of CHANGE are the fields of ActorChange, whose body is an ID
// or {"file": FILE}; copies and added objects have an id that no object has.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string_view>
#include <vector>

namespace redrive {

constexpr double kMaxActorShift_m = 1e4;
constexpr double kMaxSpeed = 100;     ///< factor of the recorded speed
constexpr double kMaxEdit_s = 86400;  ///< after the first frame
constexpr std::size_t kMaxTrackPoints = 10'000;
constexpr std::size_t kMaxEditedActors = 1000;

/// A pose of an object's track, interpolated between points.
struct TrackPoint {
  double time_s = 0;                   ///< after the run's first frame; times increase
  std::array<double, 3> position_m{};  ///< position of the box's centre, in the world of the run
  double yaw_deg = 0;    ///< heading of its length about the world's z axis, from x to y
  double pitch_deg = 0;  ///< then pitch of its front, upwards
  double roll_deg = 0;   ///< then about its length, its left side upwards
};

/// Changes to one object, applied in this order.
struct ActorChange {
  bool remove = false;
  std::vector<TrackPoint> track;  ///< replaces its own; at least two points, or empty
  double speed = 1;  ///< factor along the track, from its first time on, 0: it stands; 0..kMaxSpeed
  std::array<double, 3> shift_m{};              ///< in its own axes: forward, left, up
  double turn_deg = 0;                          ///< about its own up axis, positive to the left
  std::optional<std::array<double, 2>> hide_s;  ///< not drawn from, to, after the first frame
  std::optional<std::int64_t> body;             ///< id of the object whose Gaussians it shows
  std::array<double, 3> gain{1, 1, 1};          ///< factors of its colours, 0..100
  /// In the axes of the drive at the nearest frame (forward, left, up), in addition to shift_m.
  std::array<double, 3> shift_road_m{};
  /// An exported body (edit/actor_body.h) instead of `body`; relative to the folder of the edit's
  /// file. Empty: none.
  std::filesystem::path body_file;
};

struct ActorCopy {
  std::int64_t of = 0, id = 0;
  ActorChange change;
};

/// An object of no recording: its change has a body_file and a track.
struct AddedActor {
  std::int64_t id = 0;
  ActorChange change;
};

struct TrafficEdit {
  std::filesystem::path file;
  std::map<std::int64_t, ActorChange> actors;
  std::vector<ActorCopy> copies;
  std::vector<AddedActor> added;
};

/// InputError where a field is unknown, of another type or out of range.
TrafficEdit parse_traffic_edit(std::string_view text, const std::filesystem::path& file);
TrafficEdit read_traffic_edit(const std::filesystem::path& file);

}  // namespace redrive
