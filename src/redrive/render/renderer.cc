// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/renderer.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"

namespace redrive {
namespace {

// Rays of a tile: 8192 keep a backend's threads busy. Long rays get fewer, so that t, dt and weights of a tile, 12 bytes
// a sample, stay below 12 MiB (2^20 samples).
constexpr int kMaxTileRays = 8192;
constexpr int kMaxTileSamples = 1 << 20;

int tile_rays(const NerfModel& model) {
  return std::clamp(kMaxTileSamples / (model.samples + model.fine_samples), 1, kMaxTileRays);
}

/// Working memory of a tile.
struct Tile {
  RayBatch batch;
  std::vector<float> t, dt, weights, fine_t, fine_dt, rgb, depth, opacity;
};

/// Coarse samples in the middle of their bins; where the model has a fine network, its samples are the coarse ones and
/// those drawn from the coarse weights (NeRF section 5.2), and only the fine colours count.
void render_tile(kernels::Backend& backend, const NerfModel& model, Tile* tile) {
  const int n = tile->batch.n;
  const auto rays_of = [n](int per_ray) { return static_cast<std::size_t>(n) * per_ray; };
  tile->rgb.resize(rays_of(3));
  tile->depth.resize(n);
  tile->opacity.resize(n);
  tile->t.resize(rays_of(model.samples));
  tile->dt.resize(rays_of(model.samples));
  tile->weights.resize(model.fine_samples > 0 ? rays_of(model.samples) : 0);

  const kernels::Rays rays{n, tile->batch.origin, tile->batch.direction};
  const kernels::CompositeOut out{tile->rgb, tile->depth, tile->opacity, tile->weights};
  backend.sample_stratified(n, {model.samples, model.near_m, model.far_m, /*jitter=*/false, /*key=*/0}, tile->t,
                            tile->dt);
  const kernels::Samples coarse{model.samples, tile->t, tile->dt};
  backend.render_rays(model.field(0), rays, coarse, out);
  if (model.fine_samples == 0) return;

  const int per_ray = model.samples + model.fine_samples;
  tile->fine_t.resize(rays_of(per_ray));
  tile->fine_dt.resize(rays_of(per_ray));
  backend.sample_hierarchical(coarse, tile->weights, model.fine_samples, /*jitter=*/false, /*key=*/0, tile->fine_t,
                              tile->fine_dt);
  backend.render_rays(model.field(1), rays, {per_ray, tile->fine_t, tile->fine_dt},
                      {tile->rgb, tile->depth, tile->opacity, {}});
}

}  // namespace

RenderedImage render_image(kernels::Backend& backend, const NerfModel& model, const Camera& camera,
                           const Rigid3d& world_from_camera) {
  return render_image(backend, model, make_ray_table(camera), world_from_camera);
}

RenderedImage render_image(kernels::Backend& backend, const NerfModel& model, const RayTable& table,
                           const Rigid3d& world_from_camera) {
  RenderedImage image;
  image.width = table.width;
  image.height = table.height;
  const std::size_t pixels = static_cast<std::size_t>(table.width) * table.height;
  image.rgb.assign(3 * pixels, 0.0f);
  image.depth.assign(pixels, 0.0f);
  image.opacity.assign(pixels, 0.0f);
  image.valid.assign(pixels, 0);

  Tile tile;
  const std::size_t step = tile_rays(model);
  for (std::size_t first = 0; first < table.pixel.size(); first += step) {
    const std::size_t count = std::min(step, table.pixel.size() - first);
    view_rays(table, world_from_camera, first, count, &tile.batch);
    REDRIVE_CHECK_OP(static_cast<std::size_t>(tile.batch.n), ==, count);
    render_tile(backend, model, &tile);
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t pixel = table.pixel[first + k];
      for (std::size_t c = 0; c < 3; ++c) image.rgb[3 * pixel + c] = tile.rgb[c * count + k];
      image.depth[pixel] = tile.depth[k];
      image.opacity[pixel] = tile.opacity[k];
      image.valid[pixel] = 1;
    }
  }
  return image;
}

Image8 to_image8(const RenderedImage& image) {
  Image8 out{image.width, image.height, std::vector<std::uint8_t>(image.rgb.size())};
  std::transform(image.rgb.begin(), image.rgb.end(), out.rgb.begin(),
                 [](float x) { return static_cast<std::uint8_t>(std::lround(255.0f * std::clamp(x, 0.0f, 1.0f))); });
  return out;
}

std::vector<std::uint16_t> depth_mm(const RenderedImage& image) {
  std::vector<std::uint16_t> out(image.depth.size());
  std::transform(image.depth.begin(), image.depth.end(), out.begin(), [](float depth_m) {
    return static_cast<std::uint16_t>(std::lround(std::clamp(1000.0f * depth_m, 0.0f, 65535.0f)));
  });
  return out;
}

}  // namespace redrive
