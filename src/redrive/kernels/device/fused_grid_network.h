// SPDX-License-Identifier: Apache-2.0
// The networks of field/grid_field.h on tensor cores (mma.h): 16 samples pass through all layers in
// a warp's registers, forward and backward, rounded to bf16 between layers. Densities are fp32.
// can_fuse() returns whether the registers hold the activations of a network.
//
// Warps are independent, without blocks or shared memory. The derivatives of the weights need all
// samples together: the layers' inputs and the derivatives of their outputs are written in bf16
// (0.7 KB per sample at width 64) and multiplied by TensorWeightBackward, since sums of 10^4
// weights do not fit into a warp's registers beside its activations. Weights are read tile by tile
// from the first-level cache, which holds all of them (at most 40 KB). A product reads 256 bytes,
// two cycles of the cache, which limits the throughput, not the tensor cores.
#pragma once

#include <array>
#include <bit>
#include <initializer_list>
#include <type_traits>

#include "redrive/kernels/device/grid_fp32_network.h"
#include "redrive/kernels/device/tensor_layers.h"

namespace redrive::kernels {

constexpr int kFusedInputs = 32;
constexpr int kFusedInputTiles = kFusedInputs / kTensorTile;

/// Whether there is a fused network of this shape. Features of a level are read in pairs, one load
/// each.
inline bool can_fuse(const GridFieldConfig& config,
                     std::initializer_list<const float*> read_in_pairs) {
  for (const float* numbers : read_in_pairs)
    if (reinterpret_cast<std::uintptr_t>(numbers) % (2 * sizeof(float)) != 0) return false;
  return config.grid.outputs() == kFusedInputs && config.grid.features_per_level % 2 == 0 &&
         (config.width == 32 || config.width == 64);
}

/// Input of the network as the stage has it, on the device.
struct FusedGridInput {
  std::size_t n;
  int log2_features;  ///< log2 of the features per level
  std::uint32_t per_ray;
  float density_scale;
  const float *features, *harmonics;
  const LanePair *forward[kGridLayers],
      *back[kGridLayers];  ///< packed weights of each layer (tensor_tiles.h)

  /// FeatureLayout::at without a division.
  REDRIVE_HD std::size_t offset(std::size_t sample, int c) const {
    return (((static_cast<std::size_t>(c >> log2_features) * n + sample) << log2_features)) +
           (c & ((1 << log2_features) - 1));
  }
};

/// Returns eight columns of W x from the packed weights of a layer with 16 kTiles inputs;
/// fused_product returns 16.
template <int kTiles>
REDRIVE_HD inline Sums fused_product_8(const OperandA (&x)[kTiles], const LanePair* weights,
                                       int n_tile) {
  Sums sums = zero_sums().half[0];
  REDRIVE_UNROLL
  for (int k = 0; k < kTiles; ++k)
    multiply_add(sums, x[k], load_b(weights + (n_tile * kTiles + k) * kLanes));
  return sums;
}
template <int kTiles>
REDRIVE_HD inline Sums16 fused_product(const OperandA (&x)[kTiles], const LanePair* weights,
                                       int column_tile) {
  return {{fused_product_8(x, weights, 2 * column_tile),
           fused_product_8(x, weights, 2 * column_tile + 1)}};
}

template <int kWidth, int kColourLayers>
struct FusedActivations {
  static constexpr int kWide = kWidth / kTensorTile;

  OperandA features[kFusedInputTiles], hidden[kWide], both[2];  ///< both: geometry, harmonics
  OperandA colour[kColourLayers][kWide];
  float density[kLanesHere][2];  ///< of rows group and group + 8, in the lanes of thread 0

  /// Computes samples first, first + 1, ..., repeating the last sample beyond the end.
  REDRIVE_HD void forward(const FusedGridInput& in, std::size_t first) {
    const std::size_t last_sample = in.n - 1;
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int w = 0; w < 4; ++w) {
        const MatrixPosition at = position_in_a(lane_of(here), w);
        const std::size_t wanted = first + at.row,
                          sample = wanted < last_sample ? wanted : last_sample;
        REDRIVE_UNROLL
        for (int tile = 0; tile < kFusedInputTiles; ++tile) {
          const FloatPair pair =
              load_pair(in.features + in.offset(sample, tile * kTensorTile + at.column));
          features[tile].lane[here].at[w] = bf16_word(pair.first, pair.second);
        }
        const std::uint32_t ray = static_cast<std::uint32_t>(sample) / in.per_ray;
        const FloatPair pair = load_pair(in.harmonics + std::size_t{ray} * kHarmonics + at.column);
        both[1].lane[here].at[w] = bf16_word(pair.first, pair.second);
      }
    }
    layer<kGridDensity0>(in, features, hidden);
    const Sums16 geometry = fused_product(hidden, in.forward[kGridDensity1], 0);
    both[0] = operand_of(geometry);
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int half = 0; half < 2; ++half)
        density[here][half] = grid_density(in.density_scale, geometry.half[0].lane[here][2 * half]);
    }
    layer<kGridColour0>(in, both, colour[0]);
    if constexpr (kColourLayers == 2) layer<kGridColour1>(in, colour[0], colour[1]);
  }

 private:
  template <int kLayer, int kTiles>
  REDRIVE_HD static void layer(const FusedGridInput& in, const OperandA (&x)[kTiles],
                               OperandA (&y)[kWide]) {
    REDRIVE_UNROLL
    for (int tile = 0; tile < kWide; ++tile) {
      Sums16 sums = fused_product(x, in.forward[kLayer], tile);
      rectify(sums);
      y[tile] = operand_of(sums);
    }
  }
};

/// Writes raw [4, n] of 16 samples.
template <int kWidth, int kColourLayers>
struct FusedGridForward {
  FusedGridInput in;
  float* raw;

  REDRIVE_HD void operator()(std::size_t warp) const {
    const std::size_t first = warp * kTensorTile, n = in.n;
    FusedActivations<kWidth, kColourLayers> a;
    a.forward(in, first);
    const Sums colour = fused_product_8(a.colour[kColourLayers - 1], in.forward[kGridColourOut], 0);
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int i = 0; i < 4; ++i) {
        const MatrixPosition at = position_in_sums(lane_of(here), i);
        const std::size_t sample = first + at.row;
        if (sample >= n) continue;
        if (at.column < 3) raw[at.column * n + sample] = colour.lane[here][i];
        if (at.column == 0) raw[3 * n + sample] = a.density[here][i / 2];
      }
    }
  }
};

/// Writes d_features of 16 samples in [begin, end) and the operands of the weights' derivatives
/// (columns only); zeros for samples beyond the end.
template <int kWidth, int kColourLayers>
struct FusedGridBackward {
  FusedGridInput in;
  std::size_t begin, end;
  const float* d_raw;  ///< [4, n]
  float* d_features;   ///< in the layout of features
  TensorActivations features, hidden, both, colour[2], d_hidden, d_geometry, d_colour[2], d_out;

  REDRIVE_HD void operator()(std::size_t tile) const {
    static constexpr int kWide = kWidth / kTensorTile, kLast = kColourLayers - 1;
    const std::size_t first = begin + tile * kTensorTile, n = in.n;
    FusedActivations<kWidth, kColourLayers> a;
    a.forward(in, first);
    keep(features, tile, a.features);
    keep(hidden, tile, a.hidden);
    keep(both, tile, a.both);
    REDRIVE_UNROLL
    for (int l = 0; l < kColourLayers; ++l) keep(colour[l], tile, a.colour[l]);

    OperandA d_rgb[1];
    float d_log_density[kLanesHere][2];
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int w = 0; w < 4; ++w) {
        const MatrixPosition at = position_in_a(lane_of(here), w);
        const std::size_t sample = first + at.row;
        const auto of = [&](int channel) {
          return sample < end ? d_raw[channel * n + sample] : 0.0f;
        };
        d_rgb[0].lane[here].at[w] =
            at.column < 3 ? bf16_word(of(at.column), at.column < 2 ? of(at.column + 1) : 0.0f) : 0;
        if (w < 2) d_log_density[here][w] = at.column == 0 ? of(3) * a.density[here][w] : 0.0f;
      }
    }
    keep(d_out, tile, d_rgb);

    OperandA d[kWide];
    REDRIVE_UNROLL
    for (int t = 0; t < kWide; ++t)
      d[t] = gated(fused_product(d_rgb, in.back[kGridColourOut], t), a.colour[kLast][t]);
    keep(d_colour[kLast], tile, d);
    if constexpr (kColourLayers == 2) {
      OperandA d_0[kWide];
      REDRIVE_UNROLL
      for (int t = 0; t < kWide; ++t)
        d_0[t] = gated(fused_product(d, in.back[kGridColour1], t), a.colour[0][t]);
      REDRIVE_UNROLL
      for (int t = 0; t < kWide; ++t) d[t] = d_0[t];
      keep(d_colour[0], tile, d);
    }
    Sums16 of_geometry = fused_product(d, in.back[kGridColour0], 0);
    for (int here = 0; here < kLanesHere; ++here) {
      REDRIVE_UNROLL
      for (int half = 0; half < 2; ++half)
        of_geometry.half[0].lane[here][2 * half] += d_log_density[here][half];
    }
    const OperandA d_g[1] = {operand_of(of_geometry)};
    keep(d_geometry, tile, d_g);
    REDRIVE_UNROLL
    for (int t = 0; t < kWide; ++t)
      d[t] = gated(fused_product(d_g, in.back[kGridDensity1], t), a.hidden[t]);
    keep(d_hidden, tile, d);
    REDRIVE_UNROLL
    for (int t = 0; t < kFusedInputTiles; ++t) {
      const Sums16 of_features = fused_product(d, in.back[kGridDensity0], t);
      for (int here = 0; here < kLanesHere; ++here) {
        REDRIVE_UNROLL
        for (int half = 0; half < 2; ++half) {
          REDRIVE_UNROLL
          for (int i = 0; i < 4; i += 2) {
            const MatrixPosition at = position_in_sums(lane_of(here), i);
            if (first + at.row >= end) continue;
            store_pair(
                d_features + in.offset(first + at.row, t * kTensorTile + 8 * half + at.column),
                of_features.half[half].lane[here][i], of_features.half[half].lane[here][i + 1]);
          }
        }
      }
    }
  }

 private:
  template <int kTiles>
  REDRIVE_HD static void keep(const TensorActivations& to, std::size_t tile,
                              const OperandA (&x)[kTiles]) {
    REDRIVE_UNROLL
    for (int c = 0; c < kTiles; ++c) to.put(tile, c, x[c]);
  }
  REDRIVE_HD static OperandA gated(Sums16 d, const OperandA& opened) {
    gate(d, opened);
    return operand_of(d);
  }
};

template <class Device>
class FusedGridNetwork {
 public:
  /// Allocates for all samples; the backward pass runs on at most `most` at once. Arguments as in
  /// GridFp32Network.
  FusedGridNetwork(Stage<Device>& stage, const GridNetwork& network, std::size_t n,
                   std::size_t per_ray, std::span<const float> features,
                   std::span<const float> harmonics)
      : stage_(stage), network_(network) {
    REDRIVE_CHECK_OP(n, <, std::size_t{1} << 32);
    in_ = {.n = n,
           .log2_features =
               std::countr_zero(static_cast<unsigned>(network.config.grid.features_per_level)),
           .per_ray = static_cast<std::uint32_t>(per_ray),
           .density_scale = network.density_scale,
           .features = features.data(),
           .harmonics = harmonics.data(),
           .forward = {},
           .back = {}};
    pack(false, in_.forward);
  }

  void forward(std::span<float> raw) {
    with_shape([&](auto width, auto colour_layers) {
      stage_.for_each_warp(tensor_tiles(in_.n),
                           FusedGridForward<width.value, colour_layers.value>{in_, raw.data()});
    });
  }

  /// Adds to gradients and writes d_features; all are on the device.
  void backward(std::size_t most, std::span<const float> d_raw, std::span<float> gradients,
                std::span<float> d_features) {
    pack(true, in_.back);
    const int width = network_.config.width, last = network_.config.colour_layers - 1;
    const auto columns = [&](int numbers) {
      return tensor_activations(stage_, most, numbers, false, true);
    };
    const TensorActivations features = columns(kFusedInputs), hidden = columns(width),
                            both = columns(kGeometryFeatures + kHarmonics),
                            d_hidden = columns(width), d_geometry = columns(kGeometryFeatures),
                            d_out = columns(3);
    TensorActivations colour[2], d_colour[2];
    for (int l = 0; l <= last; ++l) colour[l] = columns(width), d_colour[l] = columns(width);
    const std::span<float> partial =
        stage_.template scratch<float>(slices_of(most) * gradients.size());
    for (std::size_t first = 0; first < in_.n; first += most) {
      const std::size_t count = std::min(most, in_.n - first);
      with_shape([&](auto w, auto colour_layers) {
        stage_.for_each_warp(tensor_tiles(count), FusedGridBackward<w.value, colour_layers.value>{
                                                      .in = in_,
                                                      .begin = first,
                                                      .end = first + count,
                                                      .d_raw = d_raw.data(),
                                                      .d_features = d_features.data(),
                                                      .features = features,
                                                      .hidden = hidden,
                                                      .both = both,
                                                      .colour = {colour[0], colour[1]},
                                                      .d_hidden = d_hidden,
                                                      .d_geometry = d_geometry,
                                                      .d_colour = {d_colour[0], d_colour[1]},
                                                      .d_out = d_out});
      });
      ConcatenatedFunctors<TensorWeightBackward, kGridLayers> weights;
      const auto add = [&](int l, const TensorActivations& x, const TensorActivations& d_y) {
        const LayerLayout layer = grid_layer_layout(network_.config, l);
        const TensorWeightBackward backward{.samples = count,
                                            .outputs = layer.outputs,
                                            .inputs = layer.inputs,
                                            .has_bias = false,
                                            .d_y = d_y,
                                            .first_d_y = 0,
                                            .x = x,
                                            .partial = partial.data() + layer.offset,
                                            .row = gradients.size()};
        weights.add(backward, backward.warps());
      };
      add(kGridDensity0, features, d_hidden);
      add(kGridDensity1, hidden, d_geometry);
      add(kGridColour0, both, d_colour[0]);
      if (last == 1) add(kGridColour1, colour[0], d_colour[1]);
      add(kGridColourOut, colour[last], d_out);
      stage_.for_each_warp(weights.size(), weights);
      reduce_slices(stage_, slices_of(count), gradients.size(), partial.data(), gradients.data());
    }
  }

 private:
  /// Packs all layers. Backward, kGridColour0 is packed for the geometry's inputs only, since
  /// harmonics have no derivative.
  void pack(bool back, const LanePair* (&packed)[kGridLayers]) {
    TensorWeightPacker<Device, kGridLayers> all(stage_);
    for (int l = 0; l < kGridLayers; ++l) {
      const LayerLayout layer = grid_layer_layout(network_.config, l);
      if (layer.size() > 0)
        packed[l] = all.add({.weight = network_.weights.data() + layer.offset,
                             .outputs = layer.outputs,
                             .inputs = back && l == kGridColour0 ? kGeometryFeatures : layer.inputs,
                             .row = layer.inputs,
                             .back = back});
    }
    all.run();
  }

  template <class Visit>
  void with_shape(const Visit& visit) const {
    const auto with_width = [&](auto width) {
      if (network_.config.colour_layers == 2)
        visit(width, std::integral_constant<int, 2>());
      else
        visit(width, std::integral_constant<int, 1>());
    };
    if (network_.config.width == 64)
      with_width(std::integral_constant<int, 64>());
    else
      with_width(std::integral_constant<int, 32>());
  }

  Stage<Device>& stage_;
  GridNetwork network_;  // with weights on the device
  FusedGridInput in_;
};

}  // namespace redrive::kernels
