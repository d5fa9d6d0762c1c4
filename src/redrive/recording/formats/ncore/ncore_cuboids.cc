// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/ncore/ncore_cuboids.h"

#include <algorithm>
#include <cstdlib>

#include "redrive/base/error.h"
#include "redrive/recording/core/labels.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/recording/formats/timed_images.h"
#include "redrive/recording/parse/json_numbers.h"

namespace redrive::ncore {
namespace {

constexpr double kMaxSize_m = 100, kMaxCoordinate_m = 1e6;
constexpr std::int64_t kNear_ns = 100'000'000,
                       kNearAnchor_ns = 60'000'000;  // between scans 0.1 s apart

/// Angles about the fixed axes x, then y, then z.
Rigid3d pose_of(const std::array<double, 3>& at, const std::array<double, 3>& turn) {
  Rigid3d pose = Rigid3d::Identity();
  pose.translation() = Eigen::Vector3d(at[0], at[1], at[2]);
  pose.linear() = (Eigen::AngleAxisd(turn[2], Eigen::Vector3d::UnitZ()) *
                   Eigen::AngleAxisd(turn[1], Eigen::Vector3d::UnitY()) *
                   Eigen::AngleAxisd(turn[0], Eigen::Vector3d::UnitX()))
                      .toRotationMatrix();
  return pose;
}

std::int64_t time_ns(const JsonField& field) {
  const std::int64_t us = field.integer();
  if (us < 0 || us > kMaxTime_us) field.fail("must be a time in microseconds");
  return 1000 * us;
}

Cuboid parse_cuboid(const JsonField& entry, const Poses& poses) {
  Cuboid cuboid;
  cuboid.t_ns = time_ns(entry.at("timestamp_us"));
  cuboid.track = entry.at("track_id").string();
  cuboid.type = entry.at("class_id").string();
  if (cuboid.track.empty()) entry.at("track_id").fail("must be a name");
  if (cuboid.type.empty()) entry.at("class_id").fail("must be a name");
  const JsonField box = entry.at("bbox3"), in = entry.at("reference_frame_id");
  const auto size = numbers_within<3>(box.at("dim"), 1e-3, kMaxSize_m, "above 0, at most 100 m");
  cuboid.size_m = {size[0], size[1], size[2]};
  const Rigid3d in_reference =
      pose_of(numbers_within<3>(box.at("centroid"), -kMaxCoordinate_m, kMaxCoordinate_m,
                                "metres, at most 1e6"),
              numbers_within<3>(box.at("rot"), -10, 10, "three angles in rad"));
  if (in.string() == "world") {
    cuboid.world_from_box = in_reference;
    return cuboid;
  }
  const auto rig_from_reference = poses.between(in.string(), "rig");
  if (!rig_from_reference) in.fail("has no pose in the rig");
  const std::int64_t t_ns = time_ns(entry.at("reference_frame_timestamp_us"));
  cuboid.world_from_box = pose_at(poses.world_from_rig, t_ns) * *rig_from_reference * in_reference;
  return cuboid;
}

}  // namespace

std::vector<Cuboid> read_cuboids(const Component& component, const Poses& poses,
                                 std::vector<std::string>* impossible) {
  const nlohmann::json attributes = component.attributes("cuboids");
  const JsonField list =
      JsonField(attributes, component.file("cuboids")).at("cuboid_track_observations");
  std::vector<Cuboid> cuboids;
  for (std::size_t i = 0; i < list.size(); ++i) try {
      cuboids.push_back(parse_cuboid(list.at(i), poses));
    } catch (const InputError& error) {
      impossible->push_back(error.what());
    }
  std::ranges::stable_sort(cuboids, {}, &Cuboid::t_ns);
  return cuboids;
}

std::map<std::int64_t, std::vector<Box>> boxes_of_frames(const std::vector<Cuboid>& cuboids,
                                                         const std::vector<FramePose>& frames,
                                                         const std::vector<FramePose>& anchors) {
  std::map<std::string, std::int64_t> ids;
  for (const Cuboid& cuboid : cuboids) ids.try_emplace(cuboid.track, 0);
  for (std::int64_t next = 0; auto& [track, id] : ids) id = next++;
  std::map<std::pair<std::int64_t, std::int64_t>, const Cuboid*> nearest;  // key: frame, object
  for (const Cuboid& cuboid : cuboids) {
    const auto off = [&](const FramePose& frame) { return std::abs(frame.t_ns - cuboid.t_ns); };
    const FramePose& near = nearest_frame(anchors, cuboid.t_ns);
    const FramePose& anchor =
        off(near) <= kNearAnchor_ns ? near : nearest_frame(frames, cuboid.t_ns);
    const std::int64_t off_ns = off(anchor);
    if (off_ns > kNear_ns) continue;
    const auto [place, is_new] = nearest.try_emplace({anchor.id, ids.at(cuboid.track)}, &cuboid);
    if (!is_new && off_ns < std::abs(anchor.t_ns - place->second->t_ns)) place->second = &cuboid;
  }
  std::vector<Label> labels;
  for (const auto& [key, cuboid] : nearest) {
    Label label;
    label.frame_id = key.first;
    label.object_id = key.second;
    label.type = cuboid->type;
    label.size_m = cuboid->size_m;
    label.sensor_from_box =
        pose_at(frames, cuboid->t_ns).inverse(Eigen::Isometry) * cuboid->world_from_box;
    labels.push_back(std::move(label));
  }
  return place_boxes(labels, Rigid3d::Identity(), frames,
                     [&](const Label& label, const FramePose&) {
                       return nearest.at({label.frame_id, label.object_id})->t_ns;
                     });
}

}  // namespace redrive::ncore
