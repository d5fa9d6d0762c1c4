// SPDX-License-Identifier: Apache-2.0
// Loops of block products over a layer. Every pass keeps the weights of one block of outputs in L1
// (k = 256: 16 KiB) and streams the tile's samples.
#pragma once

#include "redrive/kernels/nerf/cpu/bf16/block_product.h"
#include "redrive/kernels/nerf/cpu/bf16/epilogue.h"

namespace redrive::kernels::bf16 {
namespace {

/// Blocks of one operand along k for sample block n: data + n * stride blocks, `blocks` of them.
struct Operand {
  const Bf16* data = nullptr;
  int stride = 0, blocks = 0;
};

struct Pass {
  const Bf16* weights = nullptr;  ///< [out_blocks][weight_stride] blocks
  int weight_stride = 0;
  Operand in, extra;  ///< extra: behind `in` along k; 0 blocks if there is none
  int out_blocks = 0, n_blocks = 0;
  const float* bias = nullptr;  ///< [out_blocks][kBiasTile], or null
  PassOutput output;
};

/// forward: C[neurons, samples] = W X; backward: C[samples, inputs] = D W. `out_blocks` blocks for
/// each block of samples.
template <Epilogue kind>
void run_pass(const Pass& pass) {
  alignas(64) float c[kBlockSize];
  for (int ob = 0; ob < pass.out_blocks; ++ob) {
    const Bf16* w0 = pass.weights + std::ptrdiff_t(ob) * pass.weight_stride * kBlockSize;
    const Bf16* w1 = w0 + std::ptrdiff_t(pass.in.blocks) * kBlockSize;
    const float* bias = pass.bias ? pass.bias + std::ptrdiff_t(ob) * kBiasTile : nullptr;
    for (int n = 0; n < pass.n_blocks; ++n) {
      const Bf16* x0 = pass.in.data + std::ptrdiff_t(n) * pass.in.stride * kBlockSize;
      const Bf16* x1 = pass.extra.blocks
                           ? pass.extra.data + std::ptrdiff_t(n) * pass.extra.stride * kBlockSize
                           : nullptr;
      const Product product = is_backward(kind)
                                  ? Product{x0, w0, pass.in.blocks, x1, w1, pass.extra.blocks}
                                  : Product{w0, x0, pass.in.blocks, w1, x1, pass.extra.blocks};
      write_product(product, bias, c, keep_of<kind>(pass.output, pass.n_blocks, ob, n));
      finish_block<kind>(pass.output, pass.n_blocks, ob, n, c);
    }
  }
}

/// dW^T of a layer: [out_blocks][x blocks] C blocks += keep of the inputs times keep of the
/// gradients, in chunks of samples.
struct WeightGradient {
  const Bf16 *x = nullptr, *extra = nullptr;  ///< [blocks][n_blocks]
  int x_blocks = 0, extra_blocks = 0;
  const Bf16* d = nullptr;  ///< [out_blocks][n_blocks]
  int out_blocks = 0, n_blocks = 0;
  bool clear = false;  ///< overwrite instead of adding
  float* d_weight = nullptr;
};

inline void add_weight_gradient(const WeightGradient& g) {
  const std::ptrdiff_t panel = std::ptrdiff_t(g.n_blocks) * kBlockSize;
  const int k_blocks = g.x_blocks + g.extra_blocks;
  const auto left = [&](int ib) {
    return ib < g.x_blocks ? g.x + ib * panel : g.extra + (ib - g.x_blocks) * panel;
  };
  for (int first = 0; first < g.n_blocks; first += kWeightGradientBlocks) {
    const int chunk =
        g.n_blocks - first < kWeightGradientBlocks ? g.n_blocks - first : kWeightGradientBlocks;
    const std::ptrdiff_t offset = std::ptrdiff_t(first) * kBlockSize;
    for (int ob = 0; ob < g.out_blocks; ++ob) {
      for (int ib = 0; ib < k_blocks; ++ib) {
        float* c = g.d_weight + (std::ptrdiff_t(ob) * k_blocks + ib) * kBlockSize;
        add_product(left(ib) + offset, g.d + ob * panel + offset, chunk, g.clear && first == 0, c);
      }
    }
  }
}

}  // namespace
}  // namespace redrive::kernels::bf16
