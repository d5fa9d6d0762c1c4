// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/cpu/fp32/fp32_chunk.h"

#include <algorithm>
#include <utility>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

/// Calls visit(first sample, width) for each panel.
template <class Visit>
void for_each_panel(int samples, int lanes, Visit visit) {
  for (int first = 0; first < samples;) {
    const int width = panel_vectors((samples - first) / lanes) * lanes;
    visit(first, width);
    first += width;
  }
}

}  // namespace

Fp32Chunk::Fp32Chunk(const Fp32Network& network, int max_samples)
    : network_(network), kernels_(network.kernels_) {
  max_samples_ = (max_samples + kernels_.lanes - 1) / kernels_.lanes * kernels_.lanes;
  const std::size_t n = max_samples_, width = network_.config_.width, rows = kernels_.rows;
  position_ = Buffer<float>(n * network_.position_rows_);
  direction_ = Buffer<float>(n * network_.direction_rows_);
  ray_direction_ = Buffer<float>(n * network_.direction_rows_);  // no more rays than samples
  hidden_[0] = Buffer<float>(n * width);
  hidden_[1] = Buffer<float>(n * width);
  colour_ = Buffer<float>(n * width / 2);
  density_ = Buffer<float>(n * rows);
  rgb_ = Buffer<float>(n * rows);
}

void Fp32Chunk::clear_gradients() {
  if (gradients_.size() == 0) {
    gradients_ = Buffer<float>(network_.gradient_size_);
  } else {
    std::fill_n(gradients_.data(), gradients_.size(), 0.0f);
  }
}

void Fp32Chunk::encode(const NerfTile& tile) {
  const NerfConfig& config = network_.config_;
  kernels_.encode(tile.position, count_, count_, config.position_octaves, network_.position_rows_,
                  samples_, position_.data());
  // Computes gamma(d) once per ray, then copies it to all its samples (the padding repeats the last
  // ray's).
  const int lanes = kernels_.lanes, rows = network_.direction_rows_;
  const int rays = (tile.n_rays + lanes - 1) / lanes * lanes;
  kernels_.encode(tile.direction, tile.n_rays, tile.n_rays, config.direction_octaves, rows, rays,
                  ray_direction_.data());
  int ray = 0, ray_end = tile.per_ray;
  int ray_panel = 0, ray_panel_width = panel_vectors(rays / lanes) * lanes;
  for_each_panel(samples_, lanes, [&](int first, int width) {
    float* out = direction_.data() + static_cast<std::ptrdiff_t>(first) * rows;
    for (int n = 0; n < width;) {
      while (first + n >= ray_end && ray + 1 < tile.n_rays) {
        ++ray;
        ray_end += tile.per_ray;
        if (ray == ray_panel + ray_panel_width) {
          ray_panel = ray;
          ray_panel_width = panel_vectors((rays - ray) / lanes) * lanes;
        }
      }
      const float* from =
          ray_direction_.data() + static_cast<std::ptrdiff_t>(ray_panel) * rows + (ray - ray_panel);
      const int run = ray + 1 < tile.n_rays ? std::min(width - n, ray_end - first - n) : width - n;
      for (int row = 0; row < rows; ++row)
        std::fill_n(out + row * width + n, run, from[row * ray_panel_width]);
      n += run;
    }
  });
}

void Fp32Chunk::dense(int layer, const float* in1, const float* in2, float* out, bool relu) {
  const PackedLayer& l = network_.layers_[layer];
  kernels_.dense({.weights = l.forward.data(),
                  .bias = l.bias.data(),
                  .in1 = in1,
                  .in2 = in2,
                  .k1 = l.k1,
                  .k2 = l.k2,
                  .outputs = l.outputs,
                  .relu = relu,
                  .mask = nullptr,
                  .out = out},
                 samples_);
}

void Fp32Chunk::forward(const NerfTile& tile, bool keep, float* raw, int stride) {
  count_ = tile.samples();
  samples_ = (count_ + kernels_.lanes - 1) / kernels_.lanes * kernels_.lanes;
  REDRIVE_CHECK_OP(samples_, <=, max_samples_);
  REDRIVE_CHECK_OP(count_, >=, 1);
  if (keep && hidden_[2].size() == 0)
    for (int l = 2; l < kNerfHidden; ++l) hidden_[l] = Buffer<float>(hidden_[0].size());
  encode(tile);
  // Two alternating buffers are enough, and stay in the cache, where no backward pass follows.
  const auto hidden = [&](int l) { return hidden_[keep ? l : l % 2].data(); };
  for (int l = 0; l < kNerfHidden; ++l)
    dense(l, l == 0 ? position_.data() : hidden(l - 1), l == kNerfSkip ? position_.data() : nullptr,
          hidden(l), true);
  const float* last = hidden(kNerfHidden - 1);
  dense(kFp32Density, last, nullptr, density_.data(), false);
  dense(kFp32Colour, last, direction_.data(), colour_.data(), true);
  dense(kFp32Rgb, colour_.data(), nullptr, rgb_.data(), false);

  const int rows = kernels_.rows;
  for_each_panel(samples_, kernels_.lanes, [&](int first, int width) {
    const int used = std::min(width, count_ - first);
    for (int k = 0; k < 4; ++k) {
      const float* from = k < 3
                              ? rgb_.data() + static_cast<std::ptrdiff_t>(first) * rows + k * width
                              : density_.data() + static_cast<std::ptrdiff_t>(first) * rows;
      std::copy_n(from, used, raw + static_cast<std::ptrdiff_t>(k) * stride + first);
    }
  });
}

void Fp32Chunk::dense_backward(int layer, const float* d_out1, const float* d_out2,
                               const float* mask, float* d_in) {
  const PackedLayer& l = network_.layers_[layer];
  kernels_.dense({.weights = network_.backward_[layer].data(),
                  .bias = nullptr,
                  .in1 = d_out1,
                  .in2 = d_out2,
                  .k1 = l.outputs,
                  .k2 = d_out2 ? kernels_.rows : 0,
                  .outputs = l.k1,
                  .relu = false,
                  .mask = mask,
                  .out = d_in},
                 samples_);
}

void Fp32Chunk::position_backward(int layer, const float* d_out) {
  const int part = layer == 0;
  kernels_.dense({.weights = network_.position_backward_[part].data(),
                  .bias = nullptr,
                  .in1 = d_out,
                  .in2 = nullptr,
                  .k1 = network_.layers_[layer].outputs,
                  .k2 = 0,
                  .outputs = network_.position_rows_,
                  .relu = false,
                  .mask = nullptr,
                  .out = d_gamma_[part].data()},
                 samples_);
}

void Fp32Chunk::accumulate_part(int layer, const float* d_out, const float* in, int inputs,
                                int first_column) {
  const PackedLayer& l = network_.layers_[layer];
  kernels_.transpose(in, inputs, samples_, transposed_.data());
  kernels_.weight_gradient({.d_out = d_out,
                            .in_transposed = transposed_.data(),
                            .outputs = l.outputs,
                            .inputs = inputs,
                            .gradient = gradients_.data() + l.gradient + first_column,
                            .stride = static_cast<std::size_t>(l.k1 + l.k2)},
                           samples_);
}

void Fp32Chunk::accumulate(int layer, const float* d_out, const float* in1, const float* in2) {
  const PackedLayer& l = network_.layers_[layer];
  accumulate_part(layer, d_out, in1, l.k1, 0);
  if (in2) accumulate_part(layer, d_out, in2, l.k2, l.k1);
  kernels_.bias_gradient(d_out, l.outputs, samples_, gradients_.data() + l.bias_gradient);
}

void Fp32Chunk::backward(const float* d_raw, int stride, float* d_position) {
  const std::size_t n = max_samples_, width = network_.config_.width, rows = kernels_.rows;
  if (transposed_.size() == 0) {
    d_front_ = Buffer<float>(n * width);
    d_back_ = Buffer<float>(n * width);
    d_density_ = Buffer<float>(n * rows);
    d_rgb_ = Buffer<float>(n * rows);
    transposed_ = Buffer<float>(n * std::max<std::size_t>(width, network_.position_rows_));
  }
  if (d_position && d_gamma_[0].size() == 0)
    for (Buffer<float>& d_gamma : d_gamma_) d_gamma = Buffer<float>(position_.size());
  REDRIVE_CHECK(gradients_.size() > 0 && hidden_[2].size() > 0);

  // Rows beyond the outputs and samples beyond the tile are 0 and add nothing.
  std::fill_n(d_density_.data(), samples_ * rows, 0.0f);
  std::fill_n(d_rgb_.data(), samples_ * rows, 0.0f);
  for_each_panel(samples_, kernels_.lanes, [&](int first, int panel) {
    const int used = std::min(panel, count_ - first);
    const std::ptrdiff_t at = static_cast<std::ptrdiff_t>(first) * rows;
    for (int k = 0; k < 3; ++k)
      std::copy_n(d_raw + static_cast<std::ptrdiff_t>(k) * stride + first, used,
                  d_rgb_.data() + at + k * panel);
    std::copy_n(d_raw + static_cast<std::ptrdiff_t>(3) * stride + first, used,
                d_density_.data() + at);
  });

  float *d_out = d_front_.data(), *d_in = d_back_.data();
  const float* last = hidden_[kNerfHidden - 1].data();
  accumulate(kFp32Rgb, d_rgb_.data(), colour_.data(), nullptr);
  dense_backward(kFp32Rgb, d_rgb_.data(), nullptr, colour_.data(), d_out);
  accumulate(kFp32Colour, d_out, last, direction_.data());
  accumulate(kFp32Density, d_density_.data(), last, nullptr);
  dense_backward(kFp32Colour, d_out, d_density_.data(), last, d_in);
  for (int l = kNerfHidden - 1; l >= 0; --l) {
    std::swap(d_out, d_in);
    accumulate(l, d_out, l == 0 ? position_.data() : hidden_[l - 1].data(),
               l == kNerfSkip ? position_.data() : nullptr);
    if (d_position && (l == kNerfSkip || l == 0)) position_backward(l, d_out);
    if (l > 0) dense_backward(l, d_out, nullptr, hidden_[l - 1].data(), d_in);
  }
  if (d_position)
    kernels_.encode_backward(position_.data(), d_gamma_[0].data(), d_gamma_[1].data(),
                             network_.config_.position_octaves, network_.position_rows_, samples_,
                             count_, d_position);
}

}  // namespace redrive::kernels
