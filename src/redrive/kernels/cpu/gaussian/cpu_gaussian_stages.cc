// SPDX-License-Identifier: Apache-2.0
// Cuts images and Gaussians into ranges for an instruction set's kernels. A range's results go to
// a place of its own, so that the number of threads changes no bit.
#include "redrive/kernels/cpu/gaussian/cpu_gaussian_stages.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <utility>
#include <vector>

#include "redrive/kernels/check_gaussian_sizes.h"
#include "redrive/kernels/cpu/gaussian/gaussian_kernels.h"
#include "redrive/kernels/target_window.h"
#include "redrive/optim/ssim.h"

namespace redrive::kernels {
namespace {

constexpr std::size_t kBlocksPerRange = 256;  // 4096 Gaussians
constexpr std::size_t kPairRanges = 16;       // visible Gaussians are cut into so many
constexpr std::size_t kTilesPerRange = 4;
constexpr int kKeyBits = 11;  // a pass of the radix sort handles so many
// The lowest bits of a key's distance, which do not sort, hold the number of tiles that the
// Gaussian may meet, kManyTiles for as many and more.
constexpr int kTileBits = 9, kTileShift = 32;
constexpr std::uint64_t kManyTiles = (1 << kTileBits) - 1;
constexpr std::size_t kPrefetched = 12;  // records ahead
/// The maximum number of pairs: TilePair and RasterRecord count them in 32 bits.
constexpr std::size_t kMostPairs = std::numeric_limits<std::uint32_t>::max();
constexpr std::size_t kBuckets = std::size_t{1} << kKeyBits;

/// Returns `buffer` with at least n numbers of any value. spare: what is allocated beyond.
template <class T>
T* grown(Buffer<T>* buffer, std::size_t n, std::size_t spare = 0) {
  if (buffer->size() < n) {
    *buffer = {};  // not both at once
    *buffer = Buffer<T>(n + spare);
  }
  return buffer->data();
}

/// Working memory of a tile, one for each thread.
float* tile_memory(std::size_t floats) {
  thread_local Buffer<float> memory;
  return grown(&memory, floats, floats / 2);
}

/// Blocks of Gaussians that are seen from the same poses.
struct Segment {
  std::size_t begin, end;   ///< blocks
  ShutterKeys shutter;      ///< n = 0: not drawn
  std::vector<float> keys;  ///< of the shutter
};

/// Results of a forward pass that its backward pass reads.
struct RasterMemory {
  Buffer<RasterRecord> records;   ///< by Gaussian
  Buffer<std::uint16_t> visible;  ///< by block
  Buffer<std::uint64_t> keys;     ///< of the visible Gaussians: distance, tiles (kTileBits), index
  Buffer<TilePair> pairs;
  /// In turn: keys between two passes of their sort, pairs in the order of their making, sums
  /// [pairs, kRecordFloats] of floats.
  Buffer<std::byte> scratch;
  std::vector<std::uint32_t> first;  ///< [tiles + 1]: first pair of each tile
  std::size_t n_visible = 0;
  std::vector<Segment> segments;

  template <class T>
  T* scratch_of(std::size_t n) {
    const std::size_t bytes = n * sizeof(T);
    return reinterpret_cast<T*>(grown(&scratch, bytes, bytes / 16));
  }
};

/// Sorts keys by their upper half, ascending and stable, by the bits that positive floats up to
/// 2^-14 of their value differ in.
void sort_by_distance(std::uint64_t* keys, std::uint64_t* memory, std::size_t n) {
  for (const int shift : {kTileShift + kTileBits, kTileShift + kTileBits + kKeyBits}) {
    std::array<std::uint32_t, kBuckets> next{};
    for (std::size_t i = 0; i < n; ++i) ++next[keys[i] >> shift & (kBuckets - 1)];
    std::uint32_t before = 0;
    for (std::uint32_t& count : next) before += std::exchange(count, before);
    for (std::size_t i = 0; i < n; ++i) memory[next[keys[i] >> shift & (kBuckets - 1)]++] = keys[i];
    std::swap(keys, memory);  // after both passes they are where they were
  }
}

class CpuGaussianStages final : public GaussianStages {
 public:
  CpuGaussianStages(Isa isa, ThreadPool* pool)
      : kernels_(isa == Isa::kAvx2 ? avx2::kGaussianKernels : avx512::kGaussianKernels),
        pool_(*pool) {
    const SsimTaps taps = ssim_taps();
    std::ranges::copy(taps, taps_.begin());
  }

  RasterCounts rasterise(const GaussianCamera& camera, const Gaussians& gaussians,
                         const RasterOptions& options, RasterImage* image) override {
    check_rasterise(camera, gaussians, options);
    RasterMemory& w = memory_;
    const RasterSize size = raster_size(camera.camera.width, camera.camera.height);
    project(camera, gaussians, size, &w);
    sort_by_distance(w.keys.data(), w.scratch_of<std::uint64_t>(w.n_visible), w.n_visible);
    bin(size, options, &w);
    image->size = size;
    grown(&image->rgb, 3 * size.plane());
    grown(&image->transmittance, size.plane());
    if (options.depth) grown(&image->depth, size.plane());
    if (!options.log_range.empty()) grown(&image->range_error, size.plane());
    for_tiles(size, options, w, [&](TileJob* job) {
      job->rgb = image->rgb.data();
      job->transmittance = image->transmittance.data();
      job->depth = options.depth ? image->depth.data() : nullptr;
      job->range_error = image->range_error.data();
      kernels_.tile_forward(*job);
    });
    return {w.n_visible, w.first.back()};
  }

  void rasterise_backward(const GaussianCamera& camera, const Gaussians& gaussians,
                          const RasterOptions& options, const RasterImage& image,
                          const RasterGradient& gradient, const GaussianDerivatives& to,
                          std::span<GaussianPoseGradient<NumberMath<double>>> d_poses) override {
    check_rasterise_backward(camera, gaussians, options, image, gradient, to, d_poses.size());
    RasterMemory& w = memory_;
    float* const sums = w.scratch_of<float>(w.first.back() * std::size_t{kRecordFloats});
    for_tiles(image.size, options, w, [&](TileJob* job) {
      job->rgb = const_cast<float*>(image.rgb.data());  // only read
      job->transmittance = const_cast<float*>(image.transmittance.data());
      job->range_error = const_cast<float*>(image.range_error.data());
      job->d_rgb = gradient.d_rgb.data();
      job->error = gradient.error.data();
      job->d_transmittance = gradient.d_transmittance.data();
      job->d_range = gradient.d_range.data();
      job->sums = sums;
      kernels_.tile_backward(*job);
    });
    ProjectionBackwardJob job;
    job.camera = camera.camera;
    job.gaussians = gaussians.numbers.data();
    job.records = w.records.data();
    job.visible = w.visible.data();
    job.sums = sums;
    job.gradients = to.gradients.data();
    const UpdateJob update = to.update ? update_job(*to.update) : UpdateJob();
    if (to.update) job.update = &update;
    const std::size_t blocks = gaussian_blocks(gaussians.n);
    using PoseSums = std::array<double, 6>;
    std::vector<std::vector<PoseSums>> sums_of_range(blocks / kBlocksPerRange + 1);
    pool_.run_ranges(blocks, kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
      std::vector<PoseSums>& of_segment = sums_of_range[begin / kBlocksPerRange];
      of_segment.resize(d_poses.size());
      for_segments(w, begin, end, [&](std::size_t s, std::size_t first, std::size_t last) {
        if (w.segments[s].shutter.n == 0) return;
        ProjectionBackwardJob part = job;
        part.shutter = w.segments[s].shutter;
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

  ImageLossOutput image_loss(const ImageLossInput& input, std::span<float> d_rgb,
                             std::span<float> error) override {
    check_image_loss(input, d_rgb.size(), error.size());
    const std::size_t plane = input.size.plane(), rows = input.size.height,
                      across = input.size.stride / kPatchSide;
    float* const target = grown(&target_, 3 * plane);
    float* const mask = grown(&mask_, plane);
    std::vector<TargetSums> targets(rows);
    ImageLossOutput out;
    out.patches.resize(plane / (kPatchSide * kPatchSide));
    pool_.run_ranges(rows, kPatchSide, [&](std::size_t begin, std::size_t end) {
      for (std::size_t y = begin; y < end; ++y)
        targets[y] = convert_target_row(input, static_cast<int>(y), target, mask,
                                        &out.patches[begin / kPatchSide * across]);
    });
    TargetSums all;
    for (const TargetSums& row : targets) all.add(row);
    const double count = 3 * all.pixels;
    LossJob job;
    job.width = input.size.width;
    job.height = input.size.height;
    job.stride = input.size.stride;
    job.plane = plane;
    job.rgb = input.rgb.data();
    job.target = target;
    job.mask = mask;
    job.gains = input.gains.data();
    job.l1_scale = static_cast<float>(input.l1_weight / std::max(count, 1.0));
    job.ssim_scale = static_cast<float>(input.ssim_weight / std::max(count, 1.0));
    job.taps = taps_.data();
    job.masked = grown(&masked_, 6 * plane);
    job.moments = grown(&moments_, 15 * plane);
    job.slopes = grown(&slopes_, 9 * plane);
    job.d_rgb = d_rgb.data();
    job.error = error.data();
    // Rows below the image have tiles, too.
    const std::size_t end = rows * input.size.stride;
    for (std::size_t c = 0; c < 3; ++c)
      std::ranges::fill(d_rgb.subspan(c * plane + end, plane - end), 0.0f);
    std::ranges::fill(error.subspan(end, plane - end), 0.0f);
    std::vector<LossSums> sums(rows);
    for (int pass = 0; pass < kLossPasses; ++pass) {
      if (input.ssim_weight == 0 && pass > 0 && pass + 1 < kLossPasses) continue;
      pool_.run_ranges(rows, kPatchSide, [&](std::size_t begin, std::size_t end) {
        float* const scratch = tile_memory(loss_scratch(job.stride));
        for (std::size_t y = begin; y < end; ++y)
          kernels_.loss_row(job, pass, static_cast<int>(y), scratch, &sums[y]);
      });
    }
    double squares = 0;
    for (const LossSums& row : sums) {
      out.l1 += row.l1;
      out.dssim += row.ssim;
      squares += row.squares;
    }
    out.mse = squares / std::max(count, 1.0);
    all.finish(&out);
    return out;
  }

  void update_gaussians(const GaussianUpdate& update, std::size_t n,
                        std::span<const float> gradients) override {
    check_update_gaussians(update, n, gradients.size());
    const UpdateJob job = update_job(update);
    pool_.run_ranges(gaussian_blocks(n), kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
      kernels_.update(job, gradients.data(), begin, end);
    });
  }
  void release() override { memory_ = {}; }

 private:
  static UpdateJob update_job(const GaussianUpdate& update) {
    return {.rates = update.rates,
            .beta1 = update.step.beta1,
            .beta2 = update.step.beta2,
            .bias1 = update.step.bias1,
            .bias2 = update.step.bias2,
            .epsilon = update.step.epsilon,
            .min_log_scale = update.min_log_scale,
            .max_log_scale = update.max_log_scale,
            .numbers = update.numbers.data(),
            .moments = update.moments.data()};
  }

  static Segment make_segment(const GaussianCamera& camera, std::span<const PlainPose> poses,
                              std::size_t begin, std::size_t end) {
    Segment segment{.begin = begin, .end = end, .shutter = {}, .keys = {}};
    std::vector<float>& keys = segment.keys;
    for (const PlainPose& pose : poses) {
      // The inverse of a rotation is the conjugate of its quaternion x, y, z, w.
      float key[7] = {
          static_cast<float>(pose.quaternion[3]), static_cast<float>(-pose.quaternion[0]),
          static_cast<float>(-pose.quaternion[1]), static_cast<float>(-pose.quaternion[2])};
      if (!keys.empty()) {
        const float* const before = &keys[keys.size() - 7];
        float dot = 0;
        for (int k = 0; k < 4; ++k) dot += before[k] * key[k];
        for (int k = 0; dot < 0 && k < 4; ++k) key[k] = -key[k];
      }
      for (int k = 0; k < 3; ++k) key[4 + k] = static_cast<float>(pose.translation[k]);
      keys.insert(keys.end(), key, key + 7);
    }
    ShutterKeys& shutter = segment.shutter;
    shutter.n = static_cast<int>(poses.size());
    shutter.keys = keys.data();
    for (int k = 0; k < 9 && !poses.empty(); ++k)
      shutter.rotation[k] = static_cast<float>(poses[0].rotation[3 * (k % 3) + k / 3]);
    shutter.row_scale = static_cast<float>(shutter.n - 1) / camera.image_rows;
    shutter.row_offset = (camera.first_row + 0.5f) * shutter.row_scale;
    return segment;
  }

  /// Calls body(segment, first block, last block) for the segments that overlap the blocks.
  template <class Body>
  static void for_segments(const RasterMemory& w, std::size_t begin, std::size_t end,
                           const Body& body) {
    for (std::size_t s = 0; s < w.segments.size(); ++s) {
      const std::size_t first = std::max(begin, w.segments[s].begin),
                        last = std::min(end, w.segments[s].end);
      if (first < last) body(s, first, last);
    }
  }

  /// Sets segments: the world, then the parts.
  static void set_segments(const GaussianCamera& camera, std::size_t blocks, RasterMemory* w) {
    w->segments.clear();
    w->segments.reserve(1 + camera.parts.size());
    const auto begin_of = [&](std::size_t part) {
      return part < camera.parts.size() ? camera.parts[part].first_block : blocks;
    };
    w->segments.push_back(make_segment(camera, camera.world_from_camera, 0, begin_of(0)));
    for (std::size_t part = 0; part < camera.parts.size(); ++part)
      w->segments.push_back(make_segment(camera, camera.parts[part].part_from_camera,
                                         begin_of(part), begin_of(part + 1)));
  }

  static std::uint64_t count_tiles(const RasterRecord& record, const RasterSize& size) {
    const TileRange t = tiles_of(record, size.stride / kTileSide, size.rows / kTileSide);
    return static_cast<std::uint64_t>(t.x1 - t.x0 + 1) *
           static_cast<std::uint64_t>(t.y1 - t.y0 + 1);
  }

  /// Sets records, visible, keys and n_visible.
  void project(const GaussianCamera& camera, const Gaussians& gaussians, const RasterSize& size,
               RasterMemory* w) {
    const std::size_t blocks = gaussian_blocks(gaussians.n);
    REDRIVE_CHECK_OP(blocks * kGaussianBlock, <=, kMostPairs);
    grown(&w->records, blocks * kGaussianBlock);
    grown(&w->visible, blocks);
    grown(&w->keys, blocks * kGaussianBlock);
    set_segments(camera, blocks, w);
    ProjectionJob job;
    job.camera = camera.camera;
    job.gaussians = gaussians.numbers.data();
    std::vector<std::size_t> drawn(blocks / kBlocksPerRange + 1);
    pool_.run_ranges(blocks, kBlocksPerRange, [&](std::size_t begin, std::size_t end) {
      std::size_t& n = drawn[begin / kBlocksPerRange];
      for_segments(*w, begin, end, [&](std::size_t s, std::size_t first, std::size_t last) {
        ProjectionJob part = job;
        part.shutter = w->segments[s].shutter;
        if (part.shutter.n == 0)
          std::fill(w->visible.data() + first, w->visible.data() + last, std::uint16_t{0});
        else
          n += kernels_.project(part, first, last, w->records.data(), w->visible.data(),
                                w->keys.data() + begin * kGaussianBlock + n);
      });
      // While the records are in the cache.
      for (std::uint64_t& key : std::span(w->keys.data() + begin * kGaussianBlock, n)) {
        const std::uint64_t tiles = count_tiles(w->records[static_cast<std::uint32_t>(key)], size);
        key = (key & ~(kManyTiles << kTileShift)) | std::min(tiles, kManyTiles) << kTileShift;
      }
    });
    w->n_visible = 0;
    for (std::size_t range = 0; range < drawn.size(); ++range) {
      const std::uint64_t* const from = w->keys.data() + range * kBlocksPerRange * kGaussianBlock;
      std::copy(from, from + drawn[range], w->keys.data() + w->n_visible);
      w->n_visible += drawn[range];
    }
  }

  /// Sets pairs, by tile and in each by distance, and `first`.
  void bin(const RasterSize& size, const RasterOptions& options, RasterMemory* w) {
    const int tiles_x = size.stride / kTileSide, tiles_y = size.rows / kTileSide;
    const std::size_t tiles = static_cast<std::size_t>(tiles_x) * tiles_y, n = w->n_visible;
    struct Range {
      std::size_t begin, end, place, made = 0;
      std::uint32_t slot = 0;
      std::vector<std::uint32_t> next;  ///< by tile: counts, then places
    };
    std::vector<Range> ranges(kPairRanges);
    pool_.run(static_cast<int>(kPairRanges), [&](int r) {  // upper bounds of the pairs
      Range& range = ranges[r];
      range.begin = n * r / kPairRanges;
      range.end = n * (r + 1) / kPairRanges;
      range.place = 0;
      for (std::size_t i = range.begin; i < range.end; ++i) {
        const std::uint64_t tiles = w->keys[i] >> kTileShift & kManyTiles;
        range.place += tiles < kManyTiles
                           ? tiles
                           : count_tiles(w->records[static_cast<std::uint32_t>(w->keys[i])], size);
      }
    });
    std::size_t most = 0;
    for (Range& range : ranges) most += std::exchange(range.place, most);
    TilePair* const unordered = w->scratch_of<TilePair>(most);
    pool_.run(static_cast<int>(kPairRanges), [&](int r) {
      Range& range = ranges[r];
      TilePair* const pairs = unordered + range.place;
      range.made = kernels_.bin(w->records.data(), w->keys.data() + range.begin,
                                range.end - range.begin, tiles_x, tiles_y,
                                options.tiles.empty() ? nullptr : options.tiles.data(), pairs);
      range.next.assign(tiles, 0);
      for (std::size_t i = 0; i < range.made; ++i) ++range.next[pairs[i].tile];
    });
    std::size_t pairs = 0;
    for (const Range& range : ranges) pairs += range.made;
    REDRIVE_CHECK_OP(pairs, <=, kMostPairs);
    w->first.resize(tiles + 1);
    std::uint32_t before = 0;
    for (std::size_t tile = 0; tile < tiles; ++tile) {
      w->first[tile] = before;
      for (Range& range : ranges) before += std::exchange(range.next[tile], before);
    }
    w->first[tiles] = before;
    std::uint32_t slot = 0;
    for (Range& range : ranges) {
      range.slot = slot;
      slot += static_cast<std::uint32_t>(range.made);
    }
    grown(&w->pairs, before, before / 16);
    pool_.run(static_cast<int>(kPairRanges), [&](int r) {
      Range& range = ranges[r];
      std::uint32_t next_slot = range.slot;
      for (std::size_t i = range.begin; i < range.end; ++i) {
        if (i + kPrefetched < range.end)
          __builtin_prefetch(&w->records[static_cast<std::uint32_t>(w->keys[i + kPrefetched])], 1);
        RasterRecord& record = w->records[static_cast<std::uint32_t>(w->keys[i])];
        record.first_pair = next_slot;
        next_slot += record.pairs;
      }
      const TilePair* const made = unordered + range.place;
      for (std::size_t i = 0; i < range.made; ++i) {
        TilePair pair = made[i];
        pair.slot = range.slot + static_cast<std::uint32_t>(i);
        w->pairs[range.next[pair.tile]++] = pair;
      }
    });
  }

  /// Runs body on a job for each wanted tile.
  template <class Body>
  void for_tiles(const RasterSize& size, const RasterOptions& options, const RasterMemory& w,
                 const Body& body) {
    const int tiles_x = size.stride / kTileSide;
    const std::size_t tiles = w.first.size() - 1;
    pool_.run_ranges(tiles, kTilesPerRange, [&](std::size_t begin, std::size_t end) {
      for (std::size_t tile = begin; tile < end; ++tile) {
        if (!options.tiles.empty() && !options.tiles[tile]) continue;
        TileJob job;
        job.tile_x = static_cast<int>(tile) % tiles_x;
        job.tile_y = static_cast<int>(tile) / tiles_x;
        job.records = w.records.data();
        job.pairs = w.pairs.data() + w.first[tile];
        job.n = w.first[tile + 1] - w.first[tile];
        job.stride = size.stride;
        job.plane = size.plane();
        job.log_range = options.log_range.empty() ? nullptr : options.log_range.data();
        std::ranges::copy(options.background, job.background);
        job.scratch = tile_memory(tile_scratch(job.n));
        body(&job);
      }
    });
  }

  const GaussianKernels& kernels_;
  ThreadPool& pool_;
  RasterMemory memory_;
  std::array<float, kSsimTaps> taps_;
  Buffer<float> target_, mask_, masked_, moments_, slopes_;
};

}  // namespace

std::unique_ptr<GaussianStages> make_cpu_gaussian_stages(Isa isa, ThreadPool* pool) {
  return std::make_unique<CpuGaussianStages>(isa, pool);
}

}  // namespace redrive::kernels
