// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/coverage.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/progress.h"
#include "redrive/edit/actor_body.h"
#include "redrive/eval/evaluate.h"
#include "redrive/scene/moving_objects.h"

namespace redrive {
namespace {

constexpr int kSmallWidth =
    80;  // part of the training views' depth: still resolves a surface a few pixels wide
constexpr double kRangeTolerance =
    0.1;  // a field's depth is not exact, and a small pixel holds several depths

double range_of(const RenderedImage& image, std::size_t pixel, double far_m) {
  return image.opacity[pixel] < 0.5f ? far_m : image.depth[pixel];
}

/// Returns the coordinate, in the full image, of the centre of a pixel of the small one.
std::size_t centre(int small, int factor) {
  return static_cast<std::size_t>(small) * factor + factor / 2;
}

int small_factor(const Camera& full) {
  return std::clamp(full.width / kSmallWidth, 1, full.height);
}

/// Returns the pose in the middle row.
Rigid3d actor_from_camera(const ShutterPoses::Actor& actor) {
  return rigid(actor.actor_from_camera[actor.actor_from_camera.size() / 2]);
}

/// `table`: table of the small image.
TrainingDepth render_depth(const Run& run, kernels::Backend& backend, const View& of,
                           const Exclusions& left_out, const RayTable& table) {
  const Camera& full = run.scene.rig[of.camera].camera;
  const Camera& small = table.camera;
  const int factor = small_factor(full);
  const ShutterPoses poses = run.scene.shutter_poses(of);
  const RenderedImage image = render_image(backend, *run.field(), table, poses);
  const Mask mask = view_mask(run.scene, of, left_out.masks[of.camera], left_out.moving);
  TrainingDepth depth{small,
                      run.scene.world_from_camera(of).inverse(Eigen::Isometry),
                      {},
                      std::vector<float>(image.depth.size())};
  for (const ShutterPoses::Actor& actor : poses.actors())
    depth.camera_from_actor[actor.body] = actor_from_camera(actor).inverse(Eigen::Isometry);
  for (int y = 0; y < small.height; ++y)
    for (int x = 0; x < small.width; ++x) {
      const std::size_t k = static_cast<std::size_t>(y) * small.width + x;
      if (image.valid[k] && mask.used[centre(y, factor) * full.width + centre(x, factor)])
        depth.range_m[k] = static_cast<float>(range_of(image, k, run.scene.far_m));
    }
  return depth;
}

RayTable small_table(const Camera& full) {
  return make_ray_table(full.downscaled(small_factor(full)));
}

}  // namespace

bool TrainingDepth::sees(const Eigen::Vector3d& point_in_camera) const {
  const auto at = camera.project(point_in_camera);
  if (!at) return false;
  const long x = std::lround(at->x()), y = std::lround(at->y());
  if (x < 0 || y < 0 || x >= camera.width || y >= camera.height) return false;
  const double surface_m = range_m[static_cast<std::size_t>(y) * camera.width + x];
  return surface_m > 0 && point_in_camera.norm() <= (1 + kRangeTolerance) * surface_m;
}

Coverage::Coverage(const Run& run, kernels::Backend& backend, bool at_once)
    : run_(run), backend_(backend), exclusions_(read_exclusions(run)), far_m_(run.scene.far_m) {
  const Scene& scene = run.scene;
  for (const MovingObject& actor : scene.actors)
    half_size_m_[actor.id] = actor.size_m / 2 + Eigen::Vector3d::Constant(kBoxMargin_m);
  const std::size_t most_views = kMaxViews * std::max<std::size_t>(1, run.blocks.size());
  const Progress progress("rendering what training images saw");
  for (int c = 0; c < static_cast<int>(scene.rig.size()); ++c) {
    std::vector<const View*> training;
    for (const View& view : scene.views)
      if (view.camera == c && !view.held_out) training.push_back(&view);
    for (const std::size_t i :
         evenly_spaced(training.size(), std::max<std::size_t>(1, most_views / scene.rig.size())))
      to_render_.push_back(training[i]);
  }
  std::ranges::reverse(to_render_);
  while (at_once && step()) {
  }
}

bool Coverage::step() {
  if (!to_render_.empty()) {
    const View& view = *to_render_.back();
    to_render_.pop_back();
    views_.push_back(render_depth(run_, backend_, view, *exclusions_,
                                  small_table(run_.scene.rig[view.camera].camera)));
  }
  if (to_render_.empty()) exclusions_.reset();
  return !to_render_.empty();
}

/// Whether a training image saw a point that a camera sees, in the camera's axes. `middle`: the
/// camera's pose in the middle row.
bool Coverage::sees(const Eigen::Vector3d& point_in_camera, const ShutterPoses& world_from_camera,
                    const Rigid3d& middle) const {
  const auto shows = [&](const ShutterPoses::Actor& actor) {
    const auto own = half_size_m_.find(actor.body);
    if (!actor.imported && own == half_size_m_.end()) return false;
    const Eigen::Vector3d half_m =
        actor.imported ? Eigen::Vector3d(actor.imported->size_m.array() / 2 + kBoxMargin_m)
                       : own->second;
    return ((actor_from_camera(actor) * point_in_camera).cwiseAbs().array() <= half_m.array())
        .all();
  };
  const auto actor = std::ranges::find_if(world_from_camera.actors(), shows);
  const bool is_static = actor == world_from_camera.actors().end();
  return std::ranges::any_of(views_, [&](const TrainingDepth& view) {
    if (is_static) return view.sees(view.camera_from_world * (middle * point_in_camera));
    const auto there = view.camera_from_actor.find(actor->body);
    return !actor->imported && there != view.camera_from_actor.end() &&
           view.sees(there->second * (actor_from_camera(*actor) * point_in_camera));
  });
}

/// Calls see(pixel, whether a training image saw it) for the valid pixels of every stride-th row
/// and column.
void Coverage::for_each_pixel(int stride, const Camera& camera,
                              const ShutterPoses& world_from_camera, const RenderedImage& rendered,
                              const std::function<void(std::size_t, bool)>& see) const {
  REDRIVE_CHECK_OP(rendered.width, ==, camera.width);
  REDRIVE_CHECK_OP(rendered.height, ==, camera.height);
  const Rigid3d middle = world_from_camera.at(0.5);
  for (int y = 0; y < rendered.height; y += stride)
    for (int x = 0; x < rendered.width; x += stride) {
      const std::size_t i = static_cast<std::size_t>(y) * rendered.width + x;
      if (!rendered.valid[i]) continue;
      const auto direction = camera.unproject(Eigen::Vector2d(x, y));
      see(i,
          direction && sees(range_of(rendered, i, far_m_) * *direction, world_from_camera, middle));
    }
}

std::vector<std::uint8_t> Coverage::seen(const Camera& camera,
                                         const ShutterPoses& world_from_camera,
                                         const RenderedImage& rendered) const {
  std::vector<std::uint8_t> seen(rendered.depth.size(), 0);
  for_each_pixel(1, camera, world_from_camera, rendered,
                 [&](std::size_t pixel, bool is_seen) { seen[pixel] = is_seen; });
  return seen;
}

double Coverage::seen_share(const Camera& camera, const ShutterPoses& world_from_camera,
                            const RenderedImage& rendered) const {
  constexpr int kStride = 8;
  std::size_t valid = 0, seen = 0;
  for_each_pixel(kStride, camera, world_from_camera, rendered,
                 [&](std::size_t, bool is_seen) { ++valid, seen += is_seen; });
  return valid == 0 ? 0 : static_cast<double>(seen) / static_cast<double>(valid);
}

PointObservers::PointObservers(const Run& run, kernels::Backend& backend)
    : run_(run), backend_(backend), exclusions_(read_exclusions(run)) {
  for (const RigCamera& camera : run.scene.rig) tables_.push_back(small_table(camera.camera));
}

std::size_t PointObservers::training_views() const {
  return std::ranges::count(run_.scene.views, false, &View::held_out);
}

PointSearch PointObservers::begin(const Eigen::Vector3d& point_in_world) const {
  PointSearch search{point_in_world, {}, 0, {}};
  std::vector<std::pair<double, const View*>> near;  // sorted by distance
  for (const View& view : run_.scene.views) {
    if (view.held_out) continue;
    const Camera& camera = run_.scene.rig[view.camera].camera;
    const Eigen::Vector3d in_camera =
        run_.scene.world_from_camera(view).inverse(Eigen::Isometry) * point_in_world;
    const auto at = camera.project(in_camera);
    if (at && at->x() >= -0.5 && at->y() >= -0.5 && at->x() < camera.width - 0.5 &&
        at->y() < camera.height - 0.5)
      near.emplace_back(in_camera.norm(), &view);
  }
  std::ranges::sort(near);
  for (const auto& [distance_m, view] : near) search.candidates.push_back(view);
  return search;
}

bool PointObservers::step(PointSearch* search) {
  if (search->tested == search->candidates.size()) return false;
  const View* const view = search->candidates[search->tested++];
  auto known = depths_.find(view);
  if (known == depths_.end())
    known =
        depths_
            .emplace(view, render_depth(run_, backend_, *view, exclusions_, tables_[view->camera]))
            .first;
  if (known->second.sees(known->second.camera_from_world * search->point_in_world))
    search->seen_by.push_back(view);
  return search->tested < search->candidates.size();
}

}  // namespace redrive
