// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/image_windows.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {
namespace {

constexpr double kQuarterShare = 2.0 / 3;  // share of the steps at less than full size

}  // namespace

void cut_into_windows(const TrainingSet& data, int pixels, ImageLevel* level) {
  for (std::size_t v = 0; v < data.scene.views.size(); ++v) {
    const View& view = data.scene.views[v];
    if (view.held_out) continue;
    const Camera& camera = level->cameras[view.camera];
    const double parts =
        std::max(1.0, std::ceil(static_cast<double>(camera.width) * camera.height / pixels));
    const int down = std::max(1, static_cast<int>(
                                     std::lround(std::sqrt(parts * camera.height / camera.width)))),
              across = static_cast<int>(std::ceil(parts / down));
    const auto side = [](int length, int n) {
      return (length + n * kernels::kTileSide - 1) / (n * kernels::kTileSide) * kernels::kTileSide;
    };
    const int width = side(camera.width, across), height = side(camera.height, down);
    for (int y = 0; y < camera.height; y += height)
      for (int x = 0; x < camera.width; x += width)
        level->windows.push_back({static_cast<int>(v), x, y, std::min(width, camera.width - x),
                                  std::min(height, camera.height - y)});
  }
}

std::vector<ImageLevel> image_levels(const TrainingSet& data, int pixels) {
  std::vector<ImageLevel> levels(kImageLevels);
  for (int k = 0; k < kImageLevels; ++k) {
    for (const RigCamera& rig : data.scene.rig)
      levels[k].cameras.push_back(rig.camera.downscaled(1 << k));
    cut_into_windows(data, pixels, &levels[k]);
  }
  return levels;
}

int level_at(const std::vector<ImageLevel>& levels, double progress, double coarse_progress) {
  int level = progress < kQuarterShare * coarse_progress ? 2 : progress < coarse_progress ? 1 : 0;
  while (level > 0 && (levels[level].windows.empty() ||  // images with fewer than 4 pixels a side
                       levels[level].windows.size() == levels[level - 1].windows.size()))
    --level;
  return level;
}

std::size_t drawn_window(std::uint64_t seed, std::uint64_t n, std::uint64_t windows) {
  return permute_index(random_key(seed, kStreamPixels, n / windows), n % windows, windows);
}

void find_tiles(const Image8& image, const ImageWindow& window, ThreadPool& pool,
                std::vector<std::uint8_t>* tiles) {
  tiles->clear();
  if (image.used.empty()) return;
  const kernels::RasterSize size = kernels::raster_size(window.width, window.height);
  const std::size_t across = size.stride / kernels::kTileSide,
                    down = size.rows / kernels::kTileSide;
  tiles->assign(across * down, 0);
  pool.run_ranges(down, 4, [&](std::size_t first, std::size_t end_row) {
    const int end_y = std::min(static_cast<int>(end_row) * kernels::kTileSide, window.height);
    for (int y = static_cast<int>(first) * kernels::kTileSide; y < end_y; ++y) {
      const std::uint8_t* const row =
          &image.used[static_cast<std::size_t>(window.y + y) * image.width + window.x];
      for (int tile = 0; tile < static_cast<int>(across); ++tile) {
        const int begin = tile * kernels::kTileSide,
                  end = std::min(begin + kernels::kTileSide, window.width);
        std::uint8_t any = 0;
        for (int x = begin; x < end; ++x) any |= row[x];
        (*tiles)[static_cast<std::size_t>(y / kernels::kTileSide) * across +
                 static_cast<std::size_t>(tile)] |= any;
      }
    }
  });
}

}  // namespace redrive
