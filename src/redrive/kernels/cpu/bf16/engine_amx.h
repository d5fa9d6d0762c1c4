// SPDX-License-Identifier: Apache-2.0
// The block product by AMX: registers 0..3 hold C (2 x 2 tiles), 4 and 5 the left operand, 6 and 7
// the right one. `Tiles` is the instructions themselves (tiles_hardware.h) or their emulation
// (tiles_emulated.h).
#pragma once

#include "redrive/kernels/cpu/bf16/product.h"

namespace redrive::kernels::bf16 {
namespace {

template <class Tiles>
struct AmxEngine {
  /// 512 samples x 256 neurons x 8.5 layers of kept activations are 2.1 MiB, near Sapphire Rapids'
  /// L2 of 2 MiB; 256 to 1024 were within 10 % there, 128 a third slower (the weights are read
  /// again for every tile).
  static constexpr int kTileSamples = 512;

  static void begin() { Tiles::configure(); }
  static void end() { Tiles::release(); }

  /// c = (bias ? its columns repeated : 0) + products. The pending epilogue, which reads c, runs
  /// between the first steps: the tile unit is busy for 64 cycles a step while the vector units
  /// pack the block before.
  template <class PendingBlock>
  REDRIVE_INLINE static void product(const Product& p, const float* bias, float* c,
                                     PendingBlock& pending, Prefetch& prefetch) {
    if (bias) {
      Tiles::template load<0>(bias);
      Tiles::template load<1>(bias);
      Tiles::template load<2>(bias + kTileFloats);
      Tiles::template load<3>(bias + kTileFloats);
    } else {
      zero();
    }
    int done = 0;
    if (!pending.exists()) {
    } else if (p.k0 >= 8) {
      done = interleaved<8>(p, pending, prefetch);
    } else if (p.k0 >= 4) {
      done = interleaved<4>(p, pending, prefetch);
    } else if (p.k0 >= 2) {
      done = interleaved<2>(p, pending, prefetch);
    } else {
      done = interleaved<1>(p, pending, prefetch);
    }
    for (int k = done; k < p.k0; ++k) {
      step(p.a0 + k * kBlockSize, p.b0 + k * kBlockSize);
      prefetch.advance_stream();
    }
    for (int k = 0; k < p.k1; ++k) {
      step(p.a1 + k * kBlockSize, p.b1 + k * kBlockSize);
      prefetch.advance_stream();
    }
    store_c(c);
  }

  REDRIVE_INLINE static void accumulate(const Bf16* a, const Bf16* b, int k_blocks, bool clear,
                                        float* c, const PanelPrefetch& prefetch) {
    if (clear) {
      zero();
    } else {
      Tiles::template load<0>(c);
      Tiles::template load<1>(c + kTileFloats);
      Tiles::template load<2>(c + 2 * kTileFloats);
      Tiles::template load<3>(c + 3 * kTileFloats);
    }
    for (int k = 0; k < k_blocks; ++k) {
      step(a + k * kBlockSize, b + k * kBlockSize);
      prefetch.step(k);
    }
    store_c(c);
  }

 private:
  /// The first `steps` products of k with the pending block's 32 rows spread evenly between them.
  template <int steps, class PendingBlock>
  REDRIVE_INLINE static int interleaved(const Product& p, PendingBlock& pending,
                                        Prefetch& prefetch) {
    constexpr int kRows = kBlock / steps, kLines = kBlockSize * 2 / kLine / steps;
#pragma GCC unroll 8
    for (int k = 0; k < steps; ++k) {
      step(p.a0 + k * kBlockSize, p.b0 + k * kBlockSize);
      pending.rows(k * kRows, kRows);
      prefetch.prepare_write(k * kLines, kLines);
      prefetch.advance_stream();
    }
    return steps;
  }

  /// The second operands are loaded behind the first product, so that it can start early.
  REDRIVE_INLINE static void step(const Bf16* a, const Bf16* b) {
    Tiles::template load<4>(a);
    Tiles::template load<6>(b);
    Tiles::template multiply<0, 4, 6>();
    Tiles::template load<7>(b + kTileSize);
    Tiles::template multiply<1, 4, 7>();
    Tiles::template load<5>(a + kTileSize);
    Tiles::template multiply<2, 5, 6>();
    Tiles::template multiply<3, 5, 7>();
  }

  REDRIVE_INLINE static void zero() {
    Tiles::template zero<0>();
    Tiles::template zero<1>();
    Tiles::template zero<2>();
    Tiles::template zero<3>();
  }

  REDRIVE_INLINE static void store_c(float* c) {
    Tiles::template store<0>(c);
    Tiles::template store<1>(c + kTileFloats);
    Tiles::template store<2>(c + 2 * kTileFloats);
    Tiles::template store<3>(c + 3 * kTileFloats);
  }
};

}  // namespace
}  // namespace redrive::kernels::bf16
