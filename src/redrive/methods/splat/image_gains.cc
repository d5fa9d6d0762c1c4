// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/image_gains.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// Brightness added to ground truth and rendering: a ratio of black pixels means nothing.
constexpr double kDark = 0.01;

/// Bound of a cell's log gain, to either side: a darker cell hides the field, which then fits
/// nothing.
constexpr float kMostLogShading = 1.5f;

/// Weighted sums over patches, of one channel.
struct BrightnessSums {
  double pixels = 0, target = 0, rendered = 0;

  void add(const kernels::PatchBrightness& patch, int c, float weight) {
    pixels += static_cast<double>(weight * patch.pixels[c]);
    target += static_cast<double>(weight * patch.target[c]);
    rendered += static_cast<double>(weight * patch.rendered[c]);
  }
  /// Returns the logarithm of the missing gain.
  double log_ratio() const {
    if (pixels == 0) return 0;
    return std::clamp(std::log((target + kDark * pixels) / (rendered + kDark * pixels)), -2.3, 2.3);
  }
};

/// Returns the part of an image's change that a knot takes: a hat function that is 0 at the nearest
/// other images, or a knot away where they are nearer.
float knot_weight(int knot, float at, float before, float after) {
  const float distance = static_cast<float>(knot) - at,
              reach = std::max(1.0f, distance < 0 ? before : after);
  return std::max(0.0f, 1 - std::fabs(distance) / reach);
}

}  // namespace

ExposureTimes::ExposureTimes(const Scene& scene) : t_s_(scene.rig.size()) {
  for (const View& view : scene.views)
    if (!view.held_out) t_s_[view.camera].push_back(scene.exposure(view).t_s);
  for (std::vector<float>& times : t_s_) std::ranges::sort(times);
}

ExposureGaps ExposureTimes::gaps(const Exposure& at) const {
  constexpr float kEver = std::numeric_limits<float>::infinity();
  const std::vector<float>& times = t_s_[at.camera];
  const auto [same, later] = std::equal_range(times.begin(), times.end(), at.t_s);
  return {same == times.begin() ? kEver : at.t_s - *(same - 1),
          later == times.end() ? kEver : *later - at.t_s};
}

kernels::PixelGains ImageGains::of(std::span<const float> parameters,
                                   const Exposure& exposure) const {
  REDRIVE_CHECK_OP(parameters.size(), ==, this->size());
  kernels::PixelGains gains;
  std::ranges::copy(colour_gains(appearance, parameters.data(), exposure), gains.colour);
  if (exposure.camera < 0 || shading.size() == 0) return gains;
  const std::size_t of_camera = 3 * shading.cells();
  gains.columns = shading.columns;
  gains.rows = shading.rows;
  gains.log_shading =
      parameters.subspan(appearance.size() + of_camera * exposure.camera, of_camera);
  return gains;
}

void ImageGains::add_changes(std::span<const float> parameters, const Exposure& exposure,
                             const ExposureGaps& gaps, const kernels::RasterSize& size,
                             const ImagePart& part,
                             std::span<const kernels::PatchBrightness> patches, float decay,
                             std::span<float> changes) const {
  REDRIVE_CHECK_OP(parameters.size(), ==, this->size());
  REDRIVE_CHECK_OP(changes.size(), ==, this->size());
  if (exposure.camera < 0 || appearance.size() == 0) return;
  const float spacing_s = appearance.knot_spacing_s,
              at = std::clamp(exposure.t_s / spacing_s, 0.0f,
                              static_cast<float>(appearance.knots - 1));
  const std::array<float, 3> gain = colour_gains(appearance, parameters.data(), exposure);
  const int across = size.stride / kernels::kPatchSide;
  const float cell_pixels = static_cast<float>(part.image_width) *
                            static_cast<float>(part.image_height) /
                            static_cast<float>(std::max<std::size_t>(shading.cells(), 1));
  for (int c = 0; c < 3; ++c) {
    BrightnessSums all;
    for (const kernels::PatchBrightness& patch : patches) all.add(patch, c, 1);
    const auto of_all = static_cast<float>(all.log_ratio());
    const float by = (exposure_rate * of_all - exposure_decay * std::log(gain[c])) / kLogGainScale;
    for (int knot = 0; knot < appearance.knots; ++knot)
      changes[3 * (static_cast<std::size_t>(exposure.camera) * appearance.knots + knot) + c] +=
          (exposure_share + (1 - exposure_share) * knot_weight(knot, at, gaps.before_s / spacing_s,
                                                               gaps.after_s / spacing_s)) *
          by;
    if (shading.size() == 0) continue;

    std::vector<BrightnessSums> cells(shading.cells());
    for (std::size_t i = 0; i < patches.size(); ++i) {
      const kernels::PatchBrightness& patch = patches[i];
      const auto centre = [](std::size_t index) {
        return (static_cast<float>(index) + 0.5f) * kernels::kPatchSide;
      };
      const CellWeights x =
          cells_at(shading.columns, (static_cast<float>(part.x) + centre(i % across)) /
                                        static_cast<float>(part.image_width));
      const CellWeights y =
          cells_at(shading.rows, (static_cast<float>(part.y) + centre(i / across)) /
                                     static_cast<float>(part.image_height));
      const auto add = [&](int row, int column, float weight) {
        cells[static_cast<std::size_t>(row) * shading.columns + column].add(patch, c, weight);
      };
      add(y.first, x.first, (1 - y.second_weight) * (1 - x.second_weight));
      add(y.first, x.second, (1 - y.second_weight) * x.second_weight);
      add(y.second, x.first, y.second_weight * (1 - x.second_weight));
      add(y.second, x.second, y.second_weight * x.second_weight);
    }
    const std::size_t first =
        appearance.size() + (3 * static_cast<std::size_t>(exposure.camera) + c) * shading.cells();
    for (std::size_t k = 0; k < cells.size(); ++k) {
      const float seen = std::min(1.0f, static_cast<float>(cells[k].pixels) / cell_pixels);
      const auto off = static_cast<float>(cells[k].log_ratio());
      const float rate = decay * seen * shading_rate, before = parameters[first + k],
                  moved = before + rate * off;
      // Soft thresholding: what the field can explain as well stays in the field.
      const float after = std::copysign(
          std::clamp(std::fabs(moved) - rate * shading_threshold, 0.0f, kMostLogShading), moved);
      changes[first + k] += after - before;
    }
  }
}

}  // namespace redrive
