// SPDX-License-Identifier: Apache-2.0
// Counter-based random numbers: a value is a function of (seed, stream, counter), so that every
// backend draws the same ones in any order and a resumed run needs only its counters. Mixer: the
// finaliser of SplitMix64 (Steele, Lea, Flood, "Fast splittable pseudorandom number generators",
// 2014).
#pragma once

#include <cstdint>

namespace redrive {

constexpr std::uint64_t mix64(std::uint64_t x) {
  x += 0x9E3779B97F4A7C15ull;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9ull;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBull;
  return x ^ (x >> 31);
}

/// Returns the RNG key of one stream, e.g. random_key(seed, kStreamSamples, step).
constexpr std::uint64_t random_key(std::uint64_t seed, std::uint64_t stream,
                                   std::uint64_t counter = 0) {
  return mix64(mix64(mix64(seed) ^ stream) ^ counter);
}

/// Returns the key whose numbers are the numbers of `key` from index `first` on.
constexpr std::uint64_t advance_key(std::uint64_t key, std::uint64_t first) {
  return key + first * 0xD1342543DE82EF95ull;
}

/// Returns 64 random bits, number `index` of the stream.
constexpr std::uint64_t random_bits(std::uint64_t key, std::uint64_t index) {
  return mix64(advance_key(key, index));
}

/// Uniform in [0, 1), a multiple of 2^-24 (exact in float).
constexpr float random_unit(std::uint64_t key, std::uint64_t index) {
  return static_cast<float>(random_bits(key, index) >> 40) * 0x1p-24f;
}

/// Purposes of the streams; numbers are never reused.
enum RandomStream : std::uint64_t {
  kStreamInit = 1,          ///< network initialisation
  kStreamPixels = 2,        ///< order of training pixels; counter = epoch
  kStreamSamples = 3,       ///< stratified sample jitter; counter = step
  kStreamFineSamples = 4,   ///< hierarchical sampling; counter = step
  kStreamFigures = 5,       ///< choice of the training image that a figure shows
  kStreamBackground = 6,    ///< colour behind transparent pixels; counter = pixels drawn before
  kStreamLidar = 7,         ///< order of LiDAR returns; counter = epochs over them
  kStreamLidarSamples = 8,  ///< sample jitter of LiDAR rays; counter = step
  kStreamErrorRays =
      9,  ///< pixels drawn by the error map; counter = pixels drawn in epoch order before
  kStreamDensify = 10,  ///< which Gaussians are split; counter = step
  kStreamActors = 11,   ///< first Gaussians of moving objects
  kStreamScans = 12,    ///< order of the parts of LiDAR scans
  kStreamReturns = 13,  ///< which rays of a rendered scan return; counter = its first time
  kStreamTest = 99
};

/// Returns the image of `index` under a pseudo-random permutation of [0, size): a 4-round Feistel
/// network on the enclosing power of four with cycle walking, so that an epoch over 10^8 pixels
/// needs no table. Requires index < size, size <= 2^62.
constexpr std::uint64_t permute_index(std::uint64_t key, std::uint64_t index, std::uint64_t size) {
  int half_bits = 1;
  while ((1ull << (2 * half_bits)) < size) ++half_bits;
  const std::uint64_t mask = (1ull << half_bits) - 1;
  do {
    std::uint64_t left = index >> half_bits, right = index & mask;
    for (std::uint64_t round = 0; round < 4; ++round) {
      const std::uint64_t next = left ^ (random_bits(key ^ round, right) & mask);
      left = right;
      right = next;
    }
    index = (left << half_bits) | right;
  } while (index >= size);
  return index;
}

}  // namespace redrive
