// SPDX-License-Identifier: Apache-2.0
// Gains of images that are rasterised whole: exposure and white balance (field/appearance.h) times
// the camera's shading (field/shading.h). Parameters: the exposures', then the shading's. They have
// no gradient: a step measures patch by patch how much brighter its image's ground truth is than
// the rendering, and moves the gains a part of the way there.
#pragma once

#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/field/appearance.h"
#include "redrive/field/shading.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// The position of a window in an image: its first pixel and the size of the whole image.
struct ImagePart {
  int x = 0, y = 0, image_width = 1, image_height = 1;
};

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

  /// Writes the gains of channel c along row y of the part, from its first pixel on. Pixels beyond
  /// the image have finite values.
  void write_row(std::span<const float> parameters, const Exposure& exposure, const ImagePart& part,
                 int y, int c, std::span<float> row) const;
  /// Writes the gains of each pixel, 3 planes of `size`. The padding has finite values. pool: null:
  /// one thread.
  void write_planes(std::span<const float> parameters, const Exposure& exposure,
                    const kernels::RasterSize& size, const ImagePart& part, std::span<float> planes,
                    ThreadPool* pool = nullptr) const;

  /// Adds an image's changes, laid out as the parameters. patches: patches of the window's loss
  /// with the gains of `parameters`; decay: 0..1, factor of the shading's rates, so that it
  /// settles.
  void add_changes(std::span<const float> parameters, const Exposure& exposure,
                   const ExposureGaps& gaps, const kernels::RasterSize& size, const ImagePart& part,
                   std::span<const kernels::PatchBrightness> patches, float decay,
                   std::span<float> changes) const;
};

}  // namespace redrive
