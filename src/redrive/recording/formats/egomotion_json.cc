// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/egomotion_json.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive {
namespace {

constexpr double kMaxRadius_m = 1e7;  // the Earth's surface is at 6.4e6
constexpr double kMaxTime_s = 9e9;    // int64 nanoseconds end at 9.22e9 s

std::int64_t frame_id_from_key(const JsonField& entry, const std::string& key) {
  std::int64_t id = -1;
  const auto [end, error] = std::from_chars(key.data(), key.data() + key.size(), id);
  // One spelling per id: "7" and "007" would be two poses of one frame.
  if (error != std::errc() || end != key.data() + key.size() || id < 0 ||
      std::to_string(id) != key) {
    throw InputError(entry.file(), "key", "\"" + key + "\"",
                     "expected a frame id: a whole number without leading zeros");
  }
  return id;
}

/// Returns the name of the time field. It is the same in all entries: the two may have different
/// clocks.
const char* time_field(const JsonField& first_entry) {
  for (const char* name : {"time_host", "time"})
    if (first_entry.has(name)) return name;
  first_entry.fail("has neither time_host nor time (seconds)");
}

std::int64_t t_ns_from_json(const JsonField& time) {
  const double t_s = time.number();
  if (!(t_s >= 0 && t_s <= kMaxTime_s)) time.fail("expected a time in seconds from 0 to 9e9");
  return std::llround(t_s * 1e9);
}

}  // namespace

std::optional<Rigid3d> global_from_body_from_json(const JsonField& entry) {
  const char* const key = entry.has("RT_ECEF_body") ? "RT_ECEF_body" : "ECEF_RT_body";
  if (!entry.has(key)) return std::nullopt;
  const JsonField field = entry.at(key);
  const Rigid3d pose = rigid_from_json(field);
  if (pose.translation().norm() > kMaxRadius_m) {
    char value[64];
    std::snprintf(value, sizeof value, "translation of %.6g m", pose.translation().norm());
    throw InputError(field.file(), field.field(), value,
                     "further than 1e7 m from the Earth's centre; metres are expected");
  }
  return pose;
}

std::vector<FramePose> parse_egomotion(std::string_view text, const std::filesystem::path& file,
                                       const DamagedList* damaged) {
  const nlohmann::json document = parse_json(text, file);
  const JsonField root(document, file);
  std::vector<FramePose> frames;
  const char* time = nullptr;
  for (const std::string& key : root.keys()) {
    const JsonField entry = root.at(key);
    FramePose frame;
    frame.id = frame_id_from_key(entry, key);
    if (parse_record(damaged, frame.id, [&] {
          if (!time) time = time_field(entry);
          const std::optional<Rigid3d> pose = global_from_body_from_json(entry);
          if (!pose) entry.fail("has neither RT_ECEF_body nor ECEF_RT_body");
          frame.global_from_body = *pose;
          frame.t_ns = t_ns_from_json(entry.at(time));
        }))
      frames.push_back(frame);
  }
  if (frames.empty())
    throw InputError(file, "", "",
                     "holds no pose" + (damaged && !damaged->records->empty()
                                            ? "; " + damaged->records->front().why
                                            : std::string()));
  std::sort(frames.begin(), frames.end(), [](const auto& a, const auto& b) { return a.id < b.id; });
  leave_out_impossible(file, {"time", "RT_ECEF_body"}, damaged, &frames);
  return frames;
}

nlohmann::json egomotion_to_json(const std::vector<FramePose>& frames) {
  nlohmann::json poses = nlohmann::json::object();
  for (const FramePose& frame : frames) {
    const double t_s = static_cast<double>(frame.t_ns) * 1e-9;
    poses[std::to_string(frame.id)] = {
        {"RT_ECEF_body", rigid_to_json(frame.global_from_body)}, {"time", t_s}, {"time_host", t_s}};
  }
  return poses;
}

}  // namespace redrive
