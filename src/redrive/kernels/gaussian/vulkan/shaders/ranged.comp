// SPDX-License-Identifier: Apache-2.0
// Writes the ranges of pixels into their plane.
#version 460
#extension GL_GOOGLE_include_directive : require
#include "common.glsl"
layout(local_size_x = 256) in;
layout(push_constant) uniform Push {
  Words log_range;
  Words ranged;  // [n] pixel, bits of its range
  uint n;
};
void main() {
  const uint i = thread_index();
  if (i < n) log_range.v[ranged.v[2u * i]] = ranged.v[2u * i + 1u];
}
