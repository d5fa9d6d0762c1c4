// SPDX-License-Identifier: Apache-2.0
// Cuts batches into tiles of whole rays and calls an instruction set's network on them. A batch has
// a fixed number of chunks, and each chunk a fixed list of tiles; sums are kept by chunk and added
// in their order. So the result does not depend on the number of threads.
#include "redrive/kernels/nerf/cpu/cpu_nerf_stages.h"

#include <algorithm>
#include <iterator>
#include <numeric>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/cpu/composite_range.h"
#include "redrive/kernels/cpu/ray_points.h"
#include "redrive/kernels/nerf/add_ray_gradient.h"
#include "redrive/kernels/nerf/check_nerf_sizes.h"
#include "redrive/kernels/nerf/cpu/front_to_back.h"
#include "redrive/kernels/nerf/cpu/nerf_tile.h"
#include "redrive/kernels/nerf/plain_nerf_stages.h"
#include "redrive/optim/photometric_loss.h"

namespace redrive::kernels {
namespace {

std::unique_ptr<NerfNetwork> make_network(Isa isa, const NerfConfig& config) {
  switch (isa) {
    case Isa::kAvx2: return make_nerf_avx2(config);
    case Isa::kAvx512: return make_nerf_avx512(config);
    case Isa::kAvx512Bf16: return make_nerf_avx512_bf16(config);
    default: throw UsageError("--isa", isa_name(isa), "not in this build");
  }
}

/// Memory of a chunk for one tile.
struct ChunkMemory {
  Buffer<float> position, direction, raw, d_raw, d_rgb, d_position, composite;

  ChunkMemory(int max_rays, int per_ray)
      : position(3 * static_cast<std::size_t>(max_rays) * per_ray),
        direction(3 * static_cast<std::size_t>(max_rays)),
        raw(4 * static_cast<std::size_t>(max_rays) * per_ray),
        d_raw(raw.size()),
        d_rgb(direction.size()),
        d_position(position.size()),
        composite(composite_scratch(per_ray)) {}
};

/// A network for batches of one shape, with its chunks; packed anew for every batch.
struct Engine {
  NerfConfig config;
  int per_ray = 0, rays_per_tile = 0;
  std::unique_ptr<NerfNetwork> network;
  std::vector<std::unique_ptr<NerfChunk>> chunks;
  std::vector<ChunkMemory> memory;
  /// one per chunk; made when first rendering
  std::vector<std::unique_ptr<FrontToBack>> front_to_back;
};

class CpuNerfStages final : public PlainNerfStages {
 public:
  CpuNerfStages(Backend& backend, Isa isa, const CpuKernels& kernels, ThreadPool* pool)
      : PlainNerfStages(backend, pool), isa_(isa), kernels_(kernels), pool_(*pool) {}

  void network_forward(const NerfField& field, const Rays& rays, const Samples& samples,
                       std::span<float> raw) override {
    check_field(field, rays, samples);
    check_raw(rays.n, samples, raw.size());
    Engine& engine = prepare(field, samples.per_ray);
    const int stride = static_cast<int>(sample_count(rays.n, samples));
    for_each_tile(engine, rays.n, [&](int chunk, RayRange tile) {
      forward_tile(engine, chunk, field, rays, samples, tile, false,
                   raw.data() + first_sample(tile, samples), stride);
    });
  }

  void network_backward(const NerfField& field, const Rays& rays, const Samples& samples,
                        std::span<const float> d_raw, std::span<float> gradients,
                        const RayGradients& of_rays) override {
    check_field_backward(field, rays, samples, d_raw.size(), gradients.size(), of_rays);
    Engine& engine = prepare(field, samples.per_ray);
    const int stride = static_cast<int>(sample_count(rays.n, samples));
    pool_.run(kChunksPerBatch, [&](int chunk) { engine.chunks[chunk]->clear_gradients(); });
    for_each_tile(engine, rays.n, [&](int chunk, RayRange tile) {
      forward_tile(engine, chunk, field, rays, samples, tile, true, engine.memory[chunk].raw.data(),
                   tile.n * samples.per_ray);
      backward_tile(engine, chunk, field, rays.n, samples, tile,
                    d_raw.data() + first_sample(tile, samples), stride, of_rays);
    });
    engine.network->reduce(engine.chunks, gradients, pool_);
  }

  void train_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                  std::span<const float> target, const CompositeOut& out,
                  std::span<float> gradients, const RayGradients& of_rays, double* loss) override {
    check_field(field, rays, samples);
    check_composite(rays.n, samples, out);
    check_ray_gradients(rays.n, of_rays);
    check_photometric(out.rgb.size(), target.size(), out.rgb.size());
    REDRIVE_CHECK_OP(gradients.size(), ==, field.parameters.size());
    Engine& engine = prepare(field, samples.per_ray);
    double chunk_loss[kChunksPerBatch]{};
    pool_.run(kChunksPerBatch, [&](int chunk) { engine.chunks[chunk]->clear_gradients(); });
    for_each_tile(engine, rays.n, [&](int chunk, RayRange tile) {
      ChunkMemory& memory = engine.memory[chunk];
      const int stride = tile.n * samples.per_ray;
      forward_tile(engine, chunk, field, rays, samples, tile, true, memory.raw.data(), stride);
      const CompositeForward composite = composite_rays(tile, samples, memory.raw.data(), stride);
      kernels_.composite_forward(composite, composite_result(tile, rays.n, samples, out),
                                 memory.composite.data());
      for (int k = 0; k < 3; ++k)
        for (int ray = 0; ray < tile.n; ++ray) {
          const std::size_t at = static_cast<std::size_t>(k) * rays.n + tile.first + ray;
          const auto term = photometric_term<double>(out.rgb[at], target[at], rays.n);
          chunk_loss[chunk] += term.value;
          memory.d_rgb[static_cast<std::size_t>(k) * tile.n + ray] =
              static_cast<float>(term.derivative);
        }
      kernels_.composite_backward(composite,
                                  {.d_rgb = memory.d_rgb.data(),
                                   .d_rgb_stride = static_cast<std::size_t>(tile.n),
                                   .d_raw = memory.d_raw.data(),
                                   .d_raw_stride = static_cast<std::size_t>(stride)},
                                  memory.composite.data());
      backward_tile(engine, chunk, field, rays.n, samples, tile, memory.d_raw.data(), stride,
                    of_rays);
    });
    engine.network->reduce(engine.chunks, gradients, pool_);
    *loss = std::accumulate(std::begin(chunk_loss), std::end(chunk_loss), 0.0);
  }

  void render_rays(const NerfField& field, const Rays& rays, const Samples& samples,
                   const CompositeOut& out) override {
    check_field(field, rays, samples);
    check_composite(rays.n, samples, out);
    Engine& engine = prepare(field, samples.per_ray);
    while (engine.front_to_back.size() < kChunksPerBatch)
      engine.front_to_back.push_back(
          std::make_unique<FrontToBack>(samples.per_ray, engine.rays_per_tile * samples.per_ray));
    for_each_block(
        engine, rays.n, engine.front_to_back.front()->block_rays(), [&](int chunk, RayRange block) {
          FrontToBack& front_to_back = *engine.front_to_back[chunk];
          const float* raw = front_to_back.run(*engine.chunks[chunk], field, rays, samples, block);
          kernels_.composite_forward(
              composite_rays(block, samples, raw, front_to_back.raw_stride()),
              composite_result(block, rays.n, samples, out), engine.memory[chunk].composite.data());
        });
  }

 private:
  /// The engine of this shape, made on first use, with the field's parameters.
  Engine& prepare(const NerfField& field, int per_ray) {
    auto found =
        std::find_if(engines_.begin(), engines_.end(), [&](const std::unique_ptr<Engine>& engine) {
          return engine->config == field.config && engine->per_ray == per_ray;
        });
    if (found == engines_.end()) {
      if (engines_.size() == kMaxEngines) engines_.erase(engines_.begin());
      auto engine = std::make_unique<Engine>();
      engine->config = field.config;
      engine->per_ray = per_ray;
      engine->network = make_network(isa_, field.config);
      engine->rays_per_tile = std::max(1, engine->network->tile_samples() / per_ray);
      for (int chunk = 0; chunk < kChunksPerBatch; ++chunk) {
        engine->chunks.push_back(engine->network->make_chunk(engine->rays_per_tile * per_ray));
        engine->memory.emplace_back(engine->rays_per_tile, per_ray);
      }
      engines_.push_back(std::move(engine));
      found = engines_.end() - 1;
    }
    (*found)->network->pack(field.parameters, pool_);
    return **found;
  }

  template <class Visit>
  void for_each_tile(Engine& engine, int n_rays, const Visit& visit) {
    for_each_block(engine, n_rays, engine.rays_per_tile, visit);
  }

  /// Shares whole tiles out among the chunks, evenly, and calls visit(chunk, range) for blocks of
  /// at most block_rays rays; the blocks of a chunk are consecutive and in order, on one thread.
  template <class Visit>
  void for_each_block(Engine& engine, int n_rays, int block_rays, const Visit& visit) {
    const std::int64_t tiles = (n_rays + engine.rays_per_tile - 1) / engine.rays_per_tile;
    pool_.run(kChunksPerBatch, [&](int chunk) {
      const int begin = static_cast<int>(tiles * chunk / kChunksPerBatch) * engine.rays_per_tile;
      const int end = std::min(
          n_rays, static_cast<int>(tiles * (chunk + 1) / kChunksPerBatch) * engine.rays_per_tile);
      if (begin >= end) return;
      for (int first = begin; first < end; first += block_rays)
        visit(chunk, RayRange{first, std::min(block_rays, end - first)});
    });
  }

  void forward_tile(Engine& engine, int chunk, const NerfField& field, const Rays& rays,
                    const Samples& samples, RayRange tile, bool keep, float* raw, int stride) {
    ChunkMemory& memory = engine.memory[chunk];
    compute_points({.n_rays = tile.n,
                    .per_ray = samples.per_ray,
                    .origin = rays.origin.data() + tile.first,
                    .direction = rays.direction.data() + tile.first,
                    .ray_stride = static_cast<std::size_t>(rays.n),
                    .t = samples.t.data() + first_sample(tile, samples),
                    .center = field.unit_from_world.center.data(),
                    .scale = field.unit_from_world.scale,
                    .position = memory.position.data(),
                    .stride = static_cast<std::size_t>(tile.n) * samples.per_ray});
    for (int d = 0; d < 3; ++d)
      std::copy_n(rays.direction.data() + static_cast<std::size_t>(d) * rays.n + tile.first, tile.n,
                  memory.direction.data() + static_cast<std::size_t>(d) * tile.n);
    engine.chunks[chunk]->forward({.n_rays = tile.n,
                                   .per_ray = samples.per_ray,
                                   .position = memory.position.data(),
                                   .direction = memory.direction.data()},
                                  keep, raw, stride);
  }

  /// The adjoint of forward_tile: adds to the chunk's gradients and, where they are wanted, to the
  /// gradients of the tile's rays.
  static void backward_tile(Engine& engine, int chunk, const NerfField& field, int n_rays,
                            const Samples& samples, RayRange tile, const float* d_raw, int stride,
                            const RayGradients& of_rays) {
    float* d_position = of_rays.wanted() ? engine.memory[chunk].d_position.data() : nullptr;
    engine.chunks[chunk]->backward(d_raw, stride, d_position);
    if (!of_rays.wanted()) return;
    const std::size_t of_tile = static_cast<std::size_t>(tile.n) * samples.per_ray;
    for (int ray = 0; ray < tile.n; ++ray)
      add_ray_gradient(field.unit_from_world, n_rays, samples, tile.first + ray,
                       d_position + static_cast<std::size_t>(ray) * samples.per_ray, of_tile,
                       of_rays);
  }

  static constexpr std::size_t kMaxEngines = 4;  // coarse and fine, each for training and rendering
  const Isa isa_;
  const CpuKernels& kernels_;
  ThreadPool& pool_;
  std::vector<std::unique_ptr<Engine>> engines_;
};

}  // namespace

std::unique_ptr<NerfStages> make_cpu_nerf_stages(Backend& backend, Isa isa,
                                                 const CpuKernels& kernels, ThreadPool* pool) {
  return std::make_unique<CpuNerfStages>(backend, isa, kernels, pool);
}

}  // namespace redrive::kernels
