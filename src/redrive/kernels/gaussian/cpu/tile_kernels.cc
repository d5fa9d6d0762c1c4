// SPDX-License-Identifier: Apache-2.0
// Tiles: which blocks of pixels a Gaussian reaches, blending front to back, and its adjoint.
// Compiled once per instruction set: REDRIVE_ISA names the namespace.
#include "redrive/kernels/gaussian/cpu/tile_kernels.h"

#include "redrive/field/gaussian.h"
#include "redrive/kernels/cpu/simd/lane_math.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

constexpr int kBlocksAcross = kTilePixels / kBlockColumns;
constexpr float kNothing = -80;  ///< log distance where there is nothing

/// Pairs of a tile copied together, and the list of each block.
struct Gathered {
  float* records;
  float* sums;
  std::uint32_t* lists[kBlocksPerTile];
  std::uint32_t counts[kBlocksPerTile];
};

REDRIVE_INLINE void gather(const TileJob& job, bool sums, Gathered* out) {
  out->records = job.scratch;
  out->sums = job.scratch + kRecordFloats * job.n;
  std::uint32_t* list = reinterpret_cast<std::uint32_t*>(job.scratch + 2 * kRecordFloats * job.n);
  for (int b = 0; b < kBlocksPerTile; ++b) {
    out->lists[b] = list;
    out->counts[b] = 0;
    list += job.n;
  }
  for (std::size_t i = 0; i < job.n; ++i) {
    const TilePair& pair = job.pairs[i];
    if (i + 8 < job.n) __builtin_prefetch(&job.records[job.pairs[i + 8].gaussian]);
    const float* const record = reinterpret_cast<const float*>(&job.records[pair.gaussian]);
    for (int k = 0; k < kRecordFloats; k += kLanes) {
      store(out->records + kRecordFloats * i + k, load(record + k));
      if (sums) store(out->sums + kRecordFloats * i + k, Vf{});
    }
    for (std::uint32_t left = pair.blocks; left != 0; left &= left - 1) {
      const int b = __builtin_ctz(left);
      out->lists[b][out->counts[b]++] = static_cast<std::uint32_t>(i);
    }
  }
}

/// Columns and rows of the pixels of a block, within it.
struct BlockPixels {
  Vf x, y;
};
REDRIVE_INLINE BlockPixels block_pixels() {
  BlockPixels p{};
  for (int i = 0; i < kLanes; ++i) {
    p.x[i] = static_cast<float>(i % kBlockColumns);
    p.y[i] = static_cast<float>(i / kBlockColumns);
  }
  return p;
}

REDRIVE_INLINE Vf load_block(const float* p, std::size_t stride) {
  Vf v;
  for (int row = 0; row < kBlockRows; ++row)
    std::memcpy(reinterpret_cast<float*>(&v) + row * kBlockColumns, p + row * stride,
                kBlockColumns * sizeof(float));
  return v;
}
REDRIVE_INLINE void store_block(float* p, std::size_t stride, Vf v) {
  for (int row = 0; row < kBlockRows; ++row)
    std::memcpy(p + row * stride, reinterpret_cast<const float*>(&v) + row * kBlockColumns,
                kBlockColumns * sizeof(float));
}

REDRIVE_INLINE void centres_of(const TileJob& job, const BlockPixels& pixels, int x, int y, Vf* u,
                               Vf* v) {
  *u = pixels.x + splat(static_cast<float>(x));
  *v = pixels.y + splat(static_cast<float>(y));
  if (!job.u) return;
  const std::size_t at = static_cast<std::size_t>(y) * job.stride + static_cast<std::size_t>(x);
  *u = load_block(job.u + at, job.stride);
  *v = load_block(job.v + at, job.stride);
}

/// Offsets of a block's pixels from a mean, and log2 of the alpha there.
struct Falloff {
  Vf dx, dy, log2_alpha;
};
REDRIVE_INLINE Falloff falloff(const float* record, Vf x, Vf y) {
  Falloff f;
  f.dx = x - splat(record[0]);
  f.dy = y - splat(record[1]);
  const Vf along = splat(record[2]) * f.dx + splat(record[3]) * f.dy;
  f.log2_alpha = along * f.dx + (splat(record[4]) * f.dy * f.dy + splat(record[5]));
  return f;
}
/// Logarithm of the distance at a block's pixels.
REDRIVE_INLINE Vf log_distance(const float* record, const Falloff& f) {
  const Vf off = splat(record[9]) * f.dx + splat(record[15]) * f.dy, most = splat(kMaxLogDistance);
  return splat(record[10]) + minimum(maximum(off, -most), most);
}

template <bool kDepth, bool kRange>
REDRIVE_INLINE void forward(const TileForwardJob& job) {
  Gathered tile;
  gather(job, false, &tile);
  const BlockPixels pixels = block_pixels();
  const Vf least = splat(-kLog2InverseMinAlpha), most = splat(kMaxAlpha),
           opaque = splat(kMinTransmittance);
  for (int b = 0; b < kBlocksPerTile; ++b) {
    const int x = job.tile_x * kTilePixels + b % kBlocksAcross * kBlockColumns,
              y = job.tile_y * kTilePixels + b / kBlocksAcross * kBlockRows;
    const std::size_t at = static_cast<std::size_t>(y) * job.stride + static_cast<std::size_t>(x);
    Vf px, py;
    centres_of(job, pixels, x, y, &px, &py);
    Vf t = splat(1.0f), rgb[3] = {}, median = splat(kNothing), error{}, log_range{};
    if constexpr (kRange) log_range = load_block(job.log_range + at, job.stride);
    const std::uint32_t *const list = tile.lists[b], n = tile.counts[b];
    for (std::uint32_t i = 0; i < n; ++i) {
      const float* const record = tile.records + std::size_t{kRecordFloats} * list[i];
      const Falloff f = falloff(record, px, py);
      const Vf alpha = minimum(power_of_two(maximum(f.log2_alpha, splat(-20.0f))), most);
      const Vf w = kept(greater(f.log2_alpha, least), alpha * t);
      for (int k = 0; k < 3; ++k) rgb[k] += w * splat(record[6 + k]);
      if constexpr (kDepth || kRange) {
        const Vf here = log_distance(record, f);
        if constexpr (kDepth) median = ((w > Vf{}) & (t > splat(0.5f))) ? here : median;
        if constexpr (kRange)
          error += w * minimum(magnitude_of(here - log_range), splat(kMaxRangeError));
      }
      t -= w;
      if ((i & 3) == 3 && !any(greater(t, opaque))) break;
    }
    for (int k = 0; k < 3; ++k)
      store_block(job.rgb + k * job.plane + at, job.stride, rgb[k] + t * splat(job.background[k]));
    store_block(job.transmittance + at, job.stride, t);
    if constexpr (kDepth)
      store_block(job.depth + at, job.stride,
                  median > splat(kNothing) ? power_of_two(median * splat(1.44269504f)) : Vf{});
    if constexpr (kRange)
      store_block(job.range_error + at, job.stride, error + t * splat(kMaxRangeError));
  }
}

/// Front to back once more. With S the part of d_rgb . rgb behind a Gaussian, the derivative by its
/// alpha is t d_rgb . c - S / (1 - alpha).
template <bool kRange>
REDRIVE_INLINE void backward(const TileBackwardJob& job) {
  Gathered tile;
  gather(job, true, &tile);
  const BlockPixels pixels = block_pixels();
  const Vf least = splat(-kLog2InverseMinAlpha), most = splat(kMaxAlpha), one = splat(1.0f),
           opaque = splat(kMinTransmittance);
  for (int b = 0; b < kBlocksPerTile; ++b) {
    const std::uint32_t *const list = tile.lists[b], n = tile.counts[b];
    if (n == 0) continue;
    const int x = job.tile_x * kTilePixels + b % kBlocksAcross * kBlockColumns,
              y = job.tile_y * kTilePixels + b / kBlocksAcross * kBlockRows;
    const std::size_t at = static_cast<std::size_t>(y) * job.stride + static_cast<std::size_t>(x);
    Vf px, py;
    centres_of(job, pixels, x, y, &px, &py);
    const Vf through = load_block(job.transmittance + at, job.stride);
    Vf t = one, d_rgb[3], log_range{}, d_range{},
       behind = kept(greater(through, opaque),
                     through * load_block(job.d_transmittance + at, job.stride));
    for (int k = 0; k < 3; ++k) {
      d_rgb[k] = load_block(job.d_rgb + k * job.plane + at, job.stride);
      behind += d_rgb[k] * load_block(job.rgb + k * job.plane + at, job.stride);
    }
    const Vf pixel_error = load_block(job.error + at, job.stride);
    if constexpr (kRange) {
      log_range = load_block(job.log_range + at, job.stride);
      d_range = load_block(job.d_range + at, job.stride);
      behind += d_range * load_block(job.range_error + at, job.stride);
    }
    for (std::uint32_t i = 0; i < n; ++i) {
      const float* const record = tile.records + std::size_t{kRecordFloats} * list[i];
      const Falloff f = falloff(record, px, py);
      const LaneMask blended = greater(f.log2_alpha, least);
      if (any(blended)) {
        const Vf full = power_of_two(maximum(f.log2_alpha, splat(-20.0f))),
                 alpha = minimum(full, most), w = kept(blended, alpha * t);
        Vf d_w =
            d_rgb[0] * splat(record[6]) + d_rgb[1] * splat(record[7]) + d_rgb[2] * splat(record[8]);
        Vf sum[kPairSums];
        if constexpr (kRange) {
          const Vf off = log_distance(record, f) - log_range, size = magnitude_of(off);
          d_w += d_range * minimum(size, splat(kMaxRangeError));
          const Vf slope = kept(greater(splat(kMaxRangeError), size), w * d_range);
          sum[kSumLogDistance] = off < Vf{} ? -slope : slope;
        }
        behind -= w * d_w;
        const Vf d_alpha = t * d_w - behind / (one - alpha);
        const Vf by_log = kept(blended, kept(greater(most, full), d_alpha * alpha));
        sum[kSumAlpha] = by_log;
        sum[kSumX] = by_log * f.dx;
        sum[kSumY] = by_log * f.dy;
        sum[kSumXX] = sum[kSumX] * f.dx;
        sum[kSumXY] = sum[kSumX] * f.dy;
        sum[kSumYY] = sum[kSumY] * f.dy;
        for (int k = 0; k < 3; ++k) sum[kSumRgb + k] = w * d_rgb[k];
        sum[kSumError] = w * pixel_error;
        float* const sums = tile.sums + std::size_t{kRecordFloats} * list[i];
        constexpr int kSums = kRange ? kPairSums : kSumLogDistance;
        if constexpr (kSums <= kLanes) {
          store(sums, load(sums) + sums_of<kSums>(sum));
        } else {
          store(sums, load(sums) + sums_of<kLanes>(sum));
          store(sums + kLanes, load(sums + kLanes) + sums_of<kSums - kLanes>(sum + kLanes));
        }
        t -= w;
      }
      if ((i & 3) == 3 && !any(greater(t, opaque))) break;
    }
  }
  for (std::size_t i = 0; i < job.n; ++i)
    for (int k = 0; k < kRecordFloats; k += kLanes)
      store(job.sums + std::size_t{job.pairs[i].slot} * kRecordFloats + k,
            load(tile.sums + kRecordFloats * i + k));
}

/// Sets job.found to the parts of the tile's Gaussians, and job.place to the index there of each
/// Gaussian's. Returns their number; 0: only the world.
REDRIVE_INLINE std::uint32_t find_parts(const TilePartsJob& job) {
  const std::uint32_t* const first = job.first_gaussian;
  job.found[0] = {0, {}};
  std::uint32_t n = 1;
  for (std::size_t i = 0; i < job.n; ++i) {
    const std::uint32_t gaussian = job.pairs[i].gaussian;
    std::uint32_t low = 0, high = job.n_parts;  // number of parts that begin at or before it
    while (low < high) {
      const std::uint32_t middle = (low + high) / 2;
      if (first[middle] <= gaussian)
        low = middle + 1;
      else
        high = middle;
    }
    std::uint32_t at = 0;
    while (at < n && job.found[at].part != low) ++at;
    if (at == n) job.found[n++] = {low, {}};
    job.place[i] = at;
  }
  return n > 1 ? n : 0;
}

REDRIVE_INLINE void add_pixel(int x, int y, PartExtent* extent) {
  ++extent->whole;
  extent->left = x < extent->left ? x : extent->left;
  extent->right = x > extent->right ? x : extent->right;
  extent->top = y < extent->top ? y : extent->top;
  extent->bottom = y > extent->bottom ? y : extent->bottom;
}

/// Adds a block of pixels to the extents. `visible`: the index in job.found that each shows;
/// `clear`: transmittance of each part alone.
REDRIVE_INLINE void add_block(const TilePartsJob& job, int x, int y, Vi visible, const float* clear,
                              std::uint32_t n) {
  for (int i = 0; i < kLanes; ++i) {
    const int px = x + i % kBlockColumns, py = y + i / kBlockColumns;
    const std::uint32_t at = static_cast<std::uint32_t>(visible[i]);
    job.parts[static_cast<std::size_t>(py) * job.stride + static_cast<std::size_t>(px)] =
        static_cast<std::uint16_t>(job.found[at].part);
    if (px >= job.width || py >= job.height) continue;
    ++job.found[at].extent.visible;
    for (std::uint32_t k = 1; k < n; ++k)
      if (clear[std::size_t{kLanes} * k + static_cast<std::size_t>(i)] < 0.5f)
        add_pixel(px, py, &job.found[k].extent);
  }
}

/// kCentres: whether the grid has boxes.
template <bool kCentres>
REDRIVE_INLINE std::size_t bin(RasterRecord* records, const std::uint64_t* keys, std::size_t n,
                               const TileGrid& grid, const std::uint8_t* wanted, TilePair* pairs) {
  constexpr int kVectors = kBlocksPerTile / kLanes;  // vectors of blocks in a tile
  Vf left[kVectors], top[kVectors];
  for (int v = 0; v < kVectors; ++v)
    for (int i = 0; i < kLanes; ++i) {
      const int b = v * kLanes + i;
      left[v][i] = static_cast<float>(b % kBlocksAcross * kBlockColumns);
      top[v][i] = static_cast<float>(b / kBlocksAcross * kBlockRows);
    }
  const Vf zero{}, across = splat(kBlockColumns - 1), down = splat(kBlockRows - 1);
  std::size_t made = 0;
  for (std::size_t i = 0; i < n; ++i) {
    if (i + 12 < n) __builtin_prefetch(&records[static_cast<std::uint32_t>(keys[i + 12])]);
    const std::uint32_t id = static_cast<std::uint32_t>(keys[i]);
    RasterRecord& r = records[id];
    const TileRange range = tiles_of(r, grid);
    const Vf xx = splat(r.xx), xy = splat(r.xy), yy = splat(r.yy), peak = splat(r.log2_alpha),
             least = splat(-kLog2InverseMinAlpha), best_x = splat(-0.5f * r.xy / r.xx),
             best_y = splat(-0.5f * r.xy / r.yy);
    const std::size_t before = made;
    for (int ty = range.y0; ty <= range.y1; ++ty)
      for (int tx = range.x0; tx <= range.x1; ++tx) {
        const std::uint32_t tile = static_cast<std::uint32_t>(ty * grid.tiles_x + tx);
        if (wanted && !wanted[tile]) continue;
        std::uint32_t blocks = 0;
        for (int v = 0; v < kVectors; ++v) {
          Vf x0, x1, y0, y1;
          if constexpr (kCentres) {
            const float* const box =
                grid.boxes + std::size_t{4} * kBlocksPerTile * tile + v * kLanes;
            x0 = load(box) - splat(r.x);
            x1 = load(box + kBlocksPerTile) - splat(r.x);
            y0 = load(box + 2 * kBlocksPerTile) - splat(r.y);
            y1 = load(box + 3 * kBlocksPerTile) - splat(r.y);
          } else {
            x0 = left[v] + splat(static_cast<float>(tx * kTilePixels) - r.x);
            x1 = x0 + across;
            y0 = top[v] + splat(static_cast<float>(ty * kTilePixels) - r.y);
            y1 = y0 + down;
          }
          // The falloff is greatest on the sides nearest to the mean.
          const Vf side_x = minimum(maximum(zero, x0), x1), side_y = minimum(maximum(zero, y0), y1);
          const Vf y = minimum(maximum(best_y * side_x, y0), y1),
                   x = minimum(maximum(best_x * side_y, x0), x1);
          const Vf highest = maximum((xx * side_x + xy * y) * side_x + yy * y * y,
                                     (xx * x + xy * side_y) * x + yy * side_y * side_y);
          blocks |= lane_bits(highest + peak > least) << (v * kLanes);
        }
        if (blocks != 0) pairs[made++] = {id, tile, blocks, 0};
      }
    r.pairs = static_cast<std::uint32_t>(made - before);
  }
  return made;
}

}  // namespace

std::size_t bin(RasterRecord* records, const std::uint64_t* keys, std::size_t n,
                const TileGrid& grid, const std::uint8_t* wanted, TilePair* pairs) {
  return grid.boxes ? bin<true>(records, keys, n, grid, wanted, pairs)
                    : bin<false>(records, keys, n, grid, wanted, pairs);
}

void tile_forward(const TileForwardJob& job) {
  if (job.depth) return job.log_range ? forward<true, true>(job) : forward<true, false>(job);
  return job.log_range ? forward<false, true>(job) : forward<false, false>(job);
}

std::uint32_t tile_parts(const TilePartsJob& job) {
  const std::uint32_t parts = find_parts(job);
  if (parts == 0) {
    for (int y = 0; y < kTilePixels; ++y)
      std::memset(job.parts + static_cast<std::size_t>(job.tile_y * kTilePixels + y) * job.stride +
                      static_cast<std::size_t>(job.tile_x * kTilePixels),
                  0, kTilePixels * sizeof(std::uint16_t));
    return 0;
  }
  Gathered tile;
  gather(job, false, &tile);
  const BlockPixels pixels = block_pixels();
  const Vf least = splat(-kLog2InverseMinAlpha), most = splat(kMaxAlpha),
           opaque = splat(kMinTransmittance);
  float *const visible = job.sums, *const clear = job.sums + std::size_t{kLanes} * parts;
  for (int b = 0; b < kBlocksPerTile; ++b) {
    const int x = job.tile_x * kTilePixels + b % kBlocksAcross * kBlockColumns,
              y = job.tile_y * kTilePixels + b / kBlocksAcross * kBlockRows;
    Vf px, py;
    centres_of(job, pixels, x, y, &px, &py);
    for (std::uint32_t k = 0; k < parts; ++k) {
      store(visible + std::size_t{kLanes} * k, Vf{});
      store(clear + std::size_t{kLanes} * k, splat(1.0f));
    }
    Vf t = splat(1.0f);
    bool through = true;
    const std::uint32_t *const list = tile.lists[b], n = tile.counts[b];
    for (std::uint32_t i = 0; i < n; ++i) {
      const std::size_t at = std::size_t{kLanes} * job.place[list[i]];
      if (!through && at == 0) continue;  // moving parts are followed behind what hides them
      const Falloff f = falloff(tile.records + std::size_t{kRecordFloats} * list[i], px, py);
      const Vf alpha = kept(greater(f.log2_alpha, least),
                            minimum(power_of_two(maximum(f.log2_alpha, splat(-20.0f))), most));
      const Vf w = alpha * t, alone = load(clear + at);
      store(visible + at, load(visible + at) + w);
      store(clear + at, alone - alone * alpha);
      t -= w;
      if ((i & 3) == 3) through = any(greater(t, opaque));
    }
    Vf largest = load(visible) + t;
    Vi shown{};
    for (std::uint32_t k = 1; k < parts; ++k) {
      const Vf sum = load(visible + std::size_t{kLanes} * k);
      const Vi larger = sum > largest;
      shown = larger ? splat_int(static_cast<std::int32_t>(k)) : shown;
      largest = larger ? sum : largest;
    }
    add_block(job, x, y, shown, clear, parts);
  }
  return parts;
}

void tile_backward(const TileBackwardJob& job) {
  return job.log_range ? backward<true>(job) : backward<false>(job);
}

}  // namespace redrive::kernels::REDRIVE_ISA
