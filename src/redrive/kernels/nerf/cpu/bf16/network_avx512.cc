// SPDX-License-Identifier: Apache-2.0
// The NeRF network (field/nerf_field.h) on a tile of samples, forward then backward. Layouts:
// simd/bf16_layout.h.
#include "redrive/kernels/nerf/cpu/bf16/head_gradient.h"
#include "redrive/kernels/nerf/cpu/bf16/pass.h"

namespace redrive::kernels::bf16 {
namespace {

template <Epilogue hidden>
void run_forward(const Plan& plan, const Weights& weights, const ChunkMemory& memory,
                 const TileInput& tile, float* raw, int stride) {
  const int samples = tile.n_rays * tile.per_ray, n = (samples + kBlock - 1) / kBlock,
            width = plan.width_blocks;
  const Operand position{memory.position_next, plan.position_blocks, plan.position_blocks};
  const Operand direction{memory.direction_next, plan.direction_blocks, plan.direction_blocks};

  const auto pass_of = [&](int index, const Operand& in, const Operand& extra) {
    const Layer& layer = plan.layers[index];
    Pass pass;
    pass.weights = weights.packed + layer.forward;
    pass.weight_stride = layer.k_blocks;
    pass.in = in;
    pass.extra = extra;
    pass.extra.blocks = layer.extra_blocks;
    pass.out_blocks = layer.out_blocks;
    pass.n_blocks = n;
    pass.bias = weights.bias + layer.bias_tile;
    if (index < kRgb) {
      pass.output.next = memory.next[index % 2];
      pass.output.next_stride = layer.out_blocks;
      pass.output.keep = memory.keep[index];
      pass.output.mask = memory.mask[index];
    }
    return pass;
  };
  const auto to_raw = [&](Pass pass, int first, int rows) {
    pass.output = PassOutput{};
    pass.output.head = raw + std::ptrdiff_t(first) * stride;
    pass.output.head_stride = stride;
    pass.output.head_rows = rows;
    pass.output.head_samples = samples;
    run_pass<Epilogue::kHead>(pass);
  };

  Operand h = position;
  for (int layer = 0; layer < kTrunkLayers; ++layer) {
    run_pass<hidden>(pass_of(layer, h, position));
    h = Operand{memory.next[layer % 2], width, width};
  }
  Pass colour = pass_of(kColour, h, direction);
  colour.out_blocks = plan.colour_blocks;
  colour.output.next_stride = plan.colour_blocks;
  Pass density = colour;  // the last block of outputs, without gamma(d)
  density.extra.blocks = 0;
  density.out_blocks = 1;
  density.weights += std::ptrdiff_t(plan.colour_blocks) * density.weight_stride * kBlockSize;
  density.bias += plan.colour_blocks * kBiasTile;
  run_pass<hidden>(colour);
  to_raw(density, 3, 1);
  h = Operand{memory.next[kColour % 2], plan.colour_blocks, plan.colour_blocks};
  to_raw(pass_of(kRgb, h, Operand{}), 0, 3);
}

struct Gradient {
  Bf16 *next = nullptr, *keep = nullptr;
};

/// The two halves of a layer's adjoint, d = the gradient of its outputs before the activation.
struct Step {
  const Plan& plan;
  const Weights& weights;
  const ChunkMemory& memory;
  int n = 0;

  void weight_gradient(int index, const Gradient& d) const {
    const Layer& layer = plan.layers[index];
    WeightGradient g;
    g.x = index == 0 ? memory.position_keep : memory.keep[index - 1];
    g.x_blocks = layer.in_blocks;
    g.extra = index == kColour ? memory.direction_keep : memory.position_keep;
    g.extra_blocks = layer.extra_blocks;
    g.d = d.keep;
    g.out_blocks = layer.out_blocks;
    g.n_blocks = n;
    g.clear = memory.fresh;
    g.d_weight = memory.d_weight + layer.d_weight;
    add_weight_gradient(g);
  }

  void input_gradient(int index, const Gradient& d, const Gradient& out, int out_stride) const {
    const Layer &layer = plan.layers[index], &before = plan.layers[index - 1];
    Pass pass;
    pass.weights = weights.packed + layer.backward;
    pass.weight_stride = layer.out_blocks;
    pass.in = Operand{d.next, layer.out_blocks, layer.out_blocks};
    pass.out_blocks = layer.in_blocks;
    pass.n_blocks = n;
    pass.output.next = out.next;
    pass.output.next_stride = out_stride;
    pass.output.keep = out.keep;
    pass.output.mask = memory.mask[index - 1];
    pass.output.d_bias = memory.d_bias + before.d_bias;
    run_pass<Epilogue::kMaskedGradient>(pass);
  }

  /// The gradient of gamma(x), the last of the layer's inputs.
  void position_gradient(int index, const Gradient& d, float* d_gamma) const {
    const Layer& layer = plan.layers[index];
    Pass pass;
    pass.weights =
        weights.packed + layer.backward +
        std::ptrdiff_t(layer.k_blocks - plan.position_blocks) * layer.out_blocks * kBlockSize;
    pass.weight_stride = layer.out_blocks;
    pass.in = Operand{d.next, layer.out_blocks, layer.out_blocks};
    pass.out_blocks = plan.position_blocks;
    pass.n_blocks = n;
    pass.output.c = d_gamma;
    pass.output.c_stride = plan.position_blocks;
    run_pass<Epilogue::kInputGradient>(pass);
  }
};

}  // namespace

void forward_tile(const Plan& plan, const Weights& weights, const ChunkMemory& memory,
                  const TileInput& tile, bool keep, float* raw, int stride) {
  encode_tile(plan, memory, tile, keep);
  if (keep) {
    run_forward<Epilogue::kReluKeep>(plan, weights, memory, tile, raw, stride);
  } else {
    run_forward<Epilogue::kRelu>(plan, weights, memory, tile, raw, stride);
  }
}

void backward_tile(const Plan& plan, const Weights& weights, const ChunkMemory& memory, int samples,
                   const float* d_raw, int stride, float* d_position) {
  const int n = (samples + kBlock - 1) / kBlock, width = plan.width_blocks,
            colour = plan.colour_blocks;
  const Layer* layers = plan.layers;
  float* d_bias = memory.d_bias;

  const HeadGradient rgb{d_raw,
                         stride,
                         3,
                         samples,
                         memory.d_rgb_next,
                         1,
                         memory.d_rgb_keep,
                         d_bias + layers[kRgb].d_bias};
  write_head_gradient(rgb);
  // The rgb layer below writes the colour's gradient to d_next[0]; density's follows it.
  Bf16* density_next = memory.d_next[0] + std::ptrdiff_t(colour) * kBlockSize;
  Bf16* density_keep = memory.d_keep[0] + std::ptrdiff_t(colour) * n * kBlockSize;
  const HeadGradient density{d_raw + 3 * std::ptrdiff_t(stride),
                             stride,
                             1,
                             samples,
                             density_next,
                             colour + 1,
                             density_keep,
                             d_bias + layers[kColour].d_bias + colour * kBlock};
  write_head_gradient(density);

  const Gradient d_rgb{memory.d_rgb_next, memory.d_rgb_keep};
  const Gradient even{memory.d_next[0], memory.d_keep[0]}, odd{memory.d_next[1], memory.d_keep[1]};
  const Step step{plan, weights, memory, n};
  step.weight_gradient(kRgb, d_rgb);
  step.input_gradient(kRgb, d_rgb, even, colour + 1);
  for (int layer = kColour; layer > 0; --layer) {
    const bool is_even = layer % 2 == 0;
    step.weight_gradient(layer, is_even ? even : odd);
    if (d_position && layers[layer].backward_blocks > layers[layer].in_blocks)  // the skip
      step.position_gradient(layer, is_even ? even : odd, memory.d_gamma[0]);
    step.input_gradient(layer, is_even ? even : odd, is_even ? odd : even, width);
  }
  static_assert(kColour % 2 == 0);
  step.weight_gradient(0, even);
  if (!d_position) return;
  step.position_gradient(0, even, memory.d_gamma[1]);
  encode_positions_backward(plan, memory, samples, d_position);
}

void multiply_blocks(const Bf16* a, const Bf16* b, int k_blocks, const float* bias, float* c) {
  write_product({a, b, k_blocks, nullptr, nullptr, 0}, bias, c, nullptr);
}

void accumulate_blocks(const Bf16* a, const Bf16* b, int k_blocks, bool clear, float* c) {
  add_product(a, b, k_blocks, clear, c);
}

}  // namespace redrive::kernels::bf16
