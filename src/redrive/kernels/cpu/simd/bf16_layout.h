// SPDX-License-Identifier: Apache-2.0
// Memory layouts of matrices for bf16 products with fp32 sums (vdpbf16ps). Everything is cut into
// blocks of 32 x 32, two vectors of 16 columns wide.
//
// A block of 32 x 32 bf16 is two tiles of 16 x 32 (1 KiB each, 2 KiB a block), in one of two forms:
//
// clang-format off
//   row form        (left operand A, k = columns)
//     tile t, row r, column c = M[16 t + r][c] at 512 t + 32 r + c
//     t = 0: rows 0..15, t = 1: rows 16..31, all 32 columns
//
//   pair form       (right operand B, k = rows)
//     tile t, row p, pair c = M[2 p][16 t + c], M[2 p + 1][16 t + c] at 512 t + 32 p + 2 c
//     t = 0: columns 0..15, t = 1: columns 16..31; rows (0, 1), (2, 3), ... side by side
//
//   fp32 block C
//     tile (i, j), row r, column c = C[16 i + r][16 j + c] at 512 i + 256 j + 16 r + c
//
// Only the bits of the ReLU masks are ever transposed:
//   forward  C = W X      rows = neurons, columns = samples; W in row form; X in pair form
//                         (k = inputs). A finished C is packed into pair form (X of the next layer:
//                         "next") by joining neighbouring rows, and into row form (neurons x
//                         samples: "keep", left operand of dW) by joining neighbouring column
//                         tiles.
//   backward C = D W      rows = samples, columns = the layer's inputs; D in row form
//                         (k = outputs), W in pair form. A finished C is packed into row form
//                         ("next") and pair form (k = samples: "keep").
//   weights  dW^T += X D  rows = inputs, columns = outputs, k = samples: "keep" of the forward pass
//                         times "keep" of the backward pass.
// clang-format on
//
// Arrays of blocks: next [n][blocks], keep [blocks][n], n = 32 samples each, contiguous along k for
// their reader.
#pragma once

#include <cstddef>
#include <cstdint>

namespace redrive::kernels::bf16 {

using Bf16 = std::uint16_t;

constexpr int kBlock = 32;      ///< rows and columns of a block
constexpr int kTileSize = 512;  ///< bf16 of a tile
constexpr int kBlockSize =
    2 * kTileSize;                ///< bf16 of a block in either form; also the floats of a C block
constexpr int kTileFloats = 256;  ///< floats of a quarter of a C block
constexpr int kBiasTile =
    2 * kTileFloats;  ///< floats of 32 biases, each over 16 columns: the left half of a C block

/// Samples summed in one visit of a dW block: 8 blocks of k = 256. A visit moves the block's 4 KiB
/// of fp32 in and out and reads 2 x 16 KiB of operands; longer panels would exceed an L1 of 48 KiB.
constexpr int kWeightGradientBlocks = 8;

}  // namespace redrive::kernels::bf16
