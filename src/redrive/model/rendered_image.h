// SPDX-License-Identifier: Apache-2.0
// Images and rays that a model renders.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace redrive {

/// What a labelled image shows of a moving object.
struct SeenActor {
  int number = 0;  ///< 1 + index into Scene::actors, as in RenderedImage::ids
  /// Pixels that show it or its shadow; pixels that would if nothing were before it, and the
  /// columns and rows of these, inclusive.
  std::uint32_t visible = 0, whole = 0;
  int left = 0, top = 0, right = 0, bottom = 0;
  bool articulated = false;  ///< its parts move on their own, not with its box
};

/// An image that a model renders. Pixels outside the valid region of the camera model are black
/// with depth 0, opacity 0 and valid 0.
struct RenderedImage {
  int width = 0, height = 0;
  std::vector<float> rgb;           ///< [height, width, 3] in [0, 1]
  std::vector<float> depth;         ///< [height, width], metres along the ray, median
  std::vector<float> opacity;       ///< [height, width]
  std::vector<std::uint8_t> valid;  ///< [height, width]
  /// Set before an image is rendered: `ids` and `seen` are wanted. A field that draws no moving
  /// objects leaves `seen` empty.
  bool labelled = false;
  /// [height, width], where labelled: 1 + index into Scene::actors of the moving object whose
  /// blending weights have the largest sum in the pixel; 0: the static world has
  std::vector<std::uint16_t> ids;
  std::vector<SeenActor> seen;  ///< objects with a pixel in `whole`, ascending by number

  /// Sets the size. Pixels have unspecified values.
  void resize(int new_width, int new_height) {
    width = new_width;
    height = new_height;
    const std::size_t pixels = static_cast<std::size_t>(width) * height;
    rgb.resize(3 * pixels);
    depth.resize(pixels);
    opacity.resize(pixels);
    valid.resize(pixels);
    if (labelled) ids.resize(pixels);
  }
  /// Sets the size. All pixels become black and invalid.
  void clear(int new_width, int new_height) {
    resize(new_width, new_height);
    std::ranges::fill(rgb, 0.0f);
    std::ranges::fill(depth, 0.0f);
    std::ranges::fill(opacity, 0.0f);
    std::ranges::fill(valid, std::uint8_t{0});
    std::ranges::fill(ids, std::uint16_t{0});
    seen.clear();
  }
};

/// What single rays meet, as a LiDAR measures it.
struct RenderedRays {
  std::vector<float> depth;    ///< [n], metres from the origin along the ray, median
  std::vector<float> opacity;  ///< [n]
  // Empty where a method does not model them:
  std::vector<float> intensity;  ///< [n] intensity of the return, 0..1 of full scale
  std::vector<float> lost;       ///< [n] probability that nothing comes back

  /// Returns the probability that something comes back along ray i.
  float returned(std::size_t i) const {
    return lost.empty() ? opacity[i] : std::min(opacity[i], 1 - lost[i]);
  }
  /// Sets ray i to ray j of other ones.
  void put(std::size_t i, const RenderedRays& from, std::size_t j) {
    depth[i] = from.depth[j];
    opacity[i] = from.opacity[j];
    if (from.lost.empty()) return;
    intensity.resize(depth.size());
    lost.resize(depth.size(), 1.0f);
    intensity[i] = from.intensity[j];
    lost[i] = from.lost[j];
  }
};

}  // namespace redrive
