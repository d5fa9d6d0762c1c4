// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/bundle/content_id.h"

#include <cstdio>

#include "redrive/base/rng.h"

namespace redrive {

std::uint64_t hash_of(std::string_view bytes, std::uint64_t begin) {
  std::uint64_t hash = begin;
  for (const char byte : bytes) hash = (hash ^ static_cast<unsigned char>(byte)) * 0x100000001b3ull;
  return hash;
}

std::string hash_text(std::uint64_t hash) {
  char text[17];
  std::snprintf(text, sizeof text, "%016llx", static_cast<unsigned long long>(hash));
  return text;
}

std::string uuid_of(std::uint64_t hash) {
  std::string text = hash_text(hash) + hash_text(mix64(hash));
  text[12] = '8';
  text[16] = 'a';
  for (const int at : {20, 16, 12, 8}) text.insert(static_cast<std::size_t>(at), "-");
  return text;
}

}  // namespace redrive
