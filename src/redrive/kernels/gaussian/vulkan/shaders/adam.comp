// SPDX-License-Identifier: Apache-2.0
// GaussianUpdate: Adam (optim/adam.h) with packed moments (optim/packed_moments.h), of drawn
// Gaussians or (ALL) of all whose derivative by the opacity is not 0.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 64) in;
// UpdateParameters of vulkan_gaussian_stages.cc has the same layout.
layout(buffer_reference, std430, buffer_reference_align = 16) buffer Update {
  Floats numbers;
  Words moments;
  Floats errors, gradients, new_errors;
  Words drawn, control;
  uint n, bounded_colours, rows;  // rows: bits
  float beta1, beta2, bias1, bias2, epsilon, min_log_scale, max_log_scale;
  float rates[28];
};
layout(push_constant) uniform Push { Update u; };

bool updates(int row) { return (u.rows >> row & 1u) != 0u; }

void main() {
  uint id = thread_index();
#ifdef ALL
  if (id >= u.n) return;
#else
  if (id >= u.control.v[0] || u.control.v[2] != 0u || u.control.v[3] != 0u) return;
  id = u.drawn.v[id];
#endif
  const uint slot = slot_of(id);
  float g[kGaussianRows];
  bool finite = true;
  for (int row = 0; row < kDistanceRow; ++row)
    if (updates(row)) {
      g[row] = u.gradients.v[slot + row * 16];
      finite = finite && !isnan(g[row]) && !isinf(g[row]);
    }
  if (!finite || g[kOpacityRow] == 0.0) return;
  const float distance = u.numbers.v[slot + kDistanceRow * 16];
  float scale[3];
  for (int row = 0; row < kDistanceRow; ++row) {
    if (!updates(row)) continue;
    const uint at = slot + row * 16, packed = u.moments.v[at];
    precise const float m =
        u.beta1 * uintBitsToFloat(packed & 0xffff0000u) + (1.0 - u.beta1) * g[row];
    precise const float v = u.beta2 * uintBitsToFloat((packed & 0xffffu) << 15) +
                            (1.0 - u.beta2) * g[row] * g[row];
    const float rate = u.rates[row] * (row < kLogScaleRow ? distance : 1.0);
    precise float value =
        u.numbers.v[at] - rate * (m * u.bias1) / (sqrt(v * u.bias2) + u.epsilon);
    if (id / 16u >= u.bounded_colours && row >= kColourRow && row < kHarmonicsRow)
      value = clamp(value, 0.0, 1.0);
    u.moments.v[at] = ((floatBitsToUint(m) + 0x8000u) & 0xffff0000u) |
                      ((floatBitsToUint(v) + 0x4000u) >> 15);
    if (row >= kLogScaleRow && row < kQuaternionRow)
      scale[row - kLogScaleRow] = value;
    else
      u.numbers.v[at] = value;
  }
  u.errors.v[id] += u.new_errors.v[id];
  // The two larger axes stay above the least scale, all below the largest.
  const float log_distance = log(max(distance, 1e-6));
  const float least = u.min_log_scale + log_distance, most = u.max_log_scale + log_distance;
  const float smallest = min(scale[0], min(scale[1], scale[2]));
  for (int k = 0; k < 3; ++k)
    u.numbers.v[slot + (kLogScaleRow + k) * 16] =
        min(scale[k] > smallest ? max(scale[k], least) : scale[k], most);
}
