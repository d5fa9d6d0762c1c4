// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/vulkan_loss.h"

#include <algorithm>

#include "redrive/kernels/gaussian/target_window.h"

namespace redrive::kernels::vulkan {
namespace {

/// Loss of shaders/loss.comp.
struct LossParameters {
  VkDeviceAddress rgb, gains, transmittance, range_error, log_range, target, alpha, used, slopes,
      d_rgb, d_transmittance, error, d_range, sums, patches;
  std::uint32_t width, height, stride, rows, tiles_x, target_width, target_x, has_alpha, has_used,
      has_pixels, has_ranges;
  float l1_scale, ssim_scale, transmittance_each, range_each;
  float background_change[3];
};

/// Sums of a tile in shaders/loss.comp.
enum SumOfTile {
  kAbsolute,
  kSquares,
  kDissimilar,
  kPixels,
  kTarget,             ///< 3
  kTargetSquares = 7,  ///< 3
  kTransmittance = 10,
  kRangeError,
  kTileSums = 16
};

double used_pixels(const TargetWindow& target, const RasterSize& size) {
  if (target.used.empty()) return static_cast<double>(size.width) * size.height;
  std::size_t n = 0;
  for (int y = 0; y < size.height; ++y) {
    const std::uint8_t* const row =
        target.used.data() + static_cast<std::size_t>(target.y + y) * target.width + target.x;
    for (int x = 0; x < size.width; ++x) n += row[x] != 0;
  }
  return static_cast<double>(n);
}

}  // namespace

void VulkanLoss::record(const LossPlanes& planes, const ImageLossInput& input,
                        const PixelWeights& weights) {
  Queue& queue = shared_.queue();
  const RasterSize size = planes.size;
  const TargetWindow& target = input.target;
  const std::size_t plane = size.plane(), tiles = plane / (kTileSide * kTileSide),
                    n_patches = plane / (kPatchSide * kPatchSide);
  // The window's rows of the whole image.
  const std::size_t first = static_cast<std::size_t>(target.y) * target.width,
                    pixels = static_cast<std::size_t>(size.height) * target.width;
  const auto send = [&](DeviceBuffer* to, std::span<const std::uint8_t> from,
                        std::size_t channels) {
    queue.grow(to, channels * pixels + 4);
    if (!from.empty()) queue.upload(*to, 0, from.data() + channels * first, channels * pixels);
  };
  queue.grow(&gains_, 3 * plane * sizeof(float));
  queue.grow(&slopes_, 9 * plane * sizeof(float));
  queue.grow(&sums_, tiles * kTileSums * sizeof(float));
  queue.grow(&patches_, n_patches * sizeof(PatchBrightness));
  queue.grow(&parameters_, sizeof(LossParameters));
  send(&target_, target.rgb, 3);
  send(&alpha_, target.alpha, 1);
  send(&used_, target.used, 1);
  queue.upload(gains_, 0, input.gains.data(), input.gains.size_bytes());

  pixels_ = used_pixels(target, size);
  l1_weight_ = static_cast<double>(input.l1_weight);
  ssim_weight_ = static_cast<double>(input.ssim_weight);
  range_weight_ = static_cast<double>(weights.range);
  const double count = std::max(3 * pixels_, 1.0);
  const auto address = [](const DeviceBuffer* buffer, const DeviceBuffer* other) {
    return buffer ? buffer->address() : other->address();
  };
  LossParameters p{};
  p.rgb = planes.rgb->address();
  p.gains = gains_.address();
  p.transmittance = address(planes.transmittance, planes.rgb);
  p.range_error = address(planes.range_error, planes.rgb);
  p.log_range = address(planes.log_range, planes.rgb);
  p.target = target_.address();
  p.alpha = alpha_.address();
  p.used = used_.address();
  p.slopes = slopes_.address();
  p.d_rgb = planes.d_rgb->address();
  p.d_transmittance = address(planes.d_transmittance, planes.error);
  p.error = planes.error->address();
  p.d_range = address(planes.d_range, planes.error);
  p.sums = sums_.address();
  p.patches = patches_.address();
  p.width = static_cast<std::uint32_t>(size.width);
  p.height = static_cast<std::uint32_t>(size.height);
  p.stride = static_cast<std::uint32_t>(size.stride);
  p.rows = static_cast<std::uint32_t>(size.rows);
  p.tiles_x = static_cast<std::uint32_t>(size.stride / kTileSide);
  p.target_width = static_cast<std::uint32_t>(target.width);
  p.target_x = static_cast<std::uint32_t>(target.x);
  p.has_alpha = !target.alpha.empty();
  p.has_used = !target.used.empty();
  p.has_pixels = planes.transmittance != nullptr;
  p.has_ranges = planes.log_range != nullptr;
  p.l1_scale = static_cast<float>(l1_weight_ / count);
  p.ssim_scale = static_cast<float>(ssim_weight_ / count);
  p.transmittance_each = weights.transmittance / static_cast<float>(std::max(pixels_, 1.0));
  p.range_each = weights.range;
  std::ranges::copy(target.background_change, p.background_change);
  queue.upload(parameters_, 0, &p, sizeof p);
  shared_.run("loss0", Push(parameters_), tiles);
  shared_.run("loss1", Push(parameters_), tiles);
  queue.stamp("loss");

  tile_sums_.resize(tiles * kTileSums);
  out_ = {};
  out_.patches.resize(n_patches);
  queue.download(sums_, 0, tile_sums_.data(), tile_sums_.size() * sizeof(float));
  queue.download(patches_, 0, out_.patches.data(), n_patches * sizeof(PatchBrightness));
}

ImageLossOutput VulkanLoss::result() {
  double sum[kTileSums] = {};
  for (std::size_t i = 0; i < tile_sums_.size(); ++i)
    sum[i % kTileSums] += static_cast<double>(tile_sums_[i]);
  const double count = std::max(3 * pixels_, 1.0);
  out_.l1 = l1_weight_ / count * sum[kAbsolute];
  out_.dssim = 0.5 * ssim_weight_ / count * sum[kDissimilar];
  out_.mse = sum[kSquares] / count;
  TargetSums target;
  target.pixels = sum[kPixels];
  for (int c = 0; c < 3; ++c) {
    target.sum[c] = sum[kTarget + c];
    target.squares[c] = sum[kTargetSquares + c];
  }
  target.finish(&out_);
  out_.transmittance = sum[kTransmittance] / std::max(pixels_, 1.0);
  out_.range = range_weight_ * sum[kRangeError];
  return std::move(out_);
}

}  // namespace redrive::kernels::vulkan
