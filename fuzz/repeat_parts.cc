// SPDX-License-Identifier: Apache-2.0
// Makes large inputs out of small ones: besides libFuzzer's own mutations, a part of an input,
// often a line, a field or an opening bracket, is repeated. Inputs of many equal records show a
// parser whose time grows with their square, and deep ones a parser that recurses. Linked to each
// target.
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

namespace {

struct Part {
  std::size_t begin, end;
};

/// Returns a separator, what lies between two equal ones with the last of them, or any part.
Part random_part(const std::uint8_t* data, std::size_t size, std::minstd_rand* random) {
  const std::size_t at = (*random)() % size;
  const auto separator = static_cast<std::uint8_t>("\n,[{ <"[(*random)() % 6]);
  const std::uint8_t* const next = std::find(data + at, data + size, separator);
  if (next == data + size) return {at, std::min(size, at + 1 + (*random)() % 64)};
  const auto end = static_cast<std::size_t>(next - data) + 1;
  if ((*random)() % 2 == 0) return {end - 1, end};
  std::size_t begin = at;
  while (begin > 0 && data[begin - 1] != separator) --begin;
  return {begin, end};
}

}  // namespace

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size,
                                               std::size_t max_size, unsigned seed) {
  std::minstd_rand random(seed);
  if (size == 0 || random() % 4 != 0) return LLVMFuzzerMutate(data, size, max_size);
  const auto [begin, end] = random_part(data, size, &random);
  const std::size_t most = (max_size - size) / (end - begin);
  if (most == 0) return LLVMFuzzerMutate(data, size, max_size);
  const std::vector<std::uint8_t> part(data + begin, data + end);
  const std::size_t times = random() % 2 == 0 ? most : 1 + random() % most;
  const std::size_t added = times * part.size();
  std::memmove(data + end + added, data + end, size - end);
  for (std::size_t i = 0; i < times; ++i) std::ranges::copy(part, data + end + i * part.size());
  return size + added;
}
