// SPDX-License-Identifier: Apache-2.0
// Converts between the flat fp32 parameters (field/nerf_field.h) and the packed blocks, 32 outputs
// of a layer at a time.
#include "redrive/kernels/cpu/simd/bf16_vector.h"
#include "redrive/kernels/nerf/cpu/bf16/plan.h"

namespace redrive::kernels::bf16 {

void pack_row(const BlockRow& row, const float* parameters, const Weights& weights) {
  for (int o = 0; o < kBlock; o += 2) {
    const float* even = parameters + row.weight + std::ptrdiff_t(o) * row.columns;
    const float* odd = even + row.columns;
    for (int kb = 0; kb < row.k_blocks; ++kb) {
      const int k = kb * kBlock;
      const __mmask16 m0 = first_lanes(row.columns - k), m1 = first_lanes(row.columns - k - 16);
      const __mmask16 has_even = o < row.rows ? 0xffff : 0, has_odd = o + 1 < row.rows ? 0xffff : 0;
      const __m512 even0 = _mm512_maskz_loadu_ps(m0 & has_even, even + k);
      const __m512 even1 = _mm512_maskz_loadu_ps(m1 & has_even, even + k + 16);
      const __m512 odd0 = _mm512_maskz_loadu_ps(m0 & has_odd, odd + k);
      const __m512 odd1 = _mm512_maskz_loadu_ps(m1 & has_odd, odd + k + 16);
      Bf16* forward = weights.packed + row.forward + std::ptrdiff_t(kb) * kBlockSize + o * kBlock;
      store(forward, to_bf16(even0, even1));
      store(forward + kBlock, to_bf16(odd0, odd1));
      if (kb >= row.backward_blocks) continue;
      Bf16* backward = weights.packed + row.backward +
                       std::ptrdiff_t(kb) * row.backward_stride * kBlockSize + o / 2 * kBlock;
      store(backward, to_bf16_pairs(even0, odd0));
      store(backward + kTileSize, to_bf16_pairs(even1, odd1));
    }
  }
  float* bias = weights.bias + row.bias_tile;
  for (int o = 0; o < kBlock; ++o) {
    _mm512_store_ps(bias + o * 16,
                    o < row.rows ? _mm512_set1_ps(parameters[row.bias + o]) : _mm512_setzero_ps());
  }
}

// The C blocks (inputs x outputs) are transposed 16 x 16 in the process.
void reduce_row(const BlockRow& row, const ChunkMemory* const* chunks, int n_chunks,
                float* gradients) {
  for (int quarter = 0; quarter < row.k_blocks * 4; ++quarter) {
    const int k = quarter / 4 * kBlock + quarter / 2 % 2 * 16, o = quarter % 2 * 16;
    const __mmask16 columns = first_lanes(row.columns - k);
    if (!columns || o >= row.rows) continue;
    const std::ptrdiff_t tile =
        static_cast<std::ptrdiff_t>(row.d_weight) + std::ptrdiff_t(quarter) * kTileFloats;
    __m512 sum[16];
    for (int r = 0; r < 16; ++r) sum[r] = _mm512_load_ps(chunks[0]->d_weight + tile + r * 16);
    for (int chunk = 1; chunk < n_chunks; ++chunk) {
      const float* c = chunks[chunk]->d_weight + tile;
      for (int r = 0; r < 16; ++r) sum[r] = _mm512_add_ps(sum[r], _mm512_load_ps(c + r * 16));
    }
    transpose_16x16(sum);
    float* out = gradients + row.weight + std::ptrdiff_t(o) * row.columns + k;
    for (int r = 0; r < 16 && o + r < row.rows; ++r, out += row.columns) {
      _mm512_mask_storeu_ps(out, columns,
                            _mm512_add_ps(_mm512_maskz_loadu_ps(columns, out), sum[r]));
    }
  }
  for (int o = 0; o < row.rows; ++o) {
    float sum = chunks[0]->d_bias[row.d_bias + o];
    for (int chunk = 1; chunk < n_chunks; ++chunk) sum += chunks[chunk]->d_bias[row.d_bias + o];
    gradients[row.bias + o] += sum;
  }
}

}  // namespace redrive::kernels::bf16
