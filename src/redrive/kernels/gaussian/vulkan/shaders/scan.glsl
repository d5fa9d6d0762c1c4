// SPDX-License-Identifier: Apache-2.0
shared uint s_scan[256];
// Returns the sum of v over the threads before this one; total: over all 256.
uint before_in_group(uint v, out uint total) {
  const uint t = gl_LocalInvocationIndex;
  s_scan[W(0u, t)] = v;
  sync();
  for (uint d = 1u; d < 256u; d <<= 1) {
    const uint x = t >= d ? s_scan[R(0u, t - d)] : 0u;
    sync();
    s_scan[W(0u, t)] += x;
    sync();
  }
  total = s_scan[R(0u, 255u)];
  const uint before = s_scan[R(0u, t)] - v;
  sync();
  return before;
}
