// SPDX-License-Identifier: Apache-2.0
// A range's results go to a place of its own, so that the number of threads changes no bit.
#include "redrive/kernels/gaussian/cpu/cpu_raster.h"

#include <algorithm>
#include <array>
#include <limits>
#include <mutex>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/centre_boxes.h"
#include "redrive/kernels/gaussian/check_gaussian_sizes.h"
#include "redrive/kernels/gaussian/mean_bounds.h"
#include "redrive/kernels/gaussian/shutter_keys.h"

namespace redrive::kernels {
namespace {

constexpr std::size_t kPairRanges = 16;  // number of ranges into which visible Gaussians are cut
constexpr std::size_t kTilesPerRange = 4;
constexpr int kKeyBits = 11;  // bits that a pass of the radix sort handles
// The lowest bits of a key's distance, which do not take part in sorting, hold the number of tiles
// that the Gaussian may meet, kManyTiles for that many and more.
constexpr int kTileBits = 9, kTileShift = 32;
constexpr std::uint64_t kManyTiles = (1 << kTileBits) - 1;
constexpr std::size_t kPrefetched = 12;  // records ahead
/// The maximum number of pairs: TilePair and RasterRecord count them in 32 bits.
constexpr std::size_t kMostPairs = std::numeric_limits<std::uint32_t>::max();
constexpr std::size_t kBuckets = std::size_t{1} << kKeyBits;

/// Sorts keys by their upper half, ascending and stable, by the bits in which positive floats
/// differ down to 2^-14 of their value.
void sort_by_distance(std::uint64_t* keys, std::uint64_t* memory, std::size_t n) {
  for (const int shift : {kTileShift + kTileBits, kTileShift + kTileBits + kKeyBits}) {
    std::array<std::uint32_t, kBuckets> next{};
    for (std::size_t i = 0; i < n; ++i) ++next[keys[i] >> shift & (kBuckets - 1)];
    std::uint32_t before = 0;
    for (std::uint32_t& count : next) before += std::exchange(count, before);
    for (std::size_t i = 0; i < n; ++i) memory[next[keys[i] >> shift & (kBuckets - 1)]++] = keys[i];
    std::swap(keys, memory);  // after both passes they are back in place
  }
}

std::uint64_t count_tiles(const RasterRecord& record, const TileGrid& grid) {
  const TileRange t = tiles_of(record, grid);
  return static_cast<std::uint64_t>(std::max(t.x1 - t.x0 + 1, 0)) *
         static_cast<std::uint64_t>(std::max(t.y1 - t.y0 + 1, 0));
}

TileAxis tile_axis(const float* low, const float* high, int tiles) {
  const float first = low[0], length = high[tiles - 1] - first;
  return {low, high, first, static_cast<float>(tiles) / std::max(length, 1e-6f)};
}

}  // namespace

Segment make_segment(const GaussianCamera& camera, std::span<const PlainPose> poses,
                     std::size_t begin, std::size_t end) {
  Segment segment{.begin = begin, .end = end, .shutter = {}, .keys = {}};
  segment.keys = shutter_keys(poses);
  ShutterKeys& shutter = segment.shutter;
  shutter.n = static_cast<int>(poses.size());
  shutter.keys = segment.keys.data();
  for (int k = 0; k < 9 && !poses.empty(); ++k)
    shutter.rotation[k] = static_cast<float>(poses[0].rotation[3 * (k % 3) + k / 3]);
  shutter.by_column = camera.by_column;
  shutter.first = first_line(camera);
  shutter.row_scale = static_cast<float>(shutter.n - 1) / camera.image_rows;
  shutter.row_offset = (camera.first_row + 0.5f) * shutter.row_scale;
  return segment;
}

float* tile_memory(std::size_t floats) {
  thread_local Buffer<float> memory;
  return grown(&memory, floats, floats / 2);
}

UpdateJob update_job(const GaussianUpdate& update) {
  return {.rates = update.rates,
          .beta1 = update.step.beta1,
          .beta2 = update.step.beta2,
          .bias1 = update.step.bias1,
          .bias2 = update.step.bias2,
          .epsilon = update.step.epsilon,
          .min_log_scale = update.min_log_scale,
          .max_log_scale = update.max_log_scale,
          .numbers = update.numbers.data(),
          .moments = update.moments.data(),
          .errors = update.errors.data(),
          .bounded_colours = update.bounded_colours,
          .rows = update.rows};
}

template <class Body>
void CpuRaster::for_segments(std::size_t begin, std::size_t end, const Body& body) const {
  for (std::size_t s = 0; s < segments_.size(); ++s) {
    const std::size_t first = std::max(begin, segments_[s].begin),
                      last = std::min(end, segments_[s].end);
    if (first < last) body(s, first, last);
  }
}

template <class Job, class Body>
void CpuRaster::for_tiles(const Body& body) const {
  const RasterSize& size = image_.size;
  const int tiles_x = size.stride / kTileSide;
  const std::size_t tiles = first_.size() - 1;
  pool_.run_ranges(tiles, kTilesPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t tile = begin; tile < end; ++tile) {
      if (!options_.tiles.empty() && !options_.tiles[tile]) continue;
      Job job;
      job.tile_x = static_cast<int>(tile) % tiles_x;
      job.tile_y = static_cast<int>(tile) / tiles_x;
      job.records = records_.data();
      job.pairs = pairs_.data() + first_[tile];
      job.n = first_[tile + 1] - first_[tile];
      job.stride = size.stride;
      job.plane = size.plane();
      job.log_range = options_.log_range.empty() ? nullptr : options_.log_range.data();
      if (!camera_.centres.u.empty()) {
        job.u = camera_.centres.u.data();
        job.v = camera_.centres.v.data();
      }
      job.scratch = tile_memory(tile_scratch(job.n));
      body(&job);
    }
  });
}

void CpuRaster::forward(const GaussianCamera& camera, const Gaussians& gaussians,
                        const RasterOptions& options) {
  check_rasterise(camera, gaussians, options);
  camera_ = camera;
  gaussians_ = gaussians;
  options_ = options;
  const RasterSize size = image_.size = raster_size(camera.camera.width, camera.camera.height);
  set_grid();
  project();
  sort_by_distance(keys_.data(), scratch_of<std::uint64_t>(n_visible_), n_visible_);
  bin();
  grown(&image_.rgb, 3 * size.plane());
  grown(&image_.transmittance, size.plane());
  if (options.depth) grown(&image_.depth, size.plane());
  if (!options.log_range.empty()) grown(&image_.range_error, size.plane());
  for_tiles<TileForwardJob>([&](TileForwardJob* job) {
    job->rgb = image_.rgb.data();
    job->transmittance = image_.transmittance.data();
    job->depth = options.depth ? image_.depth.data() : nullptr;
    job->range_error = image_.range_error.data();
    std::ranges::copy(options.background, job->background);
    kernels_.tile_forward(*job);
  });
  if (options.parts) find_parts();
  counts_ = {n_visible_, first_.back()};
}

void CpuRaster::find_parts() {
  const RasterSize& size = image_.size;
  const std::size_t n_parts = objects_of(camera_.parts);
  grown(&image_.parts, size.plane());
  image_.extents.assign(n_parts, {});
  std::vector<std::uint32_t> first;
  for (const GaussianPart& part : camera_.parts)
    if (!part.continues)
      first.push_back(static_cast<std::uint32_t>(part.first_block * kGaussianBlock));
  std::mutex adding;  // counts and bounds are the same in any order
  for_tiles<TilePartsJob>([&](TilePartsJob* job) {
    constexpr std::size_t kVectorFloats = 16;  // the widest instruction set's
    const std::size_t most = 1 + std::min(job->n, n_parts), plain = tile_scratch(job->n);
    job->scratch = tile_memory(plain + 2 * kVectorFloats * most + job->n +
                               most * sizeof(TilePart) / sizeof(float));
    job->sums = job->scratch + plain;
    job->place = reinterpret_cast<std::uint32_t*>(job->sums + 2 * kVectorFloats * most);
    job->found = reinterpret_cast<TilePart*>(job->place + job->n);
    job->width = size.width;
    job->height = size.height;
    job->first_gaussian = first.data();
    job->n_parts = static_cast<std::uint32_t>(n_parts);
    job->parts = image_.parts.data();
    const std::uint32_t found = kernels_.tile_parts(*job);
    if (found == 0) return;
    const std::lock_guard lock(adding);
    for (std::uint32_t k = 1; k < found; ++k) {
      const PartExtent& here = job->found[k].extent;
      PartExtent& all = image_.extents[job->found[k].part - 1];
      all.visible += here.visible;
      all.whole += here.whole;
      all.left = std::min(all.left, here.left);
      all.right = std::max(all.right, here.right);
      all.top = std::min(all.top, here.top);
      all.bottom = std::max(all.bottom, here.bottom);
    }
  });
}

void CpuRaster::backward(const RasterGradient& gradient, const GaussianDerivatives& to,
                         std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) {
  check_rasterise_backward(camera_, gaussians_, options_, gradient, to, d_poses.size());
  float* const sums = scratch_of<float>(first_.back() * std::size_t{kRecordFloats});
  for_tiles<TileBackwardJob>([&](TileBackwardJob* job) {
    job->rgb = image_.rgb.data();
    job->transmittance = image_.transmittance.data();
    job->range_error = image_.range_error.data();
    job->d_rgb = gradient.d_rgb.data();
    job->error = gradient.error.data();
    job->d_transmittance = gradient.d_transmittance.data();
    job->d_range = gradient.d_range.data();
    job->sums = sums;
    kernels_.tile_backward(*job);
  });
  ProjectionBackwardJob job;
  job.camera = camera_.camera;
  job.gaussians = gaussians_.numbers.data();
  job.records = records_.data();
  job.visible = visible_.data();
  job.sums = sums;
  job.gradients = to.gradients.data();
  job.errors = to.errors.data();
  const UpdateJob update = to.update ? update_job(*to.update) : UpdateJob();
  if (to.update) job.update = &update;
  const std::size_t blocks = gaussian_blocks(gaussians_.n);
  using PoseSums = std::array<double, 6>;
  std::vector<std::vector<PoseSums>> sums_of_range(blocks / kBlocksPerRange + 1);
  pool_.run_ranges(blocks, kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
    std::vector<PoseSums>& of_segment = sums_of_range[begin / kBlocksPerRange];
    of_segment.resize(d_poses.size());
    for_segments(begin, end, [&](std::size_t s, std::size_t first, std::size_t last) {
      if (segments_[s].shutter.n == 0) return;
      ProjectionBackwardJob part = job;
      part.shutter = segments_[s].shutter;
      if (!d_poses.empty()) part.d_pose = of_segment[s].data();
      kernels_.project_backward(part, first, last);
    });
  });
  std::ranges::fill(d_poses, GaussianPoseGradient<NumberMath<double>>{});
  for (const std::vector<PoseSums>& of_segment : sums_of_range)
    for (std::size_t s = 0; s < of_segment.size(); ++s)
      for (int k = 0; k < 3; ++k) {
        d_poses[s].translation[k] += of_segment[s][k];
        d_poses[s].rotation[k] += of_segment[s][3 + k];
      }
}

void CpuRaster::set_grid() {
  const RasterSize& size = image_.size;
  const int tiles_x = size.stride / kTileSide, tiles_y = size.rows / kTileSide;
  grid_ = {};
  grid_.tiles_x = tiles_x;
  grid_.tiles_y = tiles_y;
  const PixelCentres& centres = camera_.centres;
  if (centres.u.empty()) return;
  const BlockShape shape{kBlockColumns, kernels_.block_rows};
  const std::size_t tiles = static_cast<std::size_t>(tiles_x) * tiles_y;
  float* const boxes = grown(&boxes_, tiles * 4 * shape.blocks());
  extents_.resize(2 * (tiles_x + tiles_y));
  find_boxes(size, centres, shape, pool_, boxes, extents_);
  const float *const low_u = extents_.data(), *const high_u = low_u + tiles_x,
                     *const low_v = high_u + tiles_x, *const high_v = low_v + tiles_y;
  grid_.boxes = boxes;
  grid_.along_u = tile_axis(low_u, high_u, tiles_x);
  grid_.along_v = tile_axis(low_v, high_v, tiles_y);
}

void CpuRaster::set_segments() {
  const GaussianCamera& camera = camera_;
  const std::size_t blocks = gaussian_blocks(gaussians_.n);
  segments_.clear();
  segments_.reserve(1 + camera.parts.size());
  const auto begin_of = [&](std::size_t part) {
    return part < camera.parts.size() ? camera.parts[part].first_block : blocks;
  };
  segments_.push_back(make_segment(camera, camera.world_from_camera, 0, begin_of(0)));
  for (std::size_t part = 0; part < camera.parts.size(); ++part)
    segments_.push_back(make_segment(camera, camera.parts[part].part_from_camera, begin_of(part),
                                     begin_of(part + 1)));
}

void CpuRaster::project() {
  const std::size_t blocks = gaussian_blocks(gaussians_.n);
  REDRIVE_CHECK_OP(blocks * kGaussianBlock, <=, kMostPairs);
  grown(&records_, blocks * kGaussianBlock);
  grown(&visible_, blocks);
  grown(&keys_, blocks * kGaussianBlock);
  const RasterBounds bounds = raster_bounds(camera_);
  set_segments();
  ProjectionJob job;
  job.camera = camera_.camera;
  job.gaussians = gaussians_.numbers.data();
  const auto plain = [](const RasterBounds& b) { return Bounds{b.left, b.right, b.top, b.bottom}; };
  job.pixels = plain(bounds);
  job.bounds_means = !camera_.centres.u.empty();
  job.means = plain(mean_bounds(camera_, bounds));
  std::vector<std::size_t> drawn(blocks / kBlocksPerRange + 1);
  pool_.run_ranges(blocks, kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
    std::size_t& n = drawn[begin / kBlocksPerRange];
    for_segments(begin, end, [&](std::size_t s, std::size_t first, std::size_t last) {
      ProjectionJob part = job;
      part.shutter = segments_[s].shutter;
      if (part.shutter.n == 0)
        std::fill(visible_.data() + first, visible_.data() + last, std::uint16_t{0});
      else
        n += kernels_.project(part, first, last, records_.data(), visible_.data(),
                              keys_.data() + begin * kGaussianBlock + n);
    });
    // While the records are in the cache.
    for (std::uint64_t& key : std::span(keys_.data() + begin * kGaussianBlock, n)) {
      const std::uint64_t tiles = count_tiles(records_[static_cast<std::uint32_t>(key)], grid_);
      key = (key & ~(kManyTiles << kTileShift)) | std::min(tiles, kManyTiles) << kTileShift;
    }
  });
  n_visible_ = 0;
  for (std::size_t range = 0; range < drawn.size(); ++range) {
    const std::uint64_t* const from = keys_.data() + range * kBlocksPerRange * kGaussianBlock;
    std::copy(from, from + drawn[range], keys_.data() + n_visible_);
    n_visible_ += drawn[range];
  }
}

void CpuRaster::bin() {
  const std::size_t tiles = static_cast<std::size_t>(grid_.tiles_x) * grid_.tiles_y, n = n_visible_;
  struct Range {
    std::size_t begin, end, place, made = 0;
    std::uint32_t slot = 0;
    std::vector<std::uint32_t> next;  ///< one per tile: counts, then places
  };
  std::vector<Range> ranges(kPairRanges);
  pool_.run(static_cast<int>(kPairRanges), [&](int r) {  // upper bounds of the pairs
    Range& range = ranges[r];
    range.begin = n * r / kPairRanges;
    range.end = n * (r + 1) / kPairRanges;
    range.place = 0;
    for (std::size_t i = range.begin; i < range.end; ++i) {
      const std::uint64_t tiles = keys_[i] >> kTileShift & kManyTiles;
      range.place += tiles < kManyTiles
                         ? tiles
                         : count_tiles(records_[static_cast<std::uint32_t>(keys_[i])], grid_);
    }
  });
  std::size_t most = 0;
  for (Range& range : ranges) most += std::exchange(range.place, most);
  REDRIVE_CHECK_OP(most, <=, kMostPairs);
  TilePair* const unordered = scratch_of<TilePair>(most);
  pool_.run(static_cast<int>(kPairRanges), [&](int r) {
    Range& range = ranges[r];
    TilePair* const pairs = unordered + range.place;
    range.made =
        kernels_.bin(records_.data(), keys_.data() + range.begin, range.end - range.begin, grid_,
                     options_.tiles.empty() ? nullptr : options_.tiles.data(), pairs);
    range.next.assign(tiles, 0);
    for (std::size_t i = 0; i < range.made; ++i) ++range.next[pairs[i].tile];
  });
  first_.resize(tiles + 1);
  std::uint32_t before = 0;
  for (std::size_t tile = 0; tile < tiles; ++tile) {
    first_[tile] = before;
    for (Range& range : ranges) before += std::exchange(range.next[tile], before);
  }
  first_[tiles] = before;
  std::uint32_t slot = 0;
  for (Range& range : ranges) {
    range.slot = slot;
    slot += static_cast<std::uint32_t>(range.made);
  }
  grown(&pairs_, before, before / 16);
  pool_.run(static_cast<int>(kPairRanges), [&](int r) {
    Range& range = ranges[r];
    std::uint32_t next_slot = range.slot;
    for (std::size_t i = range.begin; i < range.end; ++i) {
      if (i + kPrefetched < range.end)
        __builtin_prefetch(&records_[static_cast<std::uint32_t>(keys_[i + kPrefetched])], 1);
      RasterRecord& record = records_[static_cast<std::uint32_t>(keys_[i])];
      record.first_pair = next_slot;
      next_slot += record.pairs;
    }
    const TilePair* const made = unordered + range.place;
    for (std::size_t i = 0; i < range.made; ++i) {
      TilePair pair = made[i];
      pair.slot = range.slot + static_cast<std::uint32_t>(i);
      pairs_[range.next[pair.tile]++] = pair;
    }
  });
}

}  // namespace redrive::kernels
