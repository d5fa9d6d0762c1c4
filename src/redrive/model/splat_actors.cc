// SPDX-License-Identifier: Apache-2.0
// Objects that move: where an image sees them, and what training corrects in their tracks.
#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/model/splat_model.h"

namespace redrive {

std::optional<std::size_t> SplatModel::actor_index(std::int64_t id) const {
  const auto found = std::ranges::find(actor_ids, id);
  if (found == actor_ids.end()) return std::nullopt;
  return static_cast<std::size_t>(found - actor_ids.begin());
}

SplatModel::DrawnActors SplatModel::drawn_actors(const ShutterPoses& poses) const {
  DrawnActors out{all(), {}, {}};
  const GaussianLayout layout = this->layout();
  std::vector<bool> shown(actor_ids.size());
  bool as_trained = true;
  for (const ShutterPoses::Actor& actor : poses.actors()) {
    const auto body = actor_index(actor.body);
    if (!body) continue;
    as_trained &= !shown[*body] && actor.gain == std::array<float, 3>{1, 1, 1};
    shown[*body] = true;
  }
  if (as_trained) {
    for (std::size_t a = 0; a < actor_ids.size(); ++a) {
      const auto seen = std::ranges::find(poses.actors(), actor_ids[a], &ShutterPoses::Actor::body);
      out.parts.push_back({layout.first_block(a), {}});
      if (seen != poses.actors().end()) out.parts.back().part_from_camera = seen->actor_from_camera;
    }
    return out;
  }
  std::vector<float> numbers(parameters.data(),
                             parameters.data() + layout.world_blocks() * kBlockSize);
  for (const ShutterPoses::Actor& actor : poses.actors()) {
    const auto a = actor_index(actor.body);
    if (!a) continue;
    out.parts.push_back({numbers.size() / kBlockSize, actor.actor_from_camera});
    const float* const first = parameters.data() + layout.first_block(*a) * kBlockSize;
    for (const float* block = first;
         block < parameters.data() + layout.first_block(*a + 1) * kBlockSize; block += kBlockSize) {
      numbers.insert(numbers.end(), block, block + kBlockSize);
      float* const copied = &*(numbers.end() - kBlockSize);
      for (int row = kColourRow; row < kDistanceRow; ++row)
        for (int lane = 0; lane < kGaussianBlock; ++lane)
          copied[row * kGaussianBlock + lane] *= actor.gain[(row - kColourRow) % 3];
    }
  }
  out.copied = Buffer<float>(numbers.size());
  std::ranges::copy(numbers, out.copied.data());
  out.gaussians = {numbers.size() / kBlockSize * kGaussianBlock, out.copied.span()};
  return out;
}

std::pair<std::size_t, std::size_t> SplatModel::motions_of(std::size_t actor) const {
  const std::int64_t first = actor == 0 ? 0 : actor_keys[actor - 1];
  return {
      blocks_size() + gains.size() + bounds_size() + kMotionSize * static_cast<std::size_t>(first),
      kMotionSize * static_cast<std::size_t>(actor_keys[actor] - first)};
}

void SplatModel::correct_poses(const Scene& scene, std::int64_t t_ns, ShutterPoses* poses) const {
  std::vector<ShutterPoses::Actor> actors = poses->actors();
  for (ShutterPoses::Actor& seen : actors) {
    const auto a = actor_index(seen.body);
    const auto object = std::ranges::find(scene.actors, seen.body, &MovingObject::id);
    if (!a || object == scene.actors.end() || object->is_refined) continue;
    const auto [first, n] = motions_of(*a);
    const auto at = object->key_time(t_ns);
    if (!at) continue;
    const Rigid3d own =
        moved(Rigid3d::Identity(), motion_at(parameters.span().subspan(first, n), *at));
    for (PlainPose& pose : seen.actor_from_camera)
      pose = plain(own.inverse(Eigen::Isometry) * rigid(pose));
  }
  poses->set_actors(std::move(actors));
}

void SplatModel::add_motion_gradients(
    const Scene& scene, std::int64_t t_ns, const ShutterPoses& poses,
    std::span<const GaussianPoseGradient<NumberMath<double>>> d_poses,
    std::span<float> gradients) const {
  for (const ShutterPoses::Actor& seen : poses.actors()) {
    const auto a = actor_index(seen.body);
    const auto object = std::ranges::find(scene.actors, seen.body, &MovingObject::id);
    if (!a || object == scene.actors.end() || object->is_refined) continue;
    const auto [first, n] = motions_of(*a);
    const auto at = object->key_time(t_ns);
    if (!at) continue;
    const PlainPose& middle = seen.actor_from_camera[seen.actor_from_camera.size() / 2];
    add_motion_gradient(d_poses[1 + *a], rigid(middle).translation(),
                        parameters.span().subspan(first, n), *at, gradients.subspan(first, n));
  }
}

void SplatModel::check_actors(const std::filesystem::path& recording,
                              const std::vector<MovingObject>& objects) const {
  for (const MovingObject& object : objects)
    if (!actor_index(object.id))
      throw InputError(recording, "boxes of object " + std::to_string(object.id), "",
                       "the object was not there when the run was trained");
  for (std::size_t a = 0; a < actor_ids.size(); ++a) {
    const auto object = std::ranges::find(objects, actor_ids[a], &MovingObject::id);
    const std::size_t found = object == objects.end() ? 0 : object->keys.size(),
                      trained = motions_of(a).second / kMotionSize;
    if (found != trained)
      throw InputError(recording, "boxes of object " + std::to_string(actor_ids[a]),
                       std::to_string(found),
                       "must be as many as when the run was trained, " + std::to_string(trained));
  }
}

void SplatModel::correct_actors(std::vector<MovingObject>* objects) const {
  for (MovingObject& object : *objects) {
    const auto a = actor_index(object.id);
    if (!a || object.is_refined) continue;
    const auto [first, n] = motions_of(*a);
    correct_track(parameters.span().subspan(first, n), &object);
  }
}

}  // namespace redrive
