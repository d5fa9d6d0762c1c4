// SPDX-License-Identifier: Apache-2.0
// Windows of the training images that a method which rasterises draws, one a step.
#pragma once

#include <cstdint>
#include <vector>

#include "redrive/model/model.h"

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

/// Sizes that images are drawn in: the whole one, half of it, a quarter.
constexpr int kImageLevels = 3;

/// Cuts the training views' images into equal windows of at most `pixels`, but for rounding to
/// whole tiles.
void cut_into_windows(const TrainingSet& data, int pixels, ImageLevel* level);

/// Returns the images at full size, at half of it and at a quarter, each with windows of `pixels`.
std::vector<ImageLevel> image_levels(const TrainingSet& data, int pixels);

/// Returns the index of the level that a step at `progress` draws. Images that are cut at full size
/// have half of it before coarse_progress; those that are cut at half size have a quarter in the
/// first two thirds of that.
int level_at(const std::vector<ImageLevel>& levels, double progress, double coarse_progress);

/// Returns the index of the window that the n-th draw of a run takes, of `windows`: each once in an
/// epoch, in an order that follows from the seed.
std::size_t drawn_window(std::uint64_t seed, std::uint64_t n, std::uint64_t windows);

/// Sets which tiles of a window have pixels that are not masked, [rows / kTileSide, stride /
/// kTileSide] of its raster_size; empty: all.
void find_tiles(const Image8& image, const ImageWindow& window, std::vector<std::uint8_t>* tiles);

}  // namespace redrive
