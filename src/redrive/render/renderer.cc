// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/renderer.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"

namespace redrive {
namespace {

// Rays of a tile: 8192 keep a backend's threads busy. Long rays get fewer, so that what a method
// keeps of each sample, up to some 200 bytes, stays below a quarter of a gigabyte (2^20 samples).
constexpr int kMaxTileRays = 8192;
constexpr int kMaxTileSamples = 1 << 20;

}  // namespace

int max_tile_rays(const Model& model) {
  return std::clamp(kMaxTileSamples / model.samples_per_ray(), 4, kMaxTileRays);
}

RenderedImage render_image(kernels::Backend& backend, const Model& model, const Camera& camera,
                           const ShutterPoses& world_from_camera, const Exposure& exposure) {
  return render_image(backend, model, make_ray_table(camera, backend.threads()), world_from_camera,
                      exposure);
}

RenderedImage render_image(kernels::Backend& backend, const Model& model, const RayTable& table,
                           const ShutterPoses& world_from_camera, const Exposure& exposure) {
  RenderedImage image;
  image.width = table.width;
  image.height = table.height;
  const std::size_t pixels = static_cast<std::size_t>(table.width) * table.height;
  image.rgb.assign(3 * pixels, 0.0f);
  image.depth.assign(pixels, 0.0f);
  image.opacity.assign(pixels, 0.0f);
  image.valid.assign(pixels, 0);

  RayBatch batch;
  Workspace workspace;
  std::vector<float> rgb, depth, opacity;
  const PixelSquares squares = make_pixel_squares(table);
  const std::size_t most = max_tile_rays(model);
  for (std::size_t square = 0; square + 1 < squares.first.size();) {
    const std::uint32_t first = squares.first[square];
    batch.group.clear();
    // A tile is whole squares.
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
    model.render(backend, batch, {rgb, depth, opacity, {}}, &workspace);
    for (std::size_t k = 0; k < count; ++k) {
      const std::size_t pixel = table.pixel[entries[k]];
      for (std::size_t c = 0; c < 3; ++c) image.rgb[3 * pixel + c] = rgb[c * count + k];
      image.depth[pixel] = depth[k];
      image.opacity[pixel] = opacity[k];
      image.valid[pixel] = 1;
    }
  }
  return image;
}

Image8 to_image8(const RenderedImage& image) {
  Image8 out{image.width, image.height, std::vector<std::uint8_t>(image.rgb.size())};
  std::transform(image.rgb.begin(), image.rgb.end(), out.rgb.begin(), [](float x) {
    return static_cast<std::uint8_t>(std::lround(255.0f * std::clamp(x, 0.0f, 1.0f)));
  });
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
