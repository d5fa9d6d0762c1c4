// SPDX-License-Identifier: Apache-2.0
// Inner loops of the fp32 NeRF network as a table of functions, compiled once per instruction set.
// fp32_network.cc calls them and owns the memory.
//
// Panels: the samples of a tile are stored in vectors of `lanes` floats. A row of vectors is cut
// into panels of three; the last ones have two where one would be left over (panel_vectors). A
// matrix [features, samples] is stored panel after panel, each [features, panel width], so that the
// panel a product works on is contiguous: 48 samples x 256 features x 4 bytes = 48 KB, the L1
// cache. A panel that starts at sample n0 is at n0 * features.
#pragma once

#include <cstddef>

namespace redrive::kernels {

/// Vectors of the next panel where `left` are left: 3, but 2 of 2 or 4 and 1 of 1.
static constexpr int panel_vectors(int left) { return left == 4 ? 2 : left < 3 ? left : 3; }

/// out[o] = sum_k weights[o][k] in[k] + bias[o] for each sample; `in` is the first k1 rows from
/// in1, then k2 from in2. weights packed [outputs / rows][k1 + k2][rows]. All matrices in panels.
struct DenseLayer {
  const float* weights = nullptr;
  const float* bias = nullptr;  ///< [outputs], null: 0
  const float* in1 = nullptr;
  const float* in2 = nullptr;  ///< null if k2 == 0
  int k1 = 0, k2 = 0, outputs = 0;
  bool relu = false;  ///< out = max(out, 0); NaN stays NaN
  const float* mask =
      nullptr;  ///< [outputs, samples]: out = 0 where mask <= 0 (the ReLU's adjoint), null: none
  float* out = nullptr;
};

/// gradient[o][i] += sum_n d_out[o][n] in[i][n], row-major with `stride`; `in` as `transpose`
/// leaves it.
struct WeightGradient {
  const float* d_out = nullptr;          ///< [outputs, samples] in panels
  const float* in_transposed = nullptr;  ///< [inputs, samples], transposed
  int outputs = 0, inputs = 0;
  float* gradient = nullptr;
  std::size_t stride = 0;
};

struct Fp32Kernels {
  int lanes;  ///< floats per vector
  int rows;   ///< outputs a register block: every `outputs` above is a multiple
  void (*dense)(const DenseLayer& layer,
                int samples);  ///< samples: a multiple of lanes, here and below
  /// in: [features, samples] in panels; out: panels over the features, each [samples, panel width].
  void (*transpose)(const float* in, int features, int samples, float* out);
  void (*weight_gradient)(const WeightGradient& product, int samples);
  /// gradient[o][lane] += sums of d_out[o] over the vectors of samples.
  void (*bias_gradient)(const float* d_out, int outputs, int samples, float* gradient);
  /// gamma of `count` points, point[d * stride + n], into rows 0 .. 3+6 octaves of out [out_rows,
  /// samples] in panels; the other rows, and the points from `count` on, are 0 (gamma of the
  /// origin, for the latter). sin and cos of octave l+1 follow from octave l (angle doubling),
  /// restarting from the point at octave 5, where the error has grown to 4e-6.
  void (*encode)(const float* point, std::size_t stride, int count, int octaves, int out_rows,
                 int samples, float* out);
  /// positional_encoding_adjoint (field/positional_encoding.h) of gamma as `encode` left it, rows
  /// as out_rows, and the sum of d1 and d2, likewise [rows, samples] in panels: d_point[d * count +
  /// n] for n < count.
  void (*encode_backward)(const float* gamma, const float* d1, const float* d2, int octaves,
                          int rows, int samples, int count, float* d_point);
};

namespace avx2 {
extern const Fp32Kernels kFp32Kernels;
}
namespace avx512 {
extern const Fp32Kernels kFp32Kernels;
}

}  // namespace redrive::kernels
