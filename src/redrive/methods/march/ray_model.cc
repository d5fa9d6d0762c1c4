// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/march/ray_model.h"

#include <algorithm>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// The step keeps about 60 bytes for each sample of a batch (t, dt, weights, raw outputs and their
/// derivatives, twice with a fine network), so 2^22 of them stay within a quarter of a gigabyte.
constexpr std::int64_t kMaxBatchSamples = std::int64_t{1} << 22;
/// Bytes per sample: positions, densities, weights, features and their derivatives.
constexpr std::uint64_t kBytesPerSample = 128;

// Rays of a tile: 8192 keep a backend's threads busy. Rays with many samples get smaller
// tiles, so that the up to 200 bytes per sample stay below a quarter of a gigabyte (2^20 samples).
constexpr int kMaxTileRays = 8192;
constexpr int kMaxTileSamples = 1 << 20;

/// Returns the batches of `buffers`, created by the first call.
RayBuffers& ray_buffers(StepBuffers* buffers) {
  if (!buffers->method) buffers->method = std::make_unique<RayBuffers>();
  return static_cast<RayBuffers&>(*buffers->method);
}

}  // namespace

void draw_batch(const PixelSampler& sampler, int uniform, int error_rays,
                const StepRequest& request, RayBatch* batch) {
  // The end of an epoch has fewer pixels, but at least one per rank, which may include the first
  // ones of the next epoch.
  const std::uint64_t ranks = request.world_size, rank = request.rank, pixels = sampler.pixels(),
                      left = pixels - request.pixels_drawn % pixels,
                      all = std::max(ranks,
                                     std::min(ranks * static_cast<std::uint64_t>(uniform), left)),
                      first = all * rank / ranks, next = all * (rank + 1) / ranks;
  ErrorMapRays more{error_rays};
  if (request.error_map) more.errors = *request.error_map;
  sampler.gather(request.pixels_drawn + first, static_cast<int>(next - first), batch, more);
  batch->first_ray = first + rank * static_cast<std::uint64_t>(error_rays);
}

void RayModel::check_batch(int samples_per_ray, const HyperparameterFailure& fail) const {
  const std::int64_t samples = std::int64_t{batch_rays} * samples_per_ray;
  if (samples > kMaxBatchSamples)
    fail(Hyperparameter{"batch_rays", ""}.as_option("batch"), std::to_string(batch_rays),
         "times samples a ray is " + std::to_string(samples) + ", must be " +
             std::to_string(kMaxBatchSamples) + " or less (memory)");
}

void RayModel::visit_batch(HyperparameterVisitor& visit) {
  visit(Hyperparameter{"batch_rays", "rays of a step", 1, 65536}.as_option("batch"), batch_rays);
}

std::int64_t RayModel::steps_per_epoch(const TrainingSet& data, int world_size) const {
  return data.pixels.steps_per_epoch(world_size * (rays_per_step() - n_error_rays()));
}

StepOutput RayModel::step(kernels::Backend& backend, const TrainingSet& data,
                          const StepRequest& request, std::span<float> gradients,
                          StepBuffers* buffers) const {
  RayBuffers& own = ray_buffers(buffers);
  RayBatch& batch = own.batch;
  Workspace& workspace = buffers->workspace;
  const int error_rays = request.pixels > 0 ? 0 : n_error_rays();
  draw_batch(data.pixels, request.pixels > 0 ? request.pixels : rays_per_step() - error_rays,
             error_rays, request, &batch);
  batch.refines = request.pose_gradients;
  const RayGradientsOutput rays =
      this->gradients(backend, batch, request.seed, request.step, gradients, &workspace);
  StepOutput out;
  if (request.pixels == 0 && data.lidar_rays && lidar_rays > 0) {
    data.lidar_rays->gather(request.world_size * request.step + request.rank, lidar_rays,
                            &own.lidar);
    own.lidar.first_ray = static_cast<std::uint64_t>(request.rank) * lidar_rays;
    range_gradients(backend, own.lidar, request.seed, request.step, gradients, &workspace);
  }
  out.pixels = batch.n;
  out.epoch_pixels = batch.n - batch.error_map_rays;
  out.active_rays = rays.active_rays;
  out.cells = batch.cell;
  out.squared_errors = rays.squared_errors;
  if (request.colour_variance) out.colour_variance = colour_variance(batch);
  if (request.pose_gradients)
    out.views = view_gradients(data.scene, batch, rays.d_origin, rays.d_direction);
  return out;
}

std::vector<ViewGradient> view_gradients(const Scene& scene, const RayBatch& batch,
                                         std::span<const float> d_origin,
                                         std::span<const float> d_direction) {
  const std::size_t n = batch.n;
  std::vector<ViewGradient> views(scene.views.size());
  for (std::size_t ray = 0; ray < n; ++ray) {
    Eigen::Vector3d by_origin, direction, by_direction;
    for (int k = 0; k < 3; ++k) {
      by_origin[k] = d_origin[k * n + ray];
      direction[k] = batch.direction[k * n + ray];
      by_direction[k] = d_direction[k * n + ray];
    }
    ViewGradient& view = views[batch.view[ray]];
    view.d_translation += by_origin;
    view.d_rotation += direction.cross(by_direction);
  }
  return views;
}

double colour_variance(const RayBatch& batch) {
  double sum_of_channels = 0;
  const int n = batch.n - batch.error_map_rays;
  for (int k = 0; k < 3; ++k) {
    double sum = 0, squares = 0;
    for (int i = 0; i < n; ++i) {
      const double value = batch.target[static_cast<std::size_t>(k) * batch.n + i];
      sum += value;
      squares += value * value;
    }
    sum_of_channels += std::max(0.0, squares / n - (sum / n) * (sum / n));
  }
  return sum_of_channels / 3;
}

int max_tile_rays(const RayModel& model) {
  return std::clamp(kMaxTileSamples / model.samples_per_ray(), 4, kMaxTileRays);
}

void RayModel::render_to(kernels::Backend& backend, const RayTable& table,
                         const ShutterPoses& world_from_camera, const Exposure& exposure,
                         RenderedImage* image) const {
  image->clear(table.width, table.height);
  RayBatch batch;
  Workspace workspace;
  std::vector<float> rgb, depth, opacity;
  const PixelSquares squares = make_pixel_squares(table);
  const std::size_t most = max_tile_rays(*this);
  for (std::size_t square = 0; square + 1 < squares.first.size();) {
    const std::uint32_t first = squares.first[square];
    batch.group.clear();
    // A tile consists of whole squares.
    for (; square + 1 < squares.first.size() && squares.first[square + 1] <= first + most; ++square)
      batch.group.push_back(squares.first[square] - first);
    const std::size_t count = squares.first[square] - first;
    batch.group.push_back(static_cast<std::uint32_t>(count));
    const auto entries = std::span(squares.entry).subspan(first, count);
    view_rays(table, world_from_camera, entries, &batch);
    batch.exposure.assign(count, exposure);
    REDRIVE_CHECK_OP(static_cast<std::size_t>(batch.n), ==, count);
    rgb.resize(3 * count);
    depth.resize(count);
    opacity.resize(count);
    render_rays(backend, batch, {rgb, depth, opacity, {}}, &workspace);
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t pixel = table.pixel[entries[k]];
      for (std::size_t c = 0; c < 3; ++c) image->rgb[3 * pixel + c] = rgb[c * count + k];
      image->depth[pixel] = depth[k];
      image->opacity[pixel] = opacity[k];
      image->valid[pixel] = 1;
    }
  }
}

RenderedRays RayModel::trace(kernels::Backend& backend, const kernels::Rays& rays,
                             const std::vector<MovingObject>& /*actors*/) const {
  const std::size_t n = rays.n, most = max_tile_rays(*this);
  RenderedRays out{std::vector<float>(n), std::vector<float>(n)};
  RayBatch batch;
  Workspace workspace;
  std::vector<float> rgb;
  for (std::size_t first = 0; first < n; first += most) {
    const std::size_t count = std::min(most, n - first);
    batch.n = static_cast<int>(count);
    batch.origin.clear();
    batch.direction.clear();
    for (std::size_t k = 0; k < 3; ++k) {
      const auto part = [&](std::span<const float> all) {
        return all.subspan(k * n + first, count);
      };
      batch.origin.insert(batch.origin.end(), part(rays.origin).begin(), part(rays.origin).end());
      batch.direction.insert(batch.direction.end(), part(rays.direction).begin(),
                             part(rays.direction).end());
    }
    batch.pixel_angle.assign(count, kLidarBeamAngle_rad);
    rgb.resize(3 * count);
    render_rays(backend, batch,
                {rgb,
                 std::span(out.depth).subspan(first, count),
                 std::span(out.opacity).subspan(first, count),
                 {}},
                &workspace);
  }
  return out;
}

std::uint64_t RayModel::step_bytes() const {
  return std::uint64_t(max_rays_per_step() + lidar_rays) * samples_per_ray() * kBytesPerSample;
}

}  // namespace redrive
