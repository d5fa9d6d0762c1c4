// SPDX-License-Identifier: Apache-2.0
// The portable half of the bf16 network: sizes, memory and threads. The arithmetic is in
// network_avx512.cc, encode.cc and pack.cc.
#include "redrive/kernels/nerf/cpu/bf16/network.h"

#include <algorithm>
#include <utility>

#include "redrive/base/error.h"

namespace redrive::kernels::bf16 {
namespace {

int blocks_of(int size) { return (size + kBlock - 1) / kBlock; }

/// Divides one allocation into parts, each on its own page.
class Carver {
 public:
  template <class T>
  T* take(std::size_t size) {
    constexpr std::size_t kPage = 4096;
    T* part = base_ ? reinterpret_cast<T*>(base_ + used_) : nullptr;
    used_ += (size * sizeof(T) + kPage - 1) / kPage * kPage;
    return part;
  }
  explicit Carver(std::byte* base) : base_(base) {}
  std::size_t used() const { return used_; }

 private:
  std::byte* base_;
  std::size_t used_ = 0;
};

/// With base = null only the size is counted. n: blocks of 32 samples.
ChunkMemory carve(const Plan& plan, int n, Carver& carver) {
  const std::size_t block = static_cast<std::size_t>(n) * kBlockSize;
  const std::size_t widest =
      block * static_cast<std::size_t>(std::max(plan.width_blocks, plan.colour_blocks + 1));
  ChunkMemory memory;
  memory.position_next = carver.take<Bf16>(block * plan.position_blocks);
  memory.position_keep = carver.take<Bf16>(block * plan.position_blocks);
  memory.direction_next = carver.take<Bf16>(block * plan.direction_blocks);
  memory.direction_keep = carver.take<Bf16>(block * plan.direction_blocks);
  memory.ray_code =
      carver.take<Bf16>(static_cast<std::size_t>(n) * kBlock * kBlock * plan.direction_blocks);
  for (int i = 0; i < 2; ++i) {
    memory.next[i] = carver.take<Bf16>(widest);
    memory.d_next[i] = carver.take<Bf16>(widest);
    memory.d_keep[i] = carver.take<Bf16>(widest);
  }
  for (int layer = 0; layer < kRgb; ++layer) {
    memory.keep[layer] = carver.take<Bf16>(block * plan.layers[layer].out_blocks);
    memory.mask[layer] = carver.take<std::uint32_t>(static_cast<std::size_t>(n) * kBlock *
                                                    plan.layers[layer].out_blocks);
  }
  memory.d_rgb_next = carver.take<Bf16>(block);
  memory.d_rgb_keep = carver.take<Bf16>(block);
  for (float*& d_gamma : memory.d_gamma) d_gamma = carver.take<float>(block * plan.position_blocks);
  memory.d_weight = carver.take<float>(
      plan.d_weight_size + kBlockSize);  // so that the prefetch of a next block stays inside
  memory.d_bias = carver.take<float>(plan.d_bias_size);
  return memory;
}

}  // namespace

Plan make_plan(const NerfConfig& config) {
  REDRIVE_CHECK_OP(config.width % kBlock, ==, 0);
  REDRIVE_CHECK_OP(config.width, >=, kBlock);
  REDRIVE_CHECK_OP(config.position_octaves, <=, 10);
  REDRIVE_CHECK_OP(config.direction_octaves, <=, 4);
  Plan plan;
  plan.position_octaves = config.position_octaves;
  plan.direction_octaves = config.direction_octaves;
  plan.width_blocks = blocks_of(config.width);
  plan.colour_blocks = blocks_of(config.width / 2);
  plan.position_blocks = blocks_of(encoded_size(config.position_octaves));
  plan.direction_blocks = blocks_of(encoded_size(config.direction_octaves));
  for (int i = 0; i < kPlanLayers; ++i) {
    Layer& layer = plan.layers[i];
    layer.in_blocks = i == 0      ? plan.position_blocks
                      : i == kRgb ? plan.colour_blocks
                                  : plan.width_blocks;
    layer.extra_blocks = i == kNerfSkip ? plan.position_blocks
                         : i == kColour ? plan.direction_blocks
                                        : 0;
    layer.k_blocks = layer.in_blocks + layer.extra_blocks;
    layer.backward_blocks = i == kColour ? layer.in_blocks : layer.k_blocks;
    layer.out_blocks = i == kRgb ? 1 : i == kColour ? plan.colour_blocks + 1 : plan.width_blocks;
    layer.forward = plan.packed_size;
    plan.packed_size += static_cast<std::size_t>(layer.out_blocks) * layer.k_blocks * kBlockSize;
    layer.d_weight = plan.d_weight_size;
    plan.d_weight_size += static_cast<std::size_t>(layer.out_blocks) * layer.k_blocks * kBlockSize;
    layer.bias_tile = plan.bias_size;
    plan.bias_size += static_cast<std::size_t>(layer.out_blocks) * kBiasTile;
    layer.d_bias = plan.d_bias_size;
    plan.d_bias_size += static_cast<std::size_t>(layer.out_blocks) * kBlock;
  }
  for (Layer& layer : plan.layers) {
    layer.backward = plan.packed_size;
    plan.packed_size +=
        static_cast<std::size_t>(layer.backward_blocks) * layer.out_blocks * kBlockSize;
  }
  return plan;
}

std::vector<BlockRow> make_block_rows(const NerfConfig& config, const Plan& plan,
                                      const NerfLayerShape& folded) {
  std::vector<BlockRow> rows;
  for (int i = 0; i < kPlanLayers; ++i) {
    const Layer& layer = plan.layers[i];
    for (int ob = 0; ob < layer.out_blocks; ++ob) {
      const bool density = i == kColour && ob == plan.colour_blocks;
      BlockRow row;
      row.folded = i == kColour && !density;
      const NerfLayerShape shape = row.folded  ? folded
                                   : density   ? nerf_layer(config, kNerfDensity)
                                   : i == kRgb ? nerf_layer(config, kNerfRgb)
                                               : nerf_layer(config, i);
      const int first = density ? 0 : ob * kBlock;
      row.weight = shape.weight + static_cast<std::size_t>(first) * shape.inputs;
      row.bias = shape.bias + static_cast<std::size_t>(first);
      row.rows = std::min(kBlock, shape.outputs - first);
      row.columns = shape.inputs;
      row.k_blocks = layer.k_blocks;
      row.backward_blocks = layer.backward_blocks;
      row.backward_stride = layer.out_blocks;
      row.forward = layer.forward + static_cast<std::size_t>(ob) * layer.k_blocks * kBlockSize;
      row.backward = layer.backward + static_cast<std::size_t>(ob) * kBlockSize;
      row.bias_tile = layer.bias_tile + static_cast<std::size_t>(ob) * kBiasTile;
      row.d_weight = layer.d_weight + static_cast<std::size_t>(ob) * layer.k_blocks * kBlockSize;
      row.d_bias = layer.d_bias + static_cast<std::size_t>(ob) * kBlock;
      rows.push_back(row);
    }
  }
  return rows;
}

Chunk::Chunk(const Network& network, int max_samples)
    : network_(network), max_samples_(max_samples) {
  REDRIVE_CHECK_OP(max_samples, >=, 1);
  Carver counter(nullptr);
  carve(network.plan(), blocks_of(max_samples), counter);
  storage_ = Buffer<std::byte>(counter.used());
  Carver carver(storage_.data());
  memory_ = carve(network.plan(), blocks_of(max_samples), carver);
}

void Chunk::clear_gradients() {
  memory_.fresh = true;
  std::fill_n(memory_.d_bias, network_.plan().d_bias_size, 0.0f);
}

void Chunk::forward(const NerfTile& tile, bool keep, float* raw, int stride) {
  REDRIVE_CHECK_OP(tile.samples(), >=, 1);
  REDRIVE_CHECK_OP(tile.samples(), <=, max_samples_);
  REDRIVE_CHECK_OP(stride, >=, tile.samples());
  kept_samples_ = keep ? tile.samples() : 0;
  const TileInput input{tile.n_rays, tile.per_ray, tile.position, tile.direction};
  forward_tile(network_.plan(), network_.weights(), memory_, input, keep, raw, stride);
}

void Chunk::backward(const float* d_raw, int stride, float* d_position) {
  REDRIVE_CHECK_OP(kept_samples_, >=, 1);
  REDRIVE_CHECK_OP(stride, >=, kept_samples_);
  backward_tile(network_.plan(), network_.weights(), memory_, kept_samples_, d_raw, stride,
                d_position);
  memory_.fresh = false;
}

Network::Network(const NerfConfig& config)
    : config_(config),
      plan_(make_plan(config)),
      folded_(config),
      rows_(make_block_rows(config, plan_, folded_.shape())),
      packed_(plan_.packed_size),
      bias_(plan_.bias_size),
      weights_{packed_.data(), bias_.data()} {}

void Network::pack(std::span<const float> parameters, ThreadPool& pool) {
  REDRIVE_CHECK_OP(parameters.size(), ==, nerf_parameter_count(config_));
  folded_.fold(parameters, pool);
  pool.run_ranges(rows_.size(), 2, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      pack_row(rows_[i], rows_[i].folded ? folded_.parameters().data() : parameters.data(),
               weights_);
    }
  });
}

std::unique_ptr<NerfChunk> Network::make_chunk(int max_samples) {
  return std::make_unique<Chunk>(*this, max_samples);
}

void Network::reduce(std::span<const std::unique_ptr<NerfChunk>> chunks, std::span<float> gradients,
                     ThreadPool& pool) {
  REDRIVE_CHECK_OP(gradients.size(), ==, nerf_parameter_count(config_));
  std::vector<const ChunkMemory*> used;
  for (const auto& chunk : chunks) {
    const ChunkMemory& memory = static_cast<const Chunk&>(*chunk).memory();
    if (!memory.fresh) used.push_back(&memory);
  }
  if (used.empty()) return;
  pool.run_ranges(rows_.size(), 2, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      float* sums = rows_[i].folded ? folded_.gradients().data() : gradients.data();
      reduce_row(rows_[i], used.data(), static_cast<int>(used.size()), sums);
    }
  });
  folded_.unfold(gradients, pool);
}

}  // namespace redrive::kernels::bf16

namespace redrive::kernels {

std::unique_ptr<NerfNetwork> make_nerf_avx512_bf16(const NerfConfig& config) {
  return std::make_unique<bf16::Network>(config);
}

}  // namespace redrive::kernels
