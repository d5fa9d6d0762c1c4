// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/cpu/folded_colour.h"

#include <algorithm>
#include <cstring>
#include <vector>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

/// Element (i, j) at data[i * row + j * column].
struct Matrix {
  const float* data;
  std::ptrdiff_t row, column;
};

typedef float Vec __attribute__((vector_size(32)));
constexpr int kLanes = 8, kRows = 4, kColumns = 2 * kLanes;
constexpr int kMaxSteps = 512;  // the widest network

/// out[m][n] += sum over k, ascending, of a(m, k) b(k, n) for columns [n, n + 16); rows a multiple
/// of 4. Every network of this backend needs AVX2; without FMA the sums equal plain loops. (SSE2
/// alone takes twice as long: 1 ms a batch.)
[[gnu::target("avx2")]] void add_panel(const Matrix& a, const Matrix& b, int rows, int n, int steps,
                                       float* out, std::ptrdiff_t out_stride) {
  // rows of b, side by side: in place they would compete for the same cache sets
  alignas(32) float panel[kMaxSteps][kColumns];
  for (int k = 0; k < steps; ++k)
    for (int c = 0; c < kColumns; ++c) panel[k][c] = b.data[k * b.row + (n + c) * b.column];
  for (int m = 0; m < rows; m += kRows) {
    const float* a_row = a.data + m * a.row;
    Vec sum[kRows][2] = {};
    for (int k = 0; k < steps; ++k) {
      Vec low, high;
      std::memcpy(&low, panel[k], sizeof low);
      std::memcpy(&high, panel[k] + kLanes, sizeof high);
#pragma GCC unroll 4
      for (int r = 0; r < kRows; ++r) {
        const float x = a_row[r * a.row + k * a.column];
        sum[r][0] += x * low;
        sum[r][1] += x * high;
      }
    }
    for (int r = 0; r < kRows; ++r)
      for (int c = 0; c < kColumns; ++c)
        out[(m + r) * out_stride + n + c] += sum[r][c / kLanes][c % kLanes];
  }
}

/// out += a b; rows a multiple of 4, columns of 16.
void add_product(const Matrix& a, const Matrix& b, int rows, int columns, int steps, float* out,
                 std::ptrdiff_t out_stride, ThreadPool& pool) {
  pool.run_ranges(columns / kColumns, 2, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i)
      add_panel(a, b, rows, static_cast<int>(i) * kColumns, steps, out, out_stride);
  });
}

}  // namespace

FoldedColour::FoldedColour(const NerfConfig& config)
    : config_(config), shape_(nerf_layer(config, kNerfColour)) {
  REDRIVE_CHECK_OP(config.width % 32, ==, 0);
  REDRIVE_CHECK_OP(config.width, <=, kMaxSteps);
  shape_.weight = 0;
  shape_.bias = static_cast<std::size_t>(shape_.outputs) * shape_.inputs;
  parameters_ = Buffer<float>(shape_.bias + shape_.outputs);
  gradients_ = Buffer<float>(parameters_.size());
  feature_ = Buffer<float>(static_cast<std::size_t>(config.width) * config.width);
  feature_bias_ = Buffer<float>(config.width);
  colour_ = Buffer<float>(static_cast<std::size_t>(shape_.outputs) * config.width);
  d_colour_ = Buffer<float>(colour_.size());
}

void FoldedColour::fold(std::span<const float> parameters, ThreadPool& pool) {
  REDRIVE_CHECK_OP(parameters.size(), ==, nerf_parameter_count(config_));
  const int width = config_.width;
  const NerfLayerShape feature = nerf_layer(config_, kNerfFeature),
                       colour = nerf_layer(config_, kNerfColour);
  std::copy_n(&parameters[feature.weight], feature_.size(), feature_.data());
  std::copy_n(&parameters[feature.bias], width, feature_bias_.data());
  pool.run_ranges(shape_.outputs, 16, [&](std::size_t begin, std::size_t end) {
    for (std::size_t o = begin; o < end; ++o) {
      const float* from = &parameters[colour.weight + o * colour.inputs];
      float* row = &parameters_[o * shape_.inputs];
      std::fill_n(row, width, 0.0f);
      std::copy(from + width, from + colour.inputs, row + width);
      std::copy_n(from, width, &colour_[o * width]);
      float bias = parameters[colour.bias + o];
      for (int k = 0; k < width; ++k) bias += from[k] * feature_bias_[k];
      parameters_[shape_.bias + o] = bias;
    }
  });
  add_product({colour_.data(), width, 1}, {feature_.data(), width, 1}, shape_.outputs, width, width,
              parameters_.data(), shape_.inputs, pool);
}

void FoldedColour::unfold(std::span<float> gradients, ThreadPool& pool) {
  REDRIVE_CHECK_OP(gradients.size(), ==, nerf_parameter_count(config_));
  const int width = config_.width;
  const NerfLayerShape feature = nerf_layer(config_, kNerfFeature),
                       colour = nerf_layer(config_, kNerfColour);
  add_product({colour_.data(), 1, width}, {gradients_.data(), shape_.inputs, 1}, width, width,
              shape_.outputs, &gradients[feature.weight], width, pool);
  std::fill_n(d_colour_.data(), d_colour_.size(), 0.0f);
  add_product({gradients_.data(), shape_.inputs, 1}, {feature_.data(), 1, width}, shape_.outputs,
              width, width, d_colour_.data(), width, pool);
  std::vector<float> d_feature_bias(width);
  for (int o = 0; o < shape_.outputs; ++o) {
    const std::size_t first = static_cast<std::size_t>(o) * width;
    const float *row = &colour_[first], *d_feature_part = &d_colour_[first];
    const float* d_folded = &gradients_[static_cast<std::size_t>(o) * shape_.inputs];
    const float g = gradients_[shape_.bias + o];
    float* d_row = &gradients[colour.weight + static_cast<std::size_t>(o) * colour.inputs];
    for (int k = 0; k < width; ++k) {
      d_row[k] += d_feature_part[k] + g * feature_bias_[k];
      d_feature_bias[k] += g * row[k];
    }
    for (int k = width; k < colour.inputs; ++k) d_row[k] += d_folded[k];
    gradients[colour.bias + o] += g;
  }
  for (int k = 0; k < width; ++k) gradients[feature.bias + k] += d_feature_bias[k];
  std::fill_n(gradients_.data(), gradients_.size(), 0.0f);
}

}  // namespace redrive::kernels
