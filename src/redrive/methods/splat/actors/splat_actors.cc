// SPDX-License-Identifier: Apache-2.0
// Moving objects: where an image or a ray sees them, and what training corrects in their tracks.
#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/field/gaussian_blocks.h"
#include "redrive/methods/splat/actors/articulated.h"
#include "redrive/methods/splat/actors/fill_hidden.h"
#include "redrive/methods/splat/splat_model.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

/// The pose of a part that moves by `motion` with `pivot` as the origin of its axes.
Rigid3d box_from_part(const Rigid3d& motion, const Eigen::Vector3d& pivot) {
  return Eigen::Translation3d(pivot) * motion * Eigen::Translation3d(-pivot);
}

/// Returns the mean of a track's corrections.
Rigid3d mean_motion(std::span<const float> motions) {
  std::array<float, kMotionSize> mean{};
  const auto keys = static_cast<float>(motions.size() / kMotionSize);
  for (std::size_t i = 0; i < motions.size(); ++i) mean[i % kMotionSize] += motions[i] / keys;
  return rigid_from_vector(mean.data());
}

/// Moves Gaussian i of `blocks` [*, kGaussianRows, 16].
void move_gaussian(const Rigid3d& by, std::size_t i, Buffer<float>* blocks) {
  const auto at = [&](int row) -> float& { return (*blocks)[gaussian_slot(i, row)]; };
  Eigen::Vector3d position;
  for (int k = 0; k < 3; ++k) position[k] = double(at(kPositionRow + k));
  position = by * position;
  for (int k = 0; k < 3; ++k) at(kPositionRow + k) = static_cast<float>(position[k]);
  const Eigen::Quaterniond turned =
      Eigen::Quaterniond(by.linear()) *
      Eigen::Quaterniond(double(at(kQuaternionRow)), double(at(kQuaternionRow + 1)),
                         double(at(kQuaternionRow + 2)), double(at(kQuaternionRow + 3)));
  const double wxyz[4] = {turned.w(), turned.x(), turned.y(), turned.z()};
  for (int k = 0; k < 4; ++k) at(kQuaternionRow + k) = static_cast<float>(wxyz[k]);
}

}  // namespace

std::optional<SplatModel::ActorParts> SplatModel::actor_parts(std::int64_t id) const {
  const auto found = std::ranges::equal_range(actor_ids, id);
  if (found.empty()) return std::nullopt;
  const auto first = static_cast<std::size_t>(found.begin() - actor_ids.begin());
  return ActorParts{first, first + found.size()};
}

Eigen::Vector3d SplatModel::pivot(std::size_t a, const ActorParts& parts) const {
  if (parts.size() == 1) return Eigen::Vector3d::Zero();
  const float* const bound = &parameters[blocks_size() + gains.size() + 3 * a];
  Eigen::Vector3d size_m;
  for (int k = 0; k < 3; ++k) size_m[k] = 2 * double(bound[k] - kBeyondBox_m);
  return pivot_of(a - parts.first, size_m);
}

std::size_t SplatModel::track_part(const ActorParts& parts) const {
  return parts.first + (parts.size() == 1 ? 0 : kMiddlePart);
}

std::vector<PlainPose> SplatModel::part_from_camera(std::size_t a, const ActorParts& parts,
                                                    const ShutterPoses::Actor& seen) const {
  std::vector<PlainPose> poses = seen.actor_from_camera;
  const std::size_t of_track = track_part(parts);
  if (a == of_track || seen.key_times.size() != poses.size()) return poses;
  const std::span<const float> own = motion_parameters(a), track = motion_parameters(of_track);
  const std::size_t last = own.size() / kMotionSize - 1;
  for (std::size_t k = 0; k < poses.size(); ++k) {
    // Another track, as of an edit, may have more keys.
    const std::size_t before = std::min(seen.key_times[k].before, last),
                      after = std::min(seen.key_times[k].after, last);
    const auto motion_of = [&](std::span<const float> motions) {
      const auto six = interpolate_vector6(&motions[kMotionSize * before],
                                           &motions[kMotionSize * after], seen.key_times[k].part);
      return rigid_from_vector(six.data());
    };
    poses[k] = plain(box_from_part(motion_of(own), pivot(a, parts)).inverse(Eigen::Isometry) *
                     motion_of(track) * rigid(poses[k]));
  }
  return poses;
}

std::vector<SeenActor> seen_actors_of(const kernels::RasterImage& image,
                                      const DrawnGaussians& shown) {
  std::vector<std::size_t> parts;  // number of each object's
  for (const kernels::GaussianPart& part : shown.parts) {
    if (!part.continues) parts.push_back(0);
    ++parts.back();
  }
  std::vector<SeenActor> seen;
  for (std::size_t object = 0; object < shown.numbers.size(); ++object)
    if (const kernels::PartExtent& extent = image.extents[object]; extent.whole > 0)
      seen.push_back({shown.numbers[object], extent.visible, extent.whole, extent.left, extent.top,
                      extent.right, extent.bottom, parts[object] > 1});
  std::ranges::sort(seen, {}, &SeenActor::number);
  return seen;
}

DrawnGaussians SplatModel::drawn(std::vector<ShutterPoses::Actor> actors) const {
  DrawnGaussians out{all(), {}, std::move(actors)};
  const GaussianLayout layout = this->layout();
  // Poses of part `a`, which `out` keeps.
  const auto poses_of = [&](std::size_t a, const ActorParts& parts,
                            const ShutterPoses::Actor& seen) -> std::span<const PlainPose> {
    if (parts.size() == 1) return seen.actor_from_camera;
    return out.poses.emplace_back(part_from_camera(a, parts, seen));
  };
  std::vector<bool> shown(actor_ids.size());
  bool as_trained = true;
  for (const ShutterPoses::Actor& actor : out.actors) {
    as_trained &= !actor.imported;
    const auto body = actor_parts(actor.body);
    if (!body || actor.imported) continue;
    as_trained &= !shown[body->first] && actor.gain == std::array<float, 3>{1, 1, 1};
    shown[body->first] = true;
  }
  if (as_trained) {
    for (std::size_t first = 0; first < actor_ids.size();) {
      const ActorParts parts = *actor_parts(actor_ids[first]);
      const auto seen = std::ranges::find(out.actors, actor_ids[first], &ShutterPoses::Actor::body);
      const bool is_seen = seen != out.actors.end();
      for (std::size_t a = first; a < parts.end; ++a)
        out.parts.push_back({layout.first_block(a),
                             is_seen ? poses_of(a, parts, *seen) : std::span<const PlainPose>(),
                             a > first});
      out.numbers.push_back(is_seen ? seen->number : 0);
      first = parts.end;
    }
    return out;
  }
  struct Shown {
    const ShutterPoses::Actor* actor;
    std::span<const float> blocks;
    std::span<const PlainPose> poses;
    bool continues;
  };
  std::vector<Shown> shows;
  for (const ShutterPoses::Actor& actor : out.actors) {
    const auto parts = actor_parts(actor.body);
    if (actor.imported) {
      if (const auto blocks = blocks_of(actor.body, actor.imported.get()); !blocks.empty())
        shows.push_back({&actor, blocks, actor.actor_from_camera, false});
      continue;
    }
    for (std::size_t a = parts ? parts->first : 0; parts && a < parts->end; ++a)
      shows.push_back({&actor, blocks_of_part(a), poses_of(a, *parts, actor), a > parts->first});
  }
  std::size_t at = layout.world_blocks() * kBlockSize, size = at;
  for (const Shown& show : shows) size += show.blocks.size();
  out.copied = Buffer<float>(size);
  std::ranges::copy(parameters.span().first(at), out.copied.data());
  for (const Shown& show : shows) {
    out.parts.push_back({at / kBlockSize, show.poses, show.continues});
    if (!show.continues) out.numbers.push_back(show.actor->number);
    for (std::size_t i = 0; i < show.blocks.size(); ++i) {
      const auto row = static_cast<int>(i % kBlockSize) / kGaussianBlock;
      const bool is_colour = row >= kColourRow && row < kLidarRow;
      out.copied[at + i] =
          show.blocks[i] * (is_colour ? show.actor->gain[(row - kColourRow) % 3] : 1.0f);
    }
    at += show.blocks.size();
  }
  out.gaussians = {size / kBlockSize * kGaussianBlock, out.copied.span()};
  return out;
}

std::span<const float> SplatModel::blocks_of_part(std::size_t a) const {
  const std::size_t first = layout().first_block(a), end = layout().first_block(a + 1);
  return parameters.span().subspan(first * kBlockSize, (end - first) * kBlockSize);
}

std::span<const float> SplatModel::blocks_of(std::int64_t id, const ActorBody* imported) const {
  if (imported) return imported->numbers;
  const auto parts = actor_parts(id);
  if (!parts) return {};
  const std::size_t first = layout().first_block(parts->first),
                    end = layout().first_block(parts->end);
  return parameters.span().subspan(first * kBlockSize, (end - first) * kBlockSize);
}

float SplatModel::ahead_m() const {
  constexpr float kDark = 0.25f;  // mean of the images, 0..1: 0.14 by night, from 0.35 on by day
  return (background[0] + background[1] + background[2]) / 3 < kDark ? kHeadlights_m : kShadow_m;
}

ActorBody SplatModel::body(const MovingObject& actor) const {
  ActorBody out;
  out.type = actor.type;
  out.size_m = actor.size_m;
  const auto parts = actor_parts(actor.id);
  if (!parts) return out;
  std::vector<std::pair<std::size_t, std::size_t>> used;  // part, index among its Gaussians
  for (std::size_t a = parts->first; a < parts->end; ++a) {
    const std::span<const float> blocks = blocks_of_part(a);
    for (std::size_t i = 0; i < blocks.size() / kGaussianRows; ++i)
      if (blocks[gaussian_slot(i, kOpacityRow)] > kUnusedOpacity) used.emplace_back(a, i);
  }
  out.n = used.size();
  out.numbers = Buffer<float>(gaussian_blocks(out.n) * kBlockSize);
  const std::size_t of_track = track_part(*parts);
  for (std::size_t i = 0; i < out.n; ++i) {
    const auto [a, at] = used[i];
    for (int row = 0; row < kGaussianRows; ++row)
      out.numbers[gaussian_slot(i, row)] = blocks_of_part(a)[gaussian_slot(at, row)];
    if (a != of_track)  // where the part is on average
      move_gaussian(mean_motion(motion_parameters(of_track)).inverse(Eigen::Isometry) *
                        box_from_part(mean_motion(motion_parameters(a)), pivot(a, *parts)),
                    i, &out.numbers);
  }
  clear_unused(out.n, gaussian_blocks(out.n) * kGaussianBlock, out.numbers.data());
  return out;
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
    const Scene& scene, std::int64_t t_ns, const DrawnGaussians& drawn,
    std::span<const GaussianPoseGradient<NumberMath<double>>> d_poses,
    std::span<float> gradients) const {
  int left_out = 0;
  for (const ShutterPoses::Actor& seen : drawn.actors) {
    const auto parts = actor_parts(seen.body);
    const auto object = std::ranges::find(scene.actors, seen.body, &MovingObject::id);
    if (!parts || object == scene.actors.end()) continue;
    const auto at = object->key_time(t_ns);
    if (!at) continue;
    bool finite = true;
    for (std::size_t a = parts->first; a < parts->end; ++a) {
      const auto [first, n] = motions_of(a);
      const std::span<const PlainPose> poses = drawn.parts[a].part_from_camera;
      const Eigen::Vector3d camera =
          rigid(poses[poses.size() / 2]).translation() - pivot(a, *parts);
      finite &= add_motion_gradient(d_poses[1 + a], camera, motion_parameters(a), *at,
                                    gradients.subspan(first, n));
    }
    left_out += !finite;
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
    out.drawn = drawn(out.poses.actors());
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
  change_number(options, 0, adam, backend.pool());
  fill_holes(backend.gaussians(), views, hidden, all().n, layout().world, options.spare,
             parameters.span().first(blocks_size()));
  renew_version();
}

void SplatModel::check_actors(const std::filesystem::path& recording,
                              const std::filesystem::path& found,
                              const std::vector<MovingObject>& objects) const {
  const auto file_of = [&](std::int64_t id) { return id < 0 ? found : recording; };
  for (const MovingObject& object : objects)
    if (!actor_parts(object.id))
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
    if (const auto parts = actor_parts(object.id)) {
      const std::span<const float> motions = motion_parameters(track_part(*parts));
      object.corrections.assign(motions.begin(), motions.end());
    }
}

}  // namespace redrive
