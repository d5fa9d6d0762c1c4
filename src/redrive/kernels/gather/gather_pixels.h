// SPDX-License-Identifier: Apache-2.0
// How the pixels of a training step are drawn and made rays, one ray at a time and from plain
// numbers, so that a backend which keeps pictures in memory of its own gathers there (kernels.h,
// gather). PixelSampler says what is drawn, and owns what it is drawn from.
#pragma once

#include <algorithm>
#include <bit>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>

#include "redrive/base/rng.h"
#include "redrive/field/exposure.h"
#include "redrive/kernels/gather/error_map.h"
#include "redrive/math/shutter_row.h"

namespace redrive {

/// How rarely a pixel that is wholly transparent is drawn.
constexpr int kEpochsPerTransparentPixel = 4;

/// The numbers of a RayTable.
struct RayTableSpans {
  int width = 0, height = 0;
  float pixel_angle = 0;
  std::span<const std::uint32_t> pixel;
  std::span<const float> direction;
};

/// A picture that is trained on, and its view.
struct TrainingImage {
  std::uint32_t view = 0, camera = 0;     ///< of the scene; the camera's is also its table
  std::size_t first_pose = 0, poses = 0;  ///< of PixelSpans::poses, as pose_at_row has them
  Exposure exposure;
  std::span<const std::uint8_t> rgb, alpha, used;  ///< Image8
};

/// Pixels of a picture: all of its table, or those that UsedPixels says; of those one in `every` an
/// epoch.
struct PixelPool {
  std::uint32_t picture = 0, every = 1;
  std::span<const std::uint64_t> bits;
  std::span<const std::uint32_t> before;
};

/// Where all lies that a gather reads, but for the errors of the cells.
struct PixelSpans {
  std::uint64_t pixels = 0;               ///< of an epoch
  float background = 0;                   ///< that pictures lie on, a grey
  bool random_background = false;         ///< each ray has another in its place
  std::span<const RayTableSpans> tables;  ///< by camera of the rig
  std::span<const TrainingImage> pictures;
  std::span<const PixelPool> pools;
  std::span<const std::uint64_t> offsets;  ///< [pools + 1]: first pixel of each
  std::span<const PlainPose> poses;        ///< world from camera
  std::span<const ErrorMapImage> cell_pictures;
  std::span<const float> cell_pixels;  ///< ErrorMapLayout::pixels
};

/// A sampler's, on the host. A backend that keeps them elsewhere does so from the first gather on;
/// then one source has one backend.
template <class Spans>
struct GatherSource : Spans {
  int placed = 0;  ///< counts on when Spans::poses have changed
  mutable std::shared_ptr<void> elsewhere;
};
using PixelSource = GatherSource<PixelSpans>;

/// What a batch is drawn by: PixelSampler::draw.
struct PixelDraw {
  int even = 0, error_map_rays = 0;    ///< rays
  std::uint64_t epoch = 0, begin = 0;  ///< the first even one is the `begin`-th of the epoch
  std::uint64_t epoch_key = 0, error_key = 0, background_key = 0;
};

/// A batch to be written, RayBatch's numbers: background, cell and weight may be empty.
struct GatheredRays {
  std::span<float> origin, direction, target, background, pixel_angle, weight;
  std::span<Exposure> exposure;
  std::span<std::uint32_t> view, cell;
};

/// How often a pixel that the camera reaches is drawn beside others, by its mask and alpha.
REDRIVE_HD inline float pixel_sampling_weight(std::span<const std::uint8_t> alpha,
                                              std::span<const std::uint8_t> used,
                                              std::size_t pixel) {
  if (!used.empty() && used[pixel] == 0) return 0;
  return !alpha.empty() && alpha[pixel] == 0 ? 1.0f / kEpochsPerTransparentPixel : 1;
}

/// UsedPixels: the entry that is the k-th in use.
REDRIVE_HD inline std::size_t used_entry(std::span<const std::uint64_t> bits,
                                         std::span<const std::uint32_t> before, std::size_t k) {
  const std::size_t word = std::upper_bound(before.begin(), before.end(), k) - before.begin() - 1;
  std::uint64_t left = bits[word];
  for (std::size_t skip = k - before[word]; skip > 0; --skip) left &= left - 1;
  return 64 * word + std::countr_zero(left);
}

/// A picture's ray.
struct DrawnPixel {
  std::uint32_t picture = 0;
  std::size_t entry = 0;  ///< of its camera's table
};

/// The k-th of an epoch.
REDRIVE_HD inline DrawnPixel pixel_of_epoch(const PixelSpans& from, const PixelDraw& draw,
                                            std::uint64_t k) {
  const std::uint64_t drawn = permute_index(draw.epoch_key, k, from.pixels);
  const std::size_t p =
      std::upper_bound(from.offsets.begin(), from.offsets.end(), drawn) - from.offsets.begin() - 1;
  const PixelPool& pool = from.pools[p];
  std::size_t entry = (drawn - from.offsets[p]) * pool.every + draw.epoch % pool.every;
  if (!pool.before.empty()) {
    const std::size_t last = pool.before[pool.before.size() - 1] - 1;  // which may be drawn twice
    entry = used_entry(pool.bits, pool.before, entry < last ? entry : last);
  }
  return {pool.picture, entry};
}

/// A pixel of the cell by its share: pixels are drawn evenly until one is taken. Where few can be,
/// that takes long, but such cells are drawn as rarely.
REDRIVE_HD inline DrawnPixel pixel_from_error_map(const PixelSpans& from,
                                                  std::span<const float> errors, std::uint64_t key,
                                                  CellSample* cell) {
  *cell = sample_cell(from.cell_pixels, errors, key);
  const CellRect rect = rect_of_cell(from.cell_pictures, cell->cell);
  const TrainingImage& picture = from.pictures[rect.picture];
  const RayTableSpans& table = from.tables[picture.camera];
  const std::uint64_t pixel_key = mix64(key);
  for (std::uint64_t i = 0;; ++i) {
    const std::uint64_t bits = random_bits(pixel_key, i);
    const auto x = rect.x + static_cast<int>((bits >> 44) * rect.width >> 20),
               y = rect.y + static_cast<int>((bits >> 24 & 0xfffff) * rect.height >> 20);
    const auto pixel = static_cast<std::uint32_t>(y) * table.width + x;
    if (static_cast<float>(bits & 0xffffff) * 0x1p-24f >=
        pixel_sampling_weight(picture.alpha, picture.used, pixel))
      continue;
    const auto drawn = static_cast<std::uint32_t>(rect.picture);
    if (table.pixel.size() == std::size_t(table.width) * table.height)
      return {drawn, pixel};  // the camera reaches all
    const auto found = std::lower_bound(table.pixel.begin(), table.pixel.end(), pixel);
    if (found != table.pixel.end() && *found == pixel)
      return {drawn, static_cast<std::size_t>(found - table.pixel.begin())};
  }
}

/// Origin, direction and width of ray i of n: entry k of the table, turned in double so that its
/// length stays 1 to float's rounding.
REDRIVE_HD inline void write_ray(const RayTableSpans& table, std::size_t k, const PlainPose* poses,
                                 std::size_t n_poses, std::size_t i, std::size_t n,
                                 const GatheredRays& out) {
  PlainPose of_row;
  if (n_poses > 1)
    of_row = pose_at_row(
        poses, n_poses, row_fraction(static_cast<int>(table.pixel[k]) / table.width, table.height));
  const PlainPose& world_from_camera = n_poses > 1 ? of_row : *poses;
  const double in_camera[3] = {table.direction[3 * k], table.direction[3 * k + 1],
                               table.direction[3 * k + 2]};
  for (int d = 0; d < 3; ++d) {
    out.origin[d * n + i] = static_cast<float>(world_from_camera.translation[d]);
    out.direction[d * n + i] = static_cast<float>(turned(world_from_camera, in_camera, d));
  }
  out.pixel_angle[i] = table.pixel_angle;
}

/// Ray i of the batch, but for its weight. Returns what it was drawn by, if by error.
REDRIVE_HD inline CellSample gather_pixel(const PixelSpans& from, const PixelDraw& draw,
                                          std::span<const float> errors, std::size_t i,
                                          const GatheredRays& out) {
  CellSample cell;
  const std::size_t even = draw.even, n = even + draw.error_map_rays;
  const DrawnPixel drawn =
      i < even ? pixel_of_epoch(from, draw, draw.begin + i)
               : pixel_from_error_map(from, errors, random_bits(draw.error_key, i - even), &cell);
  const TrainingImage& picture = from.pictures[drawn.picture];
  const RayTableSpans& table = from.tables[picture.camera];
  write_ray(table, drawn.entry, &from.poses[picture.first_pose], picture.poses, i, n, out);
  out.exposure[i] = picture.exposure;
  out.view[i] = picture.view;
  const std::uint32_t pixel = table.pixel[drawn.entry];
  for (int c = 0; c < 3; ++c) {
    const std::size_t at = c * n + i;
    float colour = picture.rgb[3 * std::size_t{pixel} + c] / 255.0f;
    if (!out.background.empty()) {
      const float behind =
          from.random_background ? random_unit(draw.background_key, at) : from.background;
      out.background[at] = behind;
      if (from.random_background)
        colour += (1 - picture.alpha[pixel] / 255.0f) * (behind - from.background);
    }
    out.target[at] = colour;
  }
  if (!out.cell.empty()) out.cell[i] = cell_of_pixel(from.cell_pictures[drawn.picture], pixel);
  return cell;
}

/// The weight of ray i: sums over what its fellows by error were drawn by are those of CellSample.
REDRIVE_HD inline void write_ray_weight(const PixelDraw& draw, std::span<const float> errors,
                                        double pixels, double error, std::size_t i,
                                        const GatheredRays& out) {
  const float mean = static_cast<float>(error / pixels),
              share = static_cast<float>(draw.error_map_rays) /
                      static_cast<float>(draw.even + draw.error_map_rays);
  out.weight[i] = balance_heuristic_weight(errors[out.cell[i]], mean, share);
}

/// All rays of the batch, on the host.
inline void gather_pixels(const PixelSpans& from, const PixelDraw& draw,
                          std::span<const float> errors, const GatheredRays& out) {
  const std::size_t even = draw.even, n = even + draw.error_map_rays;
  for (std::size_t i = 0; i < even; ++i) gather_pixel(from, draw, errors, i, out);
  double pixels = 0, error = 0;
  for (std::size_t i = even; i < n; ++i) {
    const CellSample drawn = gather_pixel(from, draw, errors, i, out);
    pixels += drawn.pixels;
    error += drawn.error;
  }
  for (std::size_t i = 0; i < out.weight.size(); ++i)
    write_ray_weight(draw, errors, pixels, error, i, out);
}

}  // namespace redrive
