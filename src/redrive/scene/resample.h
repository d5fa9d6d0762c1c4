// SPDX-License-Identifier: Apache-2.0
// Resamples images to another camera at the same place.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/image/image.h"

namespace redrive {

/// Position of each pixel of one camera in the image of another: [height, width]; (-1, -1) where
/// the other sees nothing.
struct ResampleMap {
  int width = 0, height = 0;
  std::vector<float> u, v;
};

/// `recorded_from_camera`: rotation between their axes.
ResampleMap make_resample_map(
    const Camera& camera, const Camera& recorded,
    const Eigen::Matrix3d& recorded_from_camera = Eigen::Matrix3d::Identity());

/// Returns a plane of interleaved channels, [height, width, channels], at the positions of the map,
/// bilinearly; `border` outside.
std::vector<std::uint8_t> resample(const ResampleMap& map, const std::vector<std::uint8_t>& values,
                                   int width, int height, int channels, std::uint8_t border);

}  // namespace redrive
