// SPDX-License-Identifier: Apache-2.0
// Gains of images that are rasterised whole: exposure and white balance (field/appearance.h) times
// the camera's shading (field/shading.h). Parameters: the exposures', then the shading's. They have
// no gradient: a step measures patch by patch how much brighter its image's ground truth is than
// the rendering, and moves the gains a part of the way there.
#pragma once

#include <span>
#include <vector>

#include "redrive/field/appearance.h"
#include "redrive/field/shading.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Time between an image and the nearest other training images of its camera, before and after,
/// seconds; infinite where there are none. Exposures between two training images are interpolated.
struct ExposureGaps {
  float before_s = 0, after_s = 0;
};

/// When each camera exposed its training images.
class ExposureTimes {
 public:
  explicit ExposureTimes(const Scene& scene);

  ExposureGaps gaps(const Exposure& at) const;

 private:
  std::vector<std::vector<float>> t_s_;  ///< one list per camera, ascending
};

struct ImageGains {
  AppearanceConfig appearance;  ///< exposure of each camera at each frame
  ShadingConfig shading;
  float exposure_rate = 0.3f, exposure_decay = 0.02f;
  float exposure_share = 0.2f;  ///< share of a change that all images of the camera take
  float shading_rate = 0.2f;
  float shading_threshold = 0.02f;  ///< soft threshold of log gains

  std::size_t size() const { return appearance.size() + shading.size(); }

  /// Returns the gains of an image, which refer to `parameters`.
  kernels::PixelGains of(std::span<const float> parameters, const Exposure& exposure) const;

  /// Adds an image's changes, laid out as the parameters. patches: patches of the window's loss
  /// with the gains of `parameters`; decay: 0..1, factor of the shading's rates, so that it
  /// settles.
  void add_changes(std::span<const float> parameters, const Exposure& exposure,
                   const ExposureGaps& gaps, const kernels::RasterSize& size, const ImagePart& part,
                   std::span<const kernels::PatchBrightness> patches, float decay,
                   std::span<float> changes) const;
};

}  // namespace redrive
