// SPDX-License-Identifier: Apache-2.0
// Draws the pixels of a training step and writes their rays. PixelSampler (ray_table.h) decides
// which pixels are drawn and owns the source.
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

#include "redrive/base/rng.h"
#include "redrive/field/exposure.h"
#include "redrive/math/shutter_row.h"
#include "redrive/rays/error_map.h"

namespace redrive {

/// A fully transparent pixel is drawn in one of this many epochs.
constexpr int kEpochsPerTransparentPixel = 4;

/// Spans of a RayTable.
struct RayTableSpans {
  int width = 0, height = 0;
  float pixel_angle = 0;
  std::span<const std::uint32_t> pixel;
  std::span<const float> direction;
};

/// A training image and its view.
struct TrainingImage {
  std::uint32_t view = 0,
                camera = 0;  ///< indices in the scene; `camera` is also the index of the ray table
  std::size_t first_pose = 0, poses = 0;  ///< range in PixelSpans::poses, for pose_at_row
  bool by_column = false;                 ///< ShutterPoses::by_column
  Exposure exposure;
  std::span<const std::uint8_t> rgb, alpha, used;  ///< Image8
};

/// Pixels of an image: all of its table, or the ones in UsedPixels. One in `every` of them is drawn
/// each epoch.
struct PixelPool {
  std::uint32_t image = 0, every = 1;
  std::span<const std::uint64_t> bits;
  std::span<const std::uint32_t> before;
};

/// Input of gather_pixels except the errors of the cells.
struct PixelSpans {
  std::uint64_t pixels = 0;               ///< pixels of an epoch
  float background = 0;                   ///< grey level behind transparent images
  bool random_background = false;         ///< a random colour for each ray instead
  std::span<const RayTableSpans> tables;  ///< one per camera of the rig
  std::span<const TrainingImage> images;
  std::span<const PixelPool> pools;
  std::span<const std::uint64_t> offsets;  ///< [pools + 1]: first pixel of each pool
  std::span<const PlainPose> poses;        ///< world from camera
  std::span<const ErrorMapImage> cell_images;
  std::span<const float> cell_pixels;  ///< ErrorMapLayout::pixels
};

/// Parameters of one batch, made by PixelSampler::draw.
struct PixelDraw {
  int epoch_rays = 0, error_map_rays = 0;  ///< rays
  std::uint64_t epoch = 0, begin = 0;      ///< the first ray is the `begin`-th of the epoch
  std::uint64_t epoch_key = 0, error_key = 0, background_key = 0;
};

/// The batch to write, spans of RayBatch; background, cell and weight may be empty.
struct GatheredRays {
  std::span<float> origin, direction, target, background, pixel_angle, weight;
  std::span<Exposure> exposure;
  std::span<std::uint32_t> view, cell;
};

/// Returns the sampling weight of a pixel by its mask and alpha: 0 (masked), 1 /
/// kEpochsPerTransparentPixel, or 1.
inline float pixel_sampling_weight(std::span<const std::uint8_t> alpha,
                                   std::span<const std::uint8_t> used, std::size_t pixel) {
  if (!used.empty() && used[pixel] == 0) return 0;
  return !alpha.empty() && alpha[pixel] == 0 ? 1.0f / kEpochsPerTransparentPixel : 1;
}

/// Returns the entry of the k-th pixel in use (UsedPixels).
inline std::size_t used_entry(std::span<const std::uint64_t> bits,
                              std::span<const std::uint32_t> before, std::size_t k) {
  const std::size_t word = std::upper_bound(before.begin(), before.end(), k) - before.begin() - 1;
  std::uint64_t left = bits[word];
  for (std::size_t skip = k - before[word]; skip > 0; --skip) left &= left - 1;
  return 64 * word + std::countr_zero(left);
}

/// A drawn pixel.
struct DrawnPixel {
  std::uint32_t image = 0;
  std::size_t entry = 0;  ///< in its camera's ray table
};

/// Returns the k-th pixel of an epoch, by a random permutation of all pixels.
inline DrawnPixel pixel_of_epoch(const PixelSpans& from, const PixelDraw& draw, std::uint64_t k) {
  const std::uint64_t drawn = permute_index(draw.epoch_key, k, from.pixels);
  const std::size_t p =
      std::upper_bound(from.offsets.begin(), from.offsets.end(), drawn) - from.offsets.begin() - 1;
  const PixelPool& pool = from.pools[p];
  std::size_t entry = (drawn - from.offsets[p]) * pool.every + draw.epoch % pool.every;
  if (!pool.before.empty()) {
    const std::size_t last =
        pool.before[pool.before.size() - 1] - 1;  // the last one may be drawn twice
    entry = used_entry(pool.bits, pool.before, entry < last ? entry : last);
  }
  return {pool.image, entry};
}

/// Samples a cell by the error map, then a pixel in it by rejection with its sampling weight.
/// Rejection is slow in cells with few usable pixels, but these cells are rarely drawn.
inline DrawnPixel pixel_from_error_map(const PixelSpans& from, std::span<const float> errors,
                                       std::uint64_t key, CellSample* cell) {
  *cell = sample_cell(from.cell_pixels, errors, key);
  const CellRect rect = rect_of_cell(from.cell_images, cell->cell);
  const TrainingImage& image = from.images[rect.image];
  const RayTableSpans& table = from.tables[image.camera];
  const std::uint64_t pixel_key = mix64(key);
  for (std::uint64_t i = 0;; ++i) {
    const std::uint64_t bits = random_bits(pixel_key, i);
    const auto x = rect.x + static_cast<int>((bits >> 44) * rect.width >> 20),
               y = rect.y + static_cast<int>((bits >> 24 & 0xfffff) * rect.height >> 20);
    const auto pixel = static_cast<std::uint32_t>(y) * table.width + x;
    if (static_cast<float>(bits & 0xffffff) * 0x1p-24f >=
        pixel_sampling_weight(image.alpha, image.used, pixel))
      continue;
    const auto drawn = static_cast<std::uint32_t>(rect.image);
    if (table.pixel.size() == std::size_t(table.width) * table.height)
      return {drawn, pixel};  // the camera model is valid everywhere
    const auto found = std::lower_bound(table.pixel.begin(), table.pixel.end(), pixel);
    if (found != table.pixel.end() && *found == pixel)
      return {drawn, static_cast<std::size_t>(found - table.pixel.begin())};
  }
}

/// Writes origin, direction and pixel angle of ray i of n: entry k of the table, rotated in double,
/// so that the direction's length stays 1 to float's rounding.
inline void write_ray(const RayTableSpans& table, std::size_t k, const PlainPose* poses,
                      std::size_t n_poses, bool by_column, std::size_t i, std::size_t n,
                      const GatheredRays& out) {
  PlainPose of_line;
  if (n_poses > 1) {
    const int pixel = static_cast<int>(table.pixel[k]);
    of_line = pose_at_row(poses, n_poses,
                          line_fraction(by_column, pixel % table.width, pixel / table.width,
                                        table.width, table.height));
  }
  const PlainPose& world_from_camera = n_poses > 1 ? of_line : *poses;
  const double in_camera[3] = {table.direction[3 * k], table.direction[3 * k + 1],
                               table.direction[3 * k + 2]};
  for (int d = 0; d < 3; ++d) {
    out.origin[d * n + i] = static_cast<float>(world_from_camera.translation[d]);
    out.direction[d * n + i] = static_cast<float>(rotated(world_from_camera, in_camera, d));
  }
  out.pixel_angle[i] = table.pixel_angle;
}

/// Writes ray i of the batch except its weight. Returns its cell sample if the ray is drawn by the
/// error map.
inline CellSample gather_pixel(const PixelSpans& from, const PixelDraw& draw,
                               std::span<const float> errors, std::size_t i,
                               const GatheredRays& out) {
  CellSample cell;
  const std::size_t epoch_rays = draw.epoch_rays, n = epoch_rays + draw.error_map_rays;
  const DrawnPixel drawn =
      i < epoch_rays
          ? pixel_of_epoch(from, draw, draw.begin + i)
          : pixel_from_error_map(from, errors, random_bits(draw.error_key, i - epoch_rays), &cell);
  const TrainingImage& image = from.images[drawn.image];
  const RayTableSpans& table = from.tables[image.camera];
  write_ray(table, drawn.entry, &from.poses[image.first_pose], image.poses, image.by_column, i, n,
            out);
  out.exposure[i] = image.exposure;
  out.view[i] = image.view;
  const std::uint32_t pixel = table.pixel[drawn.entry];
  for (int c = 0; c < 3; ++c) {
    const std::size_t at = c * n + i;
    float colour = image.rgb[3 * std::size_t{pixel} + c] / 255.0f;
    if (!out.background.empty()) {
      const float behind =
          from.random_background ? random_unit(draw.background_key, at) : from.background;
      out.background[at] = behind;
      if (from.random_background)
        colour += (1 - image.alpha[pixel] / 255.0f) * (behind - from.background);
    }
    out.target[at] = colour;
  }
  if (!out.cell.empty()) out.cell[i] = cell_of_pixel(from.cell_images[drawn.image], pixel);
  return cell;
}

/// Writes the weight of ray i. pixels, error: sums of CellSample over all rays of the batch drawn
/// by the error map.
inline void write_ray_weight(const PixelDraw& draw, std::span<const float> errors, double pixels,
                             double error, std::size_t i, const GatheredRays& out) {
  const float mean = static_cast<float>(error / pixels),
              share = static_cast<float>(draw.error_map_rays) /
                      static_cast<float>(draw.epoch_rays + draw.error_map_rays);
  out.weight[i] = balance_heuristic_weight(errors[out.cell[i]], mean, share);
}

/// Writes all rays of the batch.
inline void gather_pixels(const PixelSpans& from, const PixelDraw& draw,
                          std::span<const float> errors, const GatheredRays& out) {
  const std::size_t epoch_rays = draw.epoch_rays, n = epoch_rays + draw.error_map_rays;
  for (std::size_t i = 0; i < epoch_rays; ++i) gather_pixel(from, draw, errors, i, out);
  double pixels = 0, error = 0;
  for (std::size_t i = epoch_rays; i < n; ++i) {
    const CellSample drawn = gather_pixel(from, draw, errors, i, out);
    pixels += drawn.pixels;
    error += drawn.error;
  }
  for (std::size_t i = 0; i < out.weight.size(); ++i)
    write_ray_weight(draw, errors, pixels, error, i, out);
}

}  // namespace redrive
