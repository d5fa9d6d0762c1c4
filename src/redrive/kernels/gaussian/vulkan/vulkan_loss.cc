// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/vulkan/vulkan_loss.h"

#include <algorithm>
#include <cmath>

#include "redrive/kernels/gaussian/target_window.h"

namespace redrive::kernels::vulkan {

/// Loss of shaders/loss.comp.
struct VulkanLoss::Parameters {
  VkDeviceAddress rgb, gains, transmittance, range_error, log_range, target, alpha, used, slopes,
      d_rgb, d_transmittance, error, d_range, tile_sums, sums, patches;
  std::uint32_t width, height, stride, rows, tiles_x, target_width, target_x, target_y, first_row,
      has_alpha, has_used, has_pixels, has_ranges, gain_columns, gain_rows;
  float cells_by_x, cells_by_y;
  float l1_weight, ssim_weight, transmittance_weight, range_each;
  float background_change[3];
};

namespace {

enum LossSum {
  kAbsolute,
  kSquares,
  kDissimilar,
  kPixels,
  kTarget,             ///< 3
  kTargetSquares = 7,  ///< 3
  kTransmittance = 10,
  kRangeError
};

/// Returns the gains at the centres of cells [3, rows, columns]; of one cell without shading.
std::vector<float> gain_cells(const PixelGains& gains) {
  const std::size_t cells = std::max<std::size_t>(gains.log_shading.size() / 3, 1);
  std::vector<float> out;
  for (std::size_t i = 0; i < 3 * cells; ++i)
    out.push_back(gains.colour[i / cells] *
                  (gains.log_shading.empty() ? 1.0f : std::exp(gains.log_shading[i])));
  return out;
}

}  // namespace

void VulkanLoss::send(const ImageLossInput& input, Parameters* p) {
  Queue& queue = shared_.queue();
  const TargetWindow& target = input.target;
  const KeptTargets::Image* const kept = shared_.targets.find(target);
  // The window's rows of the whole image.
  const std::size_t first = static_cast<std::size_t>(target.y) * target.width,
                    pixels = static_cast<std::size_t>(input.size.height) * target.width;
  const auto send = [&](DeviceBuffer* to, std::span<const std::uint8_t> from,
                        std::size_t channels) {
    if (kept || from.empty()) return VkDeviceAddress{0};
    queue.grow(to, channels * pixels + 4);
    queue.upload(*to, 0, from.data() + channels * first, channels * pixels);
    return to->address();
  };
  const KeptTargets::Image sent = {send(&target_, target.rgb, 3), send(&alpha_, target.alpha, 1),
                                   send(&used_, target.used, 1)};
  const KeptTargets::Image& image = kept ? *kept : sent;
  p->target = image.rgb;
  p->alpha = image.alpha ? image.alpha : image.rgb;
  p->used = image.used ? image.used : image.rgb;
  p->target_width = static_cast<std::uint32_t>(target.width);
  p->target_x = static_cast<std::uint32_t>(target.x);
  p->target_y = static_cast<std::uint32_t>(target.y);
  p->first_row = kept ? 0 : p->target_y;
  p->has_alpha = !target.alpha.empty();
  p->has_used = !target.used.empty();
  std::ranges::copy(target.background_change, p->background_change);

  const std::vector<float> gains = gain_cells(input.gains);
  const ImagePart part = part_of(target);
  queue.grow(&gains_, gains.size() * sizeof(float));
  queue.upload(gains_, 0, gains.data(), gains.size() * sizeof(float));
  p->gains = gains_.address();
  p->gain_columns = static_cast<std::uint32_t>(std::max(input.gains.columns, 1));
  p->gain_rows = static_cast<std::uint32_t>(std::max(input.gains.rows, 1));
  p->cells_by_x = static_cast<float>(p->gain_columns) / static_cast<float>(part.image_width);
  p->cells_by_y = static_cast<float>(p->gain_rows) / static_cast<float>(part.image_height);
}

void VulkanLoss::record(const LossPlanes& planes, const ImageLossInput& target,
                        const PixelWeights& weights) {
  Queue& queue = shared_.queue();
  const RasterSize size = planes.size;
  const std::size_t plane = size.plane(), tiles = plane / (kTileSide * kTileSide),
                    n_patches = plane / (kPatchSide * kPatchSide);
  queue.grow(&slopes_, 9 * plane * sizeof(float));
  queue.grow(&tile_sums_, tiles * kLossSums * sizeof(float));
  queue.grow(&sums_, sizeof image_sums_);
  queue.grow(&patches_, n_patches * sizeof(PatchBrightness));
  queue.grow(&parameters_, sizeof(Parameters));
  ImageLossInput input = target;
  input.size = size;
  Parameters p{};
  send(input, &p);

  l1_weight_ = static_cast<double>(input.l1_weight);
  ssim_weight_ = static_cast<double>(input.ssim_weight);
  range_weight_ = static_cast<double>(weights.range);
  const auto address = [](const DeviceBuffer* buffer, const DeviceBuffer* other) {
    return buffer ? buffer->address() : other->address();
  };
  p.rgb = planes.rgb->address();
  p.transmittance = address(planes.transmittance, planes.rgb);
  p.range_error = address(planes.range_error, planes.rgb);
  p.log_range = address(planes.log_range, planes.rgb);
  p.slopes = slopes_.address();
  p.d_rgb = planes.d_rgb->address();
  p.d_transmittance = address(planes.d_transmittance, planes.error);
  p.error = planes.error->address();
  p.d_range = address(planes.d_range, planes.error);
  p.tile_sums = tile_sums_.address();
  p.sums = sums_.address();
  p.patches = patches_.address();
  p.width = static_cast<std::uint32_t>(size.width);
  p.height = static_cast<std::uint32_t>(size.height);
  p.stride = static_cast<std::uint32_t>(size.stride);
  p.rows = static_cast<std::uint32_t>(size.rows);
  p.tiles_x = static_cast<std::uint32_t>(size.stride / kTileSide);
  p.has_pixels = planes.transmittance != nullptr;
  p.has_ranges = planes.log_range != nullptr;
  p.l1_weight = input.l1_weight;
  p.ssim_weight = input.ssim_weight;
  p.transmittance_weight = weights.transmittance;
  p.range_each = weights.range;
  queue.upload(parameters_, 0, &p, sizeof p);
  shared_.run("loss0", Push(parameters_), tiles);
  shared_.run("loss_sums",
              Push(tile_sums_, sums_, *planes.control, static_cast<std::uint32_t>(tiles)), 1);
  shared_.run("loss1", Push(parameters_), tiles);
  queue.stamp("loss");

  out_ = {};
  out_.patches.resize(n_patches);
  queue.download(sums_, 0, image_sums_, sizeof image_sums_);
  queue.download(patches_, 0, out_.patches.data(), n_patches * sizeof(PatchBrightness));
}

ImageLossOutput VulkanLoss::result() {
  const auto sum = [&](int k) { return static_cast<double>(image_sums_[k]); };
  const double pixels = std::max(sum(kPixels), 1.0), count = 3 * pixels;
  out_.l1 = l1_weight_ / count * sum(kAbsolute);
  out_.dssim = 0.5 * ssim_weight_ / count * sum(kDissimilar);
  out_.mse = sum(kSquares) / count;
  TargetSums target;
  target.pixels = sum(kPixels);
  for (int c = 0; c < 3; ++c) {
    target.sum[c] = sum(kTarget + c);
    target.squares[c] = sum(kTargetSquares + c);
  }
  target.finish(&out_);
  out_.transmittance = sum(kTransmittance) / pixels;
  out_.range = range_weight_ * sum(kRangeError);
  return std::move(out_);
}

}  // namespace redrive::kernels::vulkan
