// SPDX-License-Identifier: Apache-2.0
// Points of a COLMAP model, as text and as binary: parses any bytes or throws an InputError, and
// what it parsed comes back from a file that is written of it.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/recording/formats/photographs/colmap_files.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  using namespace redrive::colmap;
  for (const auto parse : {parse_points_text, parse_points_binary}) {
    try {
      const auto points = parse(bytes, "points");
      if (parse_points_binary(make_binary({}, {}, points).points, "").size() != points.size())
        __builtin_trap();
    } catch (const redrive::InputError&) {
    }
  }
  return 0;
}
