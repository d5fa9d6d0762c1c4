// SPDX-License-Identifier: Apache-2.0
// Windows of the training images for a method that rasterises: a step draws one.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/model/trainee.h"

namespace redrive {

/// A part of a view's image.
struct ImageWindow {
  int view, x, y, width, height;  ///< pixels
};

/// Images of one size with their windows.
struct ImageLevel {
  std::vector<Camera> cameras;       ///< cameras of the rig
  std::vector<ImageWindow> windows;  ///< windows of the training views
};

/// Sizes at which images are drawn: full, half, a quarter.
constexpr int kImageLevels = 3;

/// Cuts the training views' images into equal windows of at most `pixels`, up to rounding to whole
/// tiles.
void cut_into_windows(const TrainingSet& data, int pixels, ImageLevel* level);

/// Returns the images at full size, at half of it and at a quarter, each with windows of `pixels`.
std::vector<ImageLevel> image_levels(const TrainingSet& data, int pixels);

/// Returns the index of the level that a step at `progress` draws. Images that are cut at full size
/// are halved before coarse_progress; images that are cut at half size, too, are quartered in the
/// first two thirds of that.
int level_at(const std::vector<ImageLevel>& levels, double progress, double coarse_progress);

/// Returns the index of the window that the n-th draw of a run takes, out of `windows`: each once
/// an epoch, in an order that follows from the seed.
std::size_t drawn_window(std::uint64_t seed, std::uint64_t n, std::uint64_t windows);

/// Marks the tiles of a window that have unmasked pixels, [rows / kTileSide, stride / kTileSide] of
/// its raster_size; empty: all.
void find_tiles(const Image8& image, const ImageWindow& window, ThreadPool& pool,
                std::vector<std::uint8_t>* tiles);

}  // namespace redrive
