// SPDX-License-Identifier: Apache-2.0
// The bf16 network (nerf_tile.h).
#pragma once

#include <cstddef>
#include <memory>
#include <span>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"
#include "redrive/kernels/nerf/cpu/folded_colour.h"
#include "redrive/kernels/nerf/cpu/nerf_tile.h"

namespace redrive::kernels::bf16 {

Plan make_plan(const NerfConfig& config);
/// folded: FoldedColour::shape().
std::vector<BlockRow> make_block_rows(const NerfConfig& config, const Plan& plan,
                                      const NerfLayerShape& folded);

class Network final : public NerfNetwork {
 public:
  explicit Network(const NerfConfig& config);

  /// 192 samples x 256 neurons x 8.5 layers of kept activations are 0.8 MiB, within Zen 5's L2 of 1
  /// MiB; 2 x 96 or 4 x 48, whole blocks. Forward and backward of 98,304 samples at width 256 on
  /// one thread: 625 to 631 ms from 192 to 960.
  int tile_samples() const override { return 192; }
  void pack(std::span<const float> parameters, ThreadPool& pool) override;
  std::unique_ptr<NerfChunk> make_chunk(int max_samples) override;
  void reduce(std::span<const std::unique_ptr<NerfChunk>> chunks, std::span<float> gradients,
              ThreadPool& pool) override;

  const Plan& plan() const { return plan_; }
  const Weights& weights() const { return weights_; }

 private:
  NerfConfig config_;
  Plan plan_;
  FoldedColour folded_;
  std::vector<BlockRow> rows_;
  Buffer<Bf16> packed_;
  Buffer<float> bias_;
  Weights weights_;
};

/// `network` must outlive the chunk.
class Chunk final : public NerfChunk {
 public:
  Chunk(const Network& network, int max_samples);

  void clear_gradients() override;
  void forward(const NerfTile& tile, bool keep, float* raw, int stride) override;
  void backward(const float* d_raw, int stride, float* d_position) override;

  const ChunkMemory& memory() const { return memory_; }

 private:
  const Network& network_;
  int max_samples_;
  int kept_samples_ = 0;  ///< samples of the last forward pass, 0 if it kept nothing
  Buffer<std::byte> storage_;
  ChunkMemory memory_;
};

}  // namespace redrive::kernels::bf16
