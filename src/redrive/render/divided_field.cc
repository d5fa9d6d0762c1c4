// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/divided_field.h"

#include <algorithm>
#include <cmath>

namespace redrive {
namespace {

/// largest motion between two images; a camera that goes further jumps
constexpr double kMotion_m = 50;

/// Multiplies colours by exp(log_factors).
void brighten(const LogGains& log_factors, RenderedImage* image) {
  if (log_factors == LogGains{}) return;
  float factor[3];
  for (int c = 0; c < 3; ++c) factor[c] = static_cast<float>(std::exp(log_factors[c]));
  for (std::size_t i = 0; i < image->rgb.size(); ++i)
    image->rgb[i] = std::min(1.0f, factor[i % 3] * image->rgb[i]);
}

/// Adds `weight` of `other` to 1 - weight of `image`.
void blend(const RenderedImage& other, float weight, RenderedImage* image) {
  const auto mixed = [weight](float a, float b) { return a + weight * (b - a); };
  for (std::size_t i = 0; i < image->rgb.size(); ++i)
    image->rgb[i] = mixed(image->rgb[i], other.rgb[i]);
  for (std::size_t i = 0; i < image->depth.size(); ++i) {
    const float a = (1 - weight) * image->opacity[i], b = weight * other.opacity[i];
    image->opacity[i] = a + b;
    const bool both = a > 0 && b > 0 && std::isfinite(image->depth[i] + other.depth[i]);
    if (both)
      image->depth[i] = (a * image->depth[i] + b * other.depth[i]) / (a + b);
    else if (b > a)
      image->depth[i] = other.depth[i];
  }
}

/// Returns the index of the first number that is at least `value`, or of the last one.
std::size_t first_from(const std::vector<std::int64_t>& ascending, std::int64_t value) {
  const std::ptrdiff_t after = std::ranges::lower_bound(ascending, value) - ascending.begin();
  return static_cast<std::size_t>(std::min(after, std::ssize(ascending) - 1));
}

}  // namespace

std::int64_t DividedDrive::time_of(const Exposure& exposure) const {
  constexpr std::int64_t kRounding_ns = 1'000'000;  // rounding of an hour in single precision
  const std::int64_t at_ns = t_ns.front() + std::llround(1e9 * double(exposure.t_s));
  const std::int64_t frame_ns = t_ns[first_from(t_ns, at_ns - kRounding_ns)];
  return std::abs(frame_ns - at_ns) <= kRounding_ns ? frame_ns : at_ns;
}

int DividedDrive::block_at_time(std::int64_t at_ns) const {
  return way.block_of_frame(first_from(t_ns, at_ns));
}

DividedField::DividedField(std::unique_ptr<const Field> like, DividedDrive drive,
                           BlockCache::Load load, std::uint64_t bytes)
    : like_(std::move(like)), drive_(std::move(drive)), cache_(std::move(load), bytes) {}

std::string DividedField::describe() const {
  return std::to_string(drive_.way.blocks()) + " blocks";
}

/// Loads the next block in the direction of the camera's motion in the background.
void DividedField::load_ahead(const BlockWay::Place& place) const {
  const double moved_m =
      place.along_m - std::exchange(last_along_m_, place.along_m).value_or(place.along_m);
  if (moved_m == 0 || std::abs(moved_m) > kMotion_m) return;
  const int next = drive_.way.block_at(place) + (moved_m > 0 ? 1 : -1);
  if (next >= 0 && next < drive_.way.blocks()) cache_.prefetch(next);
}

LogGains DividedField::mean_log_gains(int block) const {
  LogGains mean{};
  const std::vector<LogGains>& of_block = drive_.seams.log_gains[block];
  for (const LogGains& gains : of_block)
    for (int c = 0; c < 3; ++c) mean[c] += gains[c] / static_cast<double>(of_block.size());
  return mean;
}

/// Returns the log gains of an exposure as a field of the drive's mean brightness would have them:
/// the gains of the block whose core holds its time.
LogGains DividedField::drive_log_gains(const Exposure& exposure) const {
  if (drive_gains_ && drive_gains_->first.camera == exposure.camera &&
      drive_gains_->first.t_s == exposure.t_s)
    return drive_gains_->second;
  const std::int64_t t_ns = drive_.time_of(exposure);
  const int block = drive_.block_at_time(t_ns);
  const auto loaded = cache_.get(block);
  const std::string& camera = drive_.cameras[exposure.camera];
  const Scene& scene = loaded->scene;
  LogGains gains =
      image_log_gains(*loaded->model, scene.exposure(scene.camera_index(camera), t_ns));
  const LogGains of_block = drive_.seams.of(block, camera);
  for (int c = 0; c < 3; ++c) gains[c] -= of_block[c];
  drive_gains_ = {exposure, gains};
  return gains;
}

DividedField::BlockExposure DividedField::exposure_in(int block, const LoadedBlock& loaded,
                                                      const Exposure& exposure) const {
  if (exposure.camera < 0) return {exposure, mean_log_gains(block)};
  const std::string& camera = drive_.cameras[exposure.camera];
  const std::int64_t t_ns = drive_.time_of(exposure);
  const Scene& scene = loaded.scene;
  BlockExposure in{scene.exposure(scene.camera_index(camera), t_ns), {}};
  const bool has_camera = in.exposure.camera >= 0;
  if (has_camera && t_ns >= scene.frames.front().t_ns && t_ns <= scene.frames.back().t_ns)
    return in;
  const LogGains asked = drive_log_gains(exposure);
  const LogGains own = image_log_gains(*loaded.model, in.exposure),
                 of_block = has_camera ? drive_.seams.of(block, camera) : mean_log_gains(block);
  for (int c = 0; c < 3; ++c) in.log_factors[c] = of_block[c] + asked[c] - own[c];
  return in;
}

void DividedField::render_block(kernels::Backend& backend, int block, const RayTable& rays,
                                const ShutterPoses& world_from_camera, const Exposure& exposure,
                                RenderedImage* image) const {
  const auto loaded = cache_.get(block);
  const BlockExposure in = exposure_in(block, *loaded, exposure);
  ShutterPoses poses = world_from_camera;
  std::vector<ShutterPoses::Actor> actors = poses.actors();
  for (ShutterPoses::Actor& actor : actors)
    if (!actor.imported) actor.imported = borrowed(block, *loaded->model, actor.body, &actor.gain);
  poses.set_actors(std::move(actors));
  loaded->model->render_to(backend, rays, poses, in.exposure, image);
  brighten(in.log_factors, image);
}

void DividedField::render_to(kernels::Backend& backend, const RayTable& rays,
                             const ShutterPoses& world_from_camera, const Exposure& exposure,
                             RenderedImage* image) const {
  const BlockWay::Place place = drive_.way.place(world_from_camera.at(0.5).translation());
  load_ahead(place);
  const std::vector<BlockWeight> weights = drive_.way.weights(place);
  render_block(backend, weights.front().block, rays, world_from_camera, exposure, image);
  if (weights.size() == 1) return;
  render_block(backend, weights.back().block, rays, world_from_camera, exposure, &neighbour_);
  blend(neighbour_, static_cast<float>(weights.back().weight), image);
}

std::vector<DividedField::BlockRays> DividedField::divided(const kernels::Rays& rays) const {
  const auto n = static_cast<std::size_t>(rays.n);
  std::vector<BlockRays> parts(drive_.way.blocks());
  for (std::size_t i = 0; i < n; ++i)
    parts[drive_.way.block_at(
              drive_.way.place({rays.origin[i], rays.origin[n + i], rays.origin[2 * n + i]}))]
        .chosen.push_back(i);
  for (BlockRays& part : parts) {
    for (int k = 0; k < 3; ++k)
      for (const std::size_t i : part.chosen) {
        part.origin.push_back(rays.origin[k * n + i]);
        part.direction.push_back(rays.direction[k * n + i]);
      }
    if (rays.t_ns.empty()) continue;
    for (const std::size_t i : part.chosen) part.t_ns.push_back(rays.t_ns[i]);
  }
  return parts;
}

RenderedRays DividedField::trace(kernels::Backend& backend, const kernels::Rays& rays,
                                 const std::vector<MovingObject>& actors) const {
  const auto n = static_cast<std::size_t>(rays.n);
  RenderedRays all{std::vector<float>(n), std::vector<float>(n)};
  const std::vector<BlockRays> parts = divided(rays);
  for (int b = 0; b < drive_.way.blocks(); ++b) {
    if (parts[b].chosen.empty()) continue;
    const auto block = cache_.get(b);
    std::vector<MovingObject> here = actors;
    for (MovingObject& actor : here)
      if (!actor.imported)
        actor.imported = borrowed(b, *block->model, actor.body.value_or(actor.id), &actor.gain);
    parts[b].put(block->model->trace(backend, parts[b].rays(), here), &all);
  }
  return all;
}

}  // namespace redrive
