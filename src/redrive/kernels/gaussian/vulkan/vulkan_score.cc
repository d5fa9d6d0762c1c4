// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/vulkan_score.h"

#include <cstdint>
#include <vector>

#include "redrive/kernels/gaussian/vulkan/gaussian_device.h"
#include "redrive/kernels/image_score.h"

namespace redrive::kernels::vulkan {
namespace {

/// Score of shaders/score.comp.
struct Parameters {
  VkDeviceAddress rgb, target, mask, planes, sums;
  std::uint32_t width, height, tiles_x, has_mask;
  float levels[256];
};

/// Sums of a tile in shaders/score.comp.
enum ScoreSum {
  kLumaSquares,
  kSquares,  ///< 3
  kPixels = 4,
  kSsim,
  kWindows,
  kFlip,
  kScoreSums
};

}  // namespace

ImageScore VulkanScore::score(const ImagePair& images) {
  check_image_pair(images);
  const RasterSize size = raster_size(images.width, images.height);
  const std::size_t pixels = images.ground_truth.size() / 3,
                    tiles = size.plane() / (kTileSide * kTileSide);
  const auto send = [&](DeviceBuffer* to, const auto& from) {
    queue_.grow(to, from.size_bytes() + 4);  // bytes are read by the word
    queue_.upload(*to, 0, from.data(), from.size_bytes());
  };
  queue_.grow(&parameters_, sizeof(Parameters));
  queue_.grow(&planes_, 12 * pixels * sizeof(float));
  queue_.grow(&sums_, tiles * kScoreSums * sizeof(float));
  send(&rgb_, images.rgb);
  send(&target_, images.ground_truth);
  send(&mask_, images.mask);
  Parameters p = {rgb_.address(),
                  target_.address(),
                  mask_.address(),
                  planes_.address(),
                  sums_.address(),
                  static_cast<std::uint32_t>(images.width),
                  static_cast<std::uint32_t>(images.height),
                  static_cast<std::uint32_t>(size.stride / kTileSide),
                  std::uint32_t{!images.mask.empty()},
                  {}};
  for (int i = 0; i < 256; ++i) p.levels[i] = static_cast<float>(i) / 255.0f;
  queue_.upload(parameters_, 0, &p, sizeof p);
  for (const char* pass : {"score0", "score1", "score2"})
    run(&queue_, pass, Push(parameters_), tiles);
  queue_.stamp("score");
  std::vector<float> of_tiles(tiles * kScoreSums);
  queue_.download(sums_, 0, of_tiles.data(), of_tiles.size() * sizeof(float));
  queue_.finish();
  std::vector<ScoreSums> parts(tiles);
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    const float* const from = &of_tiles[tile * kScoreSums];
    ScoreSums& to = parts[tile];
    to.luma_squares = static_cast<double>(from[kLumaSquares]);
    for (int c = 0; c < 3; ++c) to.squares[c] = static_cast<double>(from[kSquares + c]);
    to.ssim = static_cast<double>(from[kSsim]);
    to.flip = static_cast<double>(from[kFlip]);
    to.pixels = static_cast<std::int64_t>(from[kPixels]);
    to.windows = static_cast<std::int64_t>(from[kWindows]);
  }
  return score_from_sums(parts);
}

}  // namespace redrive::kernels::vulkan
