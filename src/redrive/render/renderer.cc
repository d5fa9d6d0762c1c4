// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/renderer.h"

#include <algorithm>
#include <cmath>

namespace redrive {
RenderedImage render_image(kernels::Backend& backend, const Field& model, const Camera& camera,
                           const ShutterPoses& world_from_camera, const Exposure& exposure) {
  return render_image(backend, model, make_ray_table(camera, backend.pool()), world_from_camera,
                      exposure);
}

RenderedImage render_image(kernels::Backend& backend, const Field& model, const RayTable& table,
                           const ShutterPoses& world_from_camera, const Exposure& exposure) {
  return model.render(backend, table, world_from_camera, exposure);
}

namespace {

std::uint8_t to_byte(float x) {
  return static_cast<std::uint8_t>(std::lround(255.0f * std::clamp(x, 0.0f, 1.0f)));
}

}  // namespace

Image8 to_image8(const RenderedImage& image) {
  Image8 out{image.width, image.height, std::vector<std::uint8_t>(image.rgb.size())};
  std::ranges::transform(image.rgb, out.rgb.begin(), to_byte);
  return out;
}

Image8 opacity_image(const RenderedImage& image) {
  Image8 out{image.width, image.height, std::vector<std::uint8_t>(3 * image.opacity.size())};
  for (std::size_t i = 0; i < out.rgb.size(); ++i) out.rgb[i] = to_byte(image.opacity[i / 3]);
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
