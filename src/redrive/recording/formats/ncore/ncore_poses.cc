// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore_poses.h"

#include "redrive/base/error.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/parse/rigid_json.h"

namespace redrive::ncore {
namespace {

/// Parses the text of a tuple of two names in Python, ('rig', 'world').
std::optional<std::pair<std::string, std::string>> parse_key(std::string_view key) {
  std::vector<std::string> names;
  for (std::size_t at = 0; at < key.size();) {
    const std::size_t begin = key.find_first_of("'\"", at);
    if (begin == key.npos) break;
    const std::size_t end = key.find(key[begin], begin + 1);
    if (end == key.npos) return std::nullopt;
    names.emplace_back(key.substr(begin + 1, end - begin - 1));
    at = end + 1;
  }
  if (names.size() != 2) return std::nullopt;
  return std::pair(names[0], names[1]);
}

std::pair<std::string, std::string> require_key(const JsonField& of, const std::string& key) {
  const auto names = parse_key(key);
  if (!names) throw InputError(of.file(), key, "", "must be a pair of names");
  return *names;
}

std::vector<FramePose> read_moving(const JsonField& moving, bool inverse,
                                   std::vector<DamagedRecord>* damaged) {
  const JsonField poses = moving.at("poses"), times = moving.at("timestamps_us");
  if (poses.size() != times.size()) times.fail("must have as many times as there are poses");
  std::vector<FramePose> out;
  const DamagedList list{"poses", damaged};
  for (std::size_t i = 0; i < times.size(); ++i)
    parse_record(&list, -1, [&] {
      const std::int64_t us = times.at(i).integer();
      if (us < 0 || us > kMaxTime_us) times.at(i).fail("must be a time in microseconds");
      const Rigid3d pose = rigid_from_json(poses.at(i));
      if (!out.empty() && 1000 * us <= out.back().t_ns)
        times.at(i).fail("must be later than the one before");
      out.push_back({std::ssize(out), 1000 * us, inverse ? pose.inverse(Eigen::Isometry) : pose});
    });
  return out;
}

}  // namespace

std::optional<Rigid3d> Poses::between(const std::string& from, const std::string& to) const {
  std::map<std::string, Rigid3d> reached{{from, Rigid3d::Identity()}};  // name_from_`from`
  for (bool grew = true; grew && !reached.contains(to);) {
    grew = false;
    for (const auto& [names, pose] : fixed) {
      const auto& [second, first] = names;
      if (const auto a = reached.find(second); a != reached.end() && !reached.contains(first))
        grew = reached.emplace(first, pose * a->second).second;
      else if (const auto b = reached.find(first); b != reached.end() && !reached.contains(second))
        grew = reached.emplace(second, pose.inverse(Eigen::Isometry) * b->second).second;
    }
  }
  const auto found = reached.find(to);
  return found == reached.end() ? std::nullopt : std::optional(found->second);
}

Poses read_poses(const Component& component, Recording* recording) {
  Poses out;
  const nlohmann::json fixed_json = component.attributes("static_poses"),
                       moving_json = component.attributes("dynamic_poses");
  const JsonField fixed(fixed_json, component.file("static_poses")),
      moving(moving_json, component.file("dynamic_poses"));
  for (const std::string& key : fixed.keys())
    out.fixed[require_key(fixed, key)] = rigid_from_json(fixed.at(key).at("pose"));
  out.file = moving.file();
  std::vector<std::string> others;
  for (const std::string& key : moving.keys()) {
    const auto names = require_key(moving, key);
    const bool inverse = names == std::pair<std::string, std::string>("world", "rig");
    if (inverse || names == std::pair<std::string, std::string>("rig", "world"))
      out.world_from_rig = read_moving(moving.at(key), inverse, &recording->damaged);
    else
      others.push_back(key);
  }
  if (out.world_from_rig.empty())
    throw InputError(out.file, "('rig', 'world')", "",
                     others.empty()
                         ? "is missing: poses of the rig in the world"
                         : "is missing: the sequence has poses of " + first_few(others) +
                               ", as photographs have; redrive reads their COLMAP model");
  if (!others.empty()) recording->findings.push_back({"poses", "not used: " + first_few(others)});
  const DamagedList damaged{"poses", &recording->damaged};
  leave_out_strays(out.file, "('rig', 'world').poses", damaged, &out.world_from_rig);
  return out;
}

}  // namespace redrive::ncore
