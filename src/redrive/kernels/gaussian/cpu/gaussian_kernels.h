// SPDX-License-Identifier: Apache-2.0
// Inner loops of rasterising Gaussians as a table of functions, compiled once per vector width.
// cpu_gaussian_stages.cc cuts the work and owns the memory.
#pragma once

#include <cstddef>
#include <cstdint>

#include "redrive/camera/plain_camera.h"
#include "redrive/field/gaussian.h"
#include "redrive/kernels/gaussian/pair_sums.h"
#include "redrive/kernels/gaussian/part_extent.h"

namespace redrive::kernels {

/// A drawn Gaussian, one cache line.
struct alignas(64) RasterRecord {
  float x, y;        ///< mean, pixels
  float xx, xy, yy;  ///< log2 of the falloff at (dx, dy): xx dx^2 + xy dx dy + yy dy^2
  float log2_alpha;  ///< log2 of alpha at the mean
  float rgb[3];
  float slope_x;       ///< change of the logarithm of the distance per pixel
  float log_distance;  ///< distance of the mean from the camera, log metres
  float radius[2];     ///< half sides of the rectangle beyond which alpha is below kMinAlpha
  std::uint32_t first_pair, pairs;  ///< pairs with its tiles, in the order of their making
  float slope_y;
};
static_assert(sizeof(RasterRecord) == 64);
constexpr int kRecordFloats = 16;

constexpr int kBlockColumns = 4;

/// A Gaussian in a tile. Bit b of `blocks` stands for block b of the tile's pixels; a block has as
/// many pixels as a vector has lanes, kBlockColumns a row, and blocks are numbered row by row.
struct TilePair {
  std::uint32_t gaussian, tile, blocks, slot;
};

/// Keys of a rolling shutter: quaternion w x y z of camera_from_world, then the centre in the
/// world.
struct ShutterKeys {
  int n = 1;
  const float* keys = nullptr;          ///< [n, 7], neighbours on the same half of the sphere
  float rotation[9];                    ///< camera_from_world of the only key
  bool by_column = false;               ///< GaussianCamera::by_column
  float first = 0;                      ///< v, or u, of the first pose that is tried
  float row_scale = 0, row_offset = 0;  ///< position among the keys: row_scale v + row_offset
};

/// RasterBounds, for files with ISA flags.
struct Bounds {
  float left = 0, right = 0, top = 0, bottom = 0;
};

struct ProjectionJob {
  PlainCamera camera;
  ShutterKeys shutter;
  const float* gaussians = nullptr;  ///< blocks
  Bounds pixels;
  bool bounds_means = false;  ///< whether means must lie in `means` (mean_bounds.h)
  Bounds means;
};

struct TileJob {
  int tile_x = 0, tile_y = 0;
  const RasterRecord* records = nullptr;
  const TilePair* pairs = nullptr;
  std::size_t n = 0;
  // Planes; `stride` floats a row.
  std::size_t stride = 0, plane = 0;
  const float* log_range = nullptr;        ///< may be null
  const float *u = nullptr, *v = nullptr;  ///< PixelCentres; null: none
  // Scratch of tile_scratch(n) floats, 64-byte aligned:
  float* scratch = nullptr;
};
struct TileForwardJob : TileJob {
  float *rgb = nullptr, *transmittance = nullptr;
  float* depth = nullptr;  ///< may be null
  float* range_error = nullptr;
  float background[3] = {0, 0, 0};
};
struct TileBackwardJob : TileJob {
  const float *rgb = nullptr, *transmittance = nullptr, *range_error = nullptr;
  const float *d_rgb = nullptr, *d_transmittance = nullptr, *error = nullptr, *d_range = nullptr;
  float* sums = nullptr;  ///< [all pairs, kRecordFloats]: PairSum, by TilePair::slot
};
static constexpr std::size_t tile_scratch(std::size_t n) {
  return 2 * kRecordFloats * n + 32 * (n + 16);
}

/// A part that a tile shows; 0: the world.
struct TilePart {
  std::uint32_t part;
  PartExtent extent;
};
struct TilePartsJob : TileJob {
  int width = 0, height = 0;                      ///< size of the image without padding
  const std::uint32_t* first_gaussian = nullptr;  ///< [n_parts], ascending
  std::uint32_t n_parts = 0;                      ///< without the world
  std::uint16_t* parts = nullptr;                 ///< plane (RasterImage::parts)
  /// [1 + min(n, n_parts)], written: the world, then the parts of the tile's Gaussians.
  TilePart* found = nullptr;
  /// Scratch of two vectors for each of `found`, 64-byte aligned, and of n numbers.
  float* sums = nullptr;
  std::uint32_t* place = nullptr;
};

struct UpdateJob {
  const float* rates;  ///< one per row
  float beta1, beta2, bias1, bias2, epsilon, min_log_scale, max_log_scale;
  float* numbers;
  std::uint32_t* moments;
  float* errors;
  std::size_t bounded_colours;  ///< GaussianUpdate::bounded_colours
  SeenBy rows;
};

struct ProjectionBackwardJob : ProjectionJob {
  const RasterRecord* records = nullptr;
  const std::uint16_t* visible = nullptr;  ///< a bit for each Gaussian of a block
  const float* sums = nullptr;
  float* gradients = nullptr;         ///< blocks, added to; null: for `update`, or only errors
  float* errors = nullptr;            ///< one per Gaussian, added to; null: for `update`
  const UpdateJob* update = nullptr;  ///< applied to each block once its derivatives are complete
  double* d_pose = nullptr;           ///< [6]: translation, rotation; added to; may be null
};

/// Rows of the loss of an image. The window filter goes along rows, then along columns; planes of
/// moments have the size of the image.
struct LossJob {
  int width = 0, height = 0;
  std::size_t stride = 0, plane = 0;
  const float *rgb = nullptr, *gains = nullptr, *target = nullptr, *mask = nullptr;
  float l1_scale, ssim_scale;   ///< weights over the number of masked numbers
  const float* taps = nullptr;  ///< taps of the window
  float* masked = nullptr;   ///< 6 planes: 3 of the image with its gains, 3 of its target; 0 masked
  float* moments = nullptr;  ///< 15 planes
  float* slopes = nullptr;   ///< 9 planes
  float *d_rgb = nullptr, *error = nullptr;
};
/// Sums of one row.
struct LossSums {
  double l1, squares, ssim;
};
constexpr int kLossPasses = 5;
/// Floats of scratch memory of a row.
static constexpr std::size_t loss_scratch(std::size_t stride) { return 2 * (stride + 32); }

/// Where the tiles of PixelCentres are along u or v: the least and greatest centre of each column
/// or row of tiles, made to ascend, so that the first and last tile of an interval can be found.
struct TileAxis {
  const float *low = nullptr, *high = nullptr;  ///< [tiles]
  float first = 0, tiles_per_unit = 0;          ///< guess of the tile at a u or v
};

/// The tiles of a raster.
struct TileGrid {
  int tiles_x = 0, tiles_y = 0;
  // With PixelCentres:
  TileAxis along_u, along_v;
  /// [tiles, 4, blocks of a tile]: least and greatest u, then v of each block; null: no centres.
  const float* boxes = nullptr;
};

/// Returns the first of n ascending numbers that is at least `at`; n: none is.
static inline __attribute__((always_inline)) int first_from(const float* ascending, int n, float at,
                                                            float guess) {
  int i = guess <= 0 ? 0 : guess >= static_cast<float>(n) ? n : static_cast<int>(guess);
  while (i > 0 && ascending[i - 1] >= at) --i;
  while (i < n && ascending[i] < at) ++i;
  return i;
}

/// Tiles that a Gaussian's rectangle overlaps, inclusive; none where an end is before its begin.
struct TileRange {
  int x0, x1, y0, y1;
};
static inline __attribute__((always_inline)) TileRange tiles_of(const RasterRecord& r,
                                                                const TileGrid& grid) {
  const int tiles_x = grid.tiles_x, tiles_y = grid.tiles_y;
  if (grid.boxes) {
    const auto first = [](const float* ascending, const TileAxis& axis, int n, float at)
        __attribute__((always_inline)) {
      return first_from(ascending, n, at, (at - axis.first) * axis.tiles_per_unit);
    };
    const TileAxis &u = grid.along_u, &v = grid.along_v;
    return {first(u.high, u, tiles_x, r.x - r.radius[0]),
            first(u.low, u, tiles_x, r.x + r.radius[0]) - 1,
            first(v.high, v, tiles_y, r.y - r.radius[1]),
            first(v.low, v, tiles_y, r.y + r.radius[1]) - 1};
  }
  // Tile k has the pixel centres 16 k .. 16 k + 15. Bounded before the conversion.
  const auto tile = [](float at, int last) __attribute__((always_inline)) {
    const float t = (at + 0.5f) * (1.0f / 16);
    return t <= 0 ? 0 : t >= static_cast<float>(last) ? last : static_cast<int>(t);
  };
  return {tile(r.x - r.radius[0], tiles_x - 1), tile(r.x + r.radius[0], tiles_x - 1),
          tile(r.y - r.radius[1], tiles_y - 1), tile(r.y + r.radius[1], tiles_y - 1)};
}

struct GaussianKernels {
  /// Projects blocks [begin, end): writes records, `visible` and keys (distance in the upper half,
  /// index in the lower) of those drawn; returns their number.
  std::size_t (*project)(const ProjectionJob& job, std::size_t begin, std::size_t end,
                         RasterRecord* records, std::uint16_t* visible, std::uint64_t* keys);
  /// Projects points [begin, end) of [3, n] to pixels [2, n] (GaussianStages::project_points).
  void (*project_points)(const ProjectionJob& job, const float* points, std::size_t n,
                         std::size_t begin, std::size_t end, float* pixels);
  /// Writes the pairs of the Gaussians of keys [n] with tiles; sets RasterRecord::pairs. Returns
  /// their number. wanted: by tile, or null.
  std::size_t (*bin)(RasterRecord* records, const std::uint64_t* keys, std::size_t n,
                     const TileGrid& grid, const std::uint8_t* wanted, TilePair* pairs);
  void (*tile_forward)(const TileForwardJob& job);
  void (*tile_backward)(const TileBackwardJob& job);
  /// Writes RasterImage::parts; returns the number of `found`, 0 where only the world is.
  std::uint32_t (*tile_parts)(const TilePartsJob& job);
  void (*project_backward)(const ProjectionBackwardJob& job, std::size_t begin, std::size_t end);
  /// Updates blocks by gradients that were kept.
  void (*update)(const UpdateJob& job, const float* gradients, const float* errors,
                 std::size_t begin, std::size_t end);
  /// Row y in pass 0..kLossPasses-1; a pass needs all rows of the pass before. Passes 0 and 2
  /// write parts of sums; without SSIM 1 to 3 are left out. scratch: loss_scratch floats.
  void (*loss_row)(const LossJob& job, int pass, int y, float* scratch, LossSums* sums);
  int block_rows;  ///< rows of a block of pixels (TilePair)
};

namespace avx2 {
extern const GaussianKernels kGaussianKernels;
}
namespace avx512 {
extern const GaussianKernels kGaussianKernels;
}

}  // namespace redrive::kernels
