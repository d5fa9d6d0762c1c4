// SPDX-License-Identifier: Apache-2.0
// Accesses of shared memory. With RACES each access is noted beside the barriers that its thread
// has passed: two threads that touch a word between the same two barriers, one of them writing, are
// counted, whatever the order in which the device has run them. Included behind the push constants,
// which end with SHADOW.
#ifdef RACES
uint epoch = 1u;
const uint kManyThreads = 1023u;
// kind 0: a read, 1: a write, 2: an atomic access. Returns i.
uint touched(uint array, uint i, uint kind, uint line) {
  const uint word = 16u + (gl_WorkGroupID.x % 64u) * 65536u + 2u * (array * 4096u + i);
  const uint me = kind == 2u ? kManyThreads - 1u : gl_LocalInvocationIndex;
  const uint now = epoch << 10, mine = now | me;
  bool race = false;
  if (kind == 0u) {
    const uint writer = shadow.v[word];
    race = (writer & ~1023u) == now && writer != mine;
    const uint reader = atomicExchange(shadow.v[word + 1u], mine);
    if ((reader & ~1023u) == now && reader != mine)
      atomicExchange(shadow.v[word + 1u], now | kManyThreads);
  } else {
    const uint writer = atomicExchange(shadow.v[word], mine), reader = shadow.v[word + 1u];
    race = ((writer & ~1023u) == now && writer != mine) ||
           ((reader & ~1023u) == now && reader != mine);
  }
  if (race && atomicAdd(shadow.v[0], 1u) == 0u) shadow.v[1] = line;
  return i;
}
#define R(array, i) touched(array, i, 0u, uint(__LINE__))
#define W(array, i) touched(array, i, 1u, uint(__LINE__))
#define A(array, i) touched(array, i, 2u, uint(__LINE__))
#define sync() { barrier(); ++epoch; }
#else
#define R(array, i) (i)
#define W(array, i) (i)
#define A(array, i) (i)
#define sync() barrier()
#endif
