// SPDX-License-Identifier: Apache-2.0
// Moving objects: where an image or a ray sees them, and what training corrects in their tracks.
#include <algorithm>
#include <utility>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/methods/splat/actors/fill_hidden.h"
#include "redrive/methods/splat/lidar/trace_gaussians.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

/// Rays that meet an object's box, in its axes.
struct RaysOfActor {
  std::vector<std::size_t> index;        ///< among all rays
  std::vector<float> origin, direction;  ///< [3, n]
};

RaysOfActor rays_of_actor(const kernels::Rays& rays, std::span<const std::int64_t> t_ns,
                          const MovingObject& actor) {
  const auto n = static_cast<std::size_t>(rays.n);
  const auto in_world = [&](std::span<const float> xyz, std::size_t i) {
    return Eigen::Vector3d(xyz[i], xyz[n + i], xyz[2 * n + i]);
  };
  const Eigen::Vector3d half_m = actor.size_m / 2 + Eigen::Vector3d::Constant(kBeyondBox_m);
  RaysOfActor met;
  std::vector<Eigen::Vector3f> origins, directions;
  std::optional<MovingBox> box;
  for (std::size_t i = 0; i < n; ++i) {
    if (i == 0 || t_ns[i] != t_ns[i - 1]) {
      box.reset();
      if (const auto world_from_actor = actor.world_from_box(t_ns[i]))
        box = MovingBox{actor.id, world_from_actor->inverse(Eigen::Isometry), half_m};
    }
    const Eigen::Vector3d origin = in_world(rays.origin, i),
                          direction = in_world(rays.direction, i);
    if (!box || !box->intersects(origin, direction)) continue;
    met.index.push_back(i);
    origins.push_back((box->box_from_world * origin).cast<float>());
    directions.push_back((box->box_from_world.linear() * direction).cast<float>());
  }
  for (int k = 0; k < 3; ++k)
    for (std::size_t m = 0; m < met.index.size(); ++m) {
      met.origin.push_back(origins[m][k]);
      met.direction.push_back(directions[m][k]);
    }
  return met;
}

/// Adds what ray j meets of another object to ray i.
void add_surface(const RenderedRays& from, std::size_t j, RenderedRays* to, std::size_t i) {
  constexpr float kOpaque = 0.5f;  // as for the median depth
  const float depth = from.depth[j], opacity = from.opacity[j];
  const bool nearer = depth > 0 && (!(to->depth[i] > 0) || depth < to->depth[i]);
  const float front = nearer ? opacity : to->opacity[i], behind = nearer ? to->opacity[i] : opacity;
  const bool front_counts = front >= kOpaque || front >= behind;
  // What comes back from behind is seen through the front.
  const float front_returns = 1 - (nearer ? from.lost[j] : to->lost[i]),
              back_returns = 1 - (nearer ? to->lost[i] : from.lost[j]);
  if (nearer == front_counts) {
    to->depth[i] = depth;
    to->intensity[i] = from.intensity[j];
  }
  to->lost[i] = 1 - front_returns - (1 - front) * back_returns;
  to->opacity[i] = 1 - (1 - to->opacity[i]) * (1 - opacity);
}

}  // namespace

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
    as_trained &= !actor.imported;
    const auto body = actor_index(actor.body);
    if (!body || actor.imported) continue;
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
  std::vector<std::pair<const ShutterPoses::Actor*, std::span<const float>>> shows;
  std::size_t at = layout.world_blocks() * kBlockSize, size = at;
  for (const ShutterPoses::Actor& actor : poses.actors())
    if (const std::span<const float> blocks = blocks_of(actor.body, actor.imported.get());
        !blocks.empty()) {
      shows.emplace_back(&actor, blocks);
      size += blocks.size();
    }
  out.copied = Buffer<float>(size);
  std::ranges::copy(parameters.span().first(at), out.copied.data());
  for (const auto& [actor, blocks] : shows) {
    out.parts.push_back({at / kBlockSize, actor->actor_from_camera});
    for (std::size_t i = 0; i < blocks.size(); ++i) {
      const auto row = static_cast<int>(i % kBlockSize) / kGaussianBlock;
      const bool is_colour = row >= kColourRow && row < kLidarRow;
      out.copied[at + i] = blocks[i] * (is_colour ? actor->gain[(row - kColourRow) % 3] : 1.0f);
    }
    at += blocks.size();
  }
  out.gaussians = {size / kBlockSize * kGaussianBlock, out.copied.span()};
  return out;
}

std::span<const float> SplatModel::blocks_of(std::int64_t id, const ActorBody* imported) const {
  if (imported) return imported->numbers;
  const auto a = actor_index(id);
  if (!a) return {};
  const std::size_t first = layout().first_block(*a), end = layout().first_block(*a + 1);
  return parameters.span().subspan(first * kBlockSize, (end - first) * kBlockSize);
}

float SplatModel::ahead_m() const {
  constexpr float kDark = 0.25f;  // mean of the images, 0..1: 0.14 by night, from 0.35 on by day
  return (background[0] + background[1] + background[2]) / 3 < kDark ? kHeadlights_m : kShadow_m;
}

void SplatModel::bound_actor_colours() {
  for (std::size_t block = layout().world_blocks(); block < layout().blocks(); ++block)
    for (int row = kColourRow; row < kHarmonicsRow; ++row)
      for (std::size_t i = 0; i < kGaussianBlock; ++i) {
        float& colour = parameters[gaussian_slot(block * kGaussianBlock + i, row)];
        colour = std::clamp(colour, 0.0f, 1.0f);
      }
}

ActorBody SplatModel::body(const MovingObject& actor) const {
  const std::span<const float> blocks = blocks_of(actor.id, nullptr);
  std::vector<std::size_t> used;
  for (std::size_t i = 0; i < blocks.size() / kGaussianRows; ++i)
    if (blocks[gaussian_slot(i, kOpacityRow)] > kUnusedOpacity) used.push_back(i);
  ActorBody out;
  out.type = actor.type;
  out.size_m = actor.size_m;
  out.n = used.size();
  out.numbers = Buffer<float>(gaussian_blocks(out.n) * kBlockSize);
  for (std::size_t i = 0; i < out.n; ++i)
    for (int row = 0; row < kGaussianRows; ++row)
      out.numbers[gaussian_slot(i, row)] = blocks[gaussian_slot(used[i], row)];
  clear_unused(out.n, gaussian_blocks(out.n) * kGaussianBlock, out.numbers.data());
  return out;
}

void SplatModel::trace_actors(kernels::Backend& backend, const kernels::Rays& rays,
                              std::span<const std::int64_t> t_ns,
                              const std::vector<MovingObject>& actors,
                              RenderedRays* rendered) const {
  if (rendered->lost.empty()) {
    rendered->intensity.assign(rendered->depth.size(), 0);
    for (const float opacity : rendered->opacity) rendered->lost.push_back(1 - opacity);
  }
  for (const MovingObject& actor : actors) {
    const std::span<const float> blocks =
        blocks_of(actor.body.value_or(actor.id), actor.imported.get());
    if (blocks.empty()) continue;
    const RaysOfActor met = rays_of_actor(rays, t_ns, actor);
    if (met.index.empty()) continue;
    const RenderedRays own = trace_gaussians(
        backend.gaussians(), backend.pool(), {blocks.size() / kGaussianRows, blocks},
        {static_cast<int>(met.index.size()), met.origin, met.direction});
    for (std::size_t m = 0; m < met.index.size(); ++m) add_surface(own, m, rendered, met.index[m]);
  }
}

std::pair<std::size_t, std::size_t> SplatModel::motions_of(std::size_t actor) const {
  const std::int64_t first = actor == 0 ? 0 : actor_keys[actor - 1];
  return {gains.size() + bounds_size() + kMotionSize * static_cast<std::size_t>(first),
          kMotionSize * static_cast<std::size_t>(actor_keys[actor] - first)};
}

ShutterPoses SplatModel::shutter_poses(const Scene& scene, const View& view) const {
  std::vector<MovingObject> actors = scene.actors;
  correct_actors(&actors);
  return scene.shutter_poses(view, actors);
}

int SplatModel::add_motion_gradients(
    const Scene& scene, std::int64_t t_ns, const ShutterPoses& poses,
    std::span<const GaussianPoseGradient<NumberMath<double>>> d_poses,
    std::span<float> gradients) const {
  int left_out = 0;
  for (const ShutterPoses::Actor& seen : poses.actors()) {
    const auto a = actor_index(seen.body);
    const auto object = std::ranges::find(scene.actors, seen.body, &MovingObject::id);
    if (!a || object == scene.actors.end()) continue;
    const auto [first, n] = motions_of(*a);
    const auto at = object->key_time(t_ns);
    if (!at) continue;
    const PlainPose& middle = seen.actor_from_camera[seen.actor_from_camera.size() / 2];
    left_out += !add_motion_gradient(d_poses[1 + *a], rigid(middle).translation(),
                                     motion_parameters(*a), *at, gradients.subspan(first, n));
  }
  return left_out;
}

void SplatModel::finish_training(kernels::Backend& backend, const TrainingSet& data,
                                 AdamState* adam) {
  constexpr int kFillPixels = 60000;  // maximum number of pixels of a reduced image
  constexpr std::size_t kMostViews = 96;
  if (filled || actor_ids.empty()) return;
  filled = 1;
  std::vector<int> training;
  for (int v = 0; v < std::ssize(data.scene.views); ++v)
    if (!data.scene.views[v].held_out) training.push_back(v);
  const std::size_t every = (training.size() + kMostViews - 1) / kMostViews;
  FillViews views;
  views.n = (training.size() + every - 1) / every;
  views.view = [&](std::size_t i) {
    const View& of = data.scene.views[training[i * every]];
    const RigCamera& rig = data.scene.rig[of.camera];
    int factor = 1;
    while (rig.camera.width / factor * (rig.camera.height / factor) > kFillPixels) ++factor;
    FillView out{rig.camera.downscaled(factor), shutter_poses(data.scene, of), {}, {}};
    out.parts = drawn_actors(out.poses).parts;
    const ImagePointer image = data.images[training[i * every]];
    for (int y = 0; !image->used.empty() && y < out.camera.height; ++y)
      for (int x = 0; x < out.camera.width; ++x) {
        const int row = y * factor + factor / 2, column = x * factor + factor / 2;
        out.used.push_back(image->used[static_cast<std::size_t>(row) * image->width + column]);
      }
    return out;
  };
  const HiddenPlaces hidden = find_hidden(backend.gaussians(), views, all(), layout().world);
  if (hidden.gaussians.empty()) return;
  for (const std::size_t i : hidden.gaussians)
    parameters[gaussian_slot(i, kOpacityRow)] = kUnusedOpacity;
  DensifyOptions options;
  options.min_opacity = 0;
  options.spare = std::min(fills_needed(hidden),
                           hidden.gaussians.size() + static_cast<std::size_t>(most_fills()));
  change_number(options, 0, adam);
  fill_holes(backend.gaussians(), views, hidden, all().n, layout().world, options.spare,
             parameters.span().first(blocks_size()));
}

void SplatModel::check_actors(const std::filesystem::path& recording,
                              const std::filesystem::path& found,
                              const std::vector<MovingObject>& objects) const {
  const auto file_of = [&](std::int64_t id) { return id < 0 ? found : recording; };
  for (const MovingObject& object : objects)
    if (!actor_index(object.id))
      throw InputError(file_of(object.id), "boxes of object " + std::to_string(object.id), "",
                       "the object was not there when the run was trained");
  for (std::size_t a = 0; a < actor_ids.size(); ++a) {
    const auto object = std::ranges::find(objects, actor_ids[a], &MovingObject::id);
    const std::size_t boxes = object == objects.end() ? 0 : object->keys.size(),
                      trained = motions_of(a).second / kMotionSize;
    if (boxes != trained)
      throw InputError(file_of(actor_ids[a]), "boxes of object " + std::to_string(actor_ids[a]),
                       std::to_string(boxes),
                       "must be as many as when the run was trained, " + std::to_string(trained));
  }
}

void SplatModel::correct_actors(std::vector<MovingObject>* objects) const {
  for (MovingObject& object : *objects)
    if (const auto a = actor_index(object.id)) {
      const std::span<const float> motions = motion_parameters(*a);
      object.corrections.assign(motions.begin(), motions.end());
    }
}

}  // namespace redrive
