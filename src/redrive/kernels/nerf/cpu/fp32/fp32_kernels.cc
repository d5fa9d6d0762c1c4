// SPDX-License-Identifier: Apache-2.0
// Compiled once per instruction set: REDRIVE_ISA names the namespace. -ffp-contract=fast: products
// and sums fuse here.
#include "redrive/kernels/nerf/cpu/fp32/fp32_kernels.h"

#include "redrive/kernels/cpu/simd/vector.h"

namespace redrive::kernels::REDRIVE_ISA {
namespace {

// Register block: kRows x 3 sums, 3 vectors of b and one broadcast. AVX-512 has 32 registers: 8 x 3
// + 4 = 28; AVX2 16: 4 x 3 + 4. Two FMA units of latency 4 need 8 sums in flight; loads an FMA: (8
// + 3) / 24 and (4 + 3) / 12, below one.
constexpr int kRows = kLanes == 16 ? 8 : 4;

/// sum[r][v] += a[r * a_row + k * a_step] * b[k * b_step + v * kLanes] over k < steps.
template <int V>
REDRIVE_INLINE void multiply_add(const float* a, std::ptrdiff_t a_row, std::ptrdiff_t a_step,
                                 const float* b, std::ptrdiff_t b_step, int steps,
                                 Vf (&sum)[kRows][V]) {
  for (int k = 0; k < steps; ++k, a += a_step, b += b_step) {
    Vf column[V];
#pragma GCC unroll 3
    for (int v = 0; v < V; ++v) column[v] = load(b + v * kLanes);
#pragma GCC unroll 8
    for (int r = 0; r < kRows; ++r) {
      const Vf factor = splat(a[r * a_row]);
#pragma GCC unroll 3
      for (int v = 0; v < V; ++v) sum[r][v] += factor * column[v];
    }
  }
}

/// Calls visit(first sample, Panel<V>) for each panel of `samples`.
template <int V>
struct Panel {
  static constexpr int vectors = V, width = V * kLanes;
};
template <class Visit>
REDRIVE_INLINE void for_each_panel(int samples, Visit&& visit) {
  for (int first = 0; first < samples;) {
    const int vectors = panel_vectors((samples - first) / kLanes);
    if (vectors == 3)
      visit(first, Panel<3>{});
    else if (vectors == 2)
      visit(first, Panel<2>{});
    else
      visit(first, Panel<1>{});
    first += vectors * kLanes;
  }
}

template <int V>
void dense_panel(const DenseLayer& layer, std::ptrdiff_t first) {
  constexpr int width = V * kLanes;
  const float* in1 = layer.in1 + first * layer.k1;
  const float* in2 = layer.in2 + first * layer.k2;
  for (int o = 0; o < layer.outputs; o += kRows) {
    Vf sum[kRows][V];
    for (int r = 0; r < kRows; ++r)
      for (int v = 0; v < V; ++v) sum[r][v] = layer.bias ? splat(layer.bias[o + r]) : Vf{};
    const float* weights = layer.weights + std::ptrdiff_t{o} * (layer.k1 + layer.k2);
    multiply_add<V>(weights, 1, kRows, in1, width, layer.k1, sum);
    if (layer.k2 > 0)
      multiply_add<V>(weights + std::ptrdiff_t{layer.k1} * kRows, 1, kRows, in2, width, layer.k2,
                      sum);
    const std::ptrdiff_t at = first * layer.outputs + std::ptrdiff_t{o} * width;
    for (int r = 0; r < kRows; ++r)
      for (int v = 0; v < V; ++v) {
        Vf y = sum[r][v];
        if (layer.relu) y = y < Vf{} ? Vf{} : y;
        if (layer.mask) y = load(layer.mask + at + r * width + v * kLanes) > Vf{} ? y : Vf{};
        store(layer.out + at + r * width + v * kLanes, y);
      }
  }
}

void dense(const DenseLayer& layer, int samples) {
  for_each_panel(samples, [&](int first, auto panel) { dense_panel<panel.vectors>(layer, first); });
}

/// Transposes a square of kLanes vectors: swaps the off-diagonal halves, then quarters, ... of
/// every block.
template <int kHalf = kLanes / 2>
REDRIVE_INLINE void transpose_square(Vf (&row)[kLanes]) {
#pragma GCC unroll 16
  for (int r = 0; r < kLanes; ++r) {
    if (r & kHalf) continue;
    const Vf a = row[r], b = row[r + kHalf];
    row[r] = shuffle(a, b, [](int j) { return j & kHalf ? kLanes + j - kHalf : j; });
    row[r + kHalf] = shuffle(a, b, [](int j) { return j & kHalf ? kLanes + j : j + kHalf; });
  }
  if constexpr (kHalf > 1) transpose_square<kHalf / 2>(row);
}

void transpose(const float* in, int features, int samples, float* out) {
  for (int f = 0; f < features;) {
    const int out_width = panel_vectors((features - f) / kLanes) * kLanes;
    for_each_panel(samples, [&](std::ptrdiff_t first, auto panel) {
      for (int block = 0; block < out_width; block += kLanes)
        for (int v = 0; v < panel.vectors; ++v) {
          Vf square[kLanes];
          const float* from =
              in + first * features + std::ptrdiff_t{f + block} * panel.width + v * kLanes;
          for (int j = 0; j < kLanes; ++j) square[j] = load(from + j * panel.width);
          transpose_square(square);
          float* to = out + std::ptrdiff_t{f} * samples + (first + v * kLanes) * out_width + block;
          for (int j = 0; j < kLanes; ++j) store(to + std::ptrdiff_t{j} * out_width, square[j]);
        }
    });
    f += out_width;
  }
}

template <int V>
void weight_gradient_panel(const WeightGradient& p, int first_input, int samples) {
  constexpr int width = V * kLanes;
  const float* in = p.in_transposed + std::ptrdiff_t{first_input} * samples;
  for (int o = 0; o < p.outputs; o += kRows) {
    float* gradient = p.gradient + o * p.stride + first_input;
    Vf sum[kRows][V];
    for (int r = 0; r < kRows; ++r)
      for (int v = 0; v < V; ++v) sum[r][v] = load(gradient + r * p.stride + v * kLanes);
    for_each_panel(samples, [&](std::ptrdiff_t first, auto panel) {
      const float* d_out = p.d_out + first * p.outputs + std::ptrdiff_t{o} * panel.width;
      multiply_add<V>(d_out, panel.width, 1, in + first * width, width, panel.width, sum);
    });
    for (int r = 0; r < kRows; ++r)
      for (int v = 0; v < V; ++v) store(gradient + r * p.stride + v * kLanes, sum[r][v]);
  }
}

void weight_gradient(const WeightGradient& product, int samples) {
  for_each_panel(product.inputs, [&](int first, auto panel) {
    weight_gradient_panel<panel.vectors>(product, first, samples);
  });
}

void bias_gradient(const float* d_out, int outputs, int samples, float* gradient) {
  for_each_panel(samples, [&](std::ptrdiff_t first, auto panel) {
    const float* row = d_out + first * outputs;
    for (int o = 0; o < outputs; ++o, row += panel.width) {
      Vf s = load(gradient + o * kLanes);
      for (int v = 0; v < panel.vectors; ++v) s += load(row + v * kLanes);
      store(gradient + o * kLanes, s);
    }
  });
}

void encode(const float* point, std::size_t stride, int count, int octaves, int out_rows,
            int samples, float* out) {
  for_each_panel(samples, [&](std::ptrdiff_t first, auto panel) {
    for (int v = 0; v < panel.vectors; ++v) {
      const int n = static_cast<int>(first) + v * kLanes, left = count - n;
      float* to = out + first * out_rows + v * kLanes;
      for (int d = 0; d < 3; ++d) {
        const Vf x = left > 0 ? load_first(point + d * stride + n, left) : Vf{};
        store(to + d * panel.width, x);
        float* octave = to + (3 + 2 * d * octaves) * panel.width;
        Vf sine{}, cosine{};
        for (int l = 0; l < octaves; ++l, octave += 2 * panel.width) {
          if (l == 0 || l == 5) {
            sincos_pi(x * splat(l == 0 ? 1.0f : 32.0f), &sine, &cosine);
          } else {
            const Vf twice = sine + sine, doubled = twice * cosine;
            cosine = splat(1.0f) - twice * sine;
            sine = doubled;
          }
          store(octave, sine);
          store(octave + panel.width, cosine);
        }
      }
      for (int row = 3 + 6 * octaves; row < out_rows; ++row) store(to + row * panel.width, Vf{});
    }
  });
}

void encode_backward(const float* gamma, const float* d1, const float* d2, int octaves, int rows,
                     int samples, int count, float* d_point) {
  for_each_panel(samples, [&](std::ptrdiff_t first, auto panel) {
    for (int v = 0; v < panel.vectors; ++v) {
      const int n = static_cast<int>(first) + v * kLanes, left = count - n;
      if (left <= 0) continue;
      const std::ptrdiff_t at = first * rows + v * kLanes;
      for (int d = 0; d < 3; ++d) {
        Vf sum = load(d1 + at + d * panel.width) + load(d2 + at + d * panel.width);
        float frequency = 3.14159265358979323846f;
        for (int l = 0; l < octaves; ++l, frequency *= 2) {
          const std::ptrdiff_t sine = at + (3 + 2 * (d * octaves + l)) * panel.width,
                               cosine = sine + panel.width;
          const Vf d_sine = load(d1 + sine) + load(d2 + sine),
                   d_cosine = load(d1 + cosine) + load(d2 + cosine);
          sum += splat(frequency) * (load(gamma + cosine) * d_sine - load(gamma + sine) * d_cosine);
        }
        store_first(d_point + std::ptrdiff_t{d} * count + n, sum, left);
      }
    }
  });
}

}  // namespace

extern const Fp32Kernels kFp32Kernels = {kLanes,          kRows,         dense,  transpose,
                                         weight_gradient, bias_gradient, encode, encode_backward};

}  // namespace redrive::kernels::REDRIVE_ISA
