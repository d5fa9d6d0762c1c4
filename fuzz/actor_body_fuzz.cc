// SPDX-License-Identifier: Apache-2.0
// Bodies of objects, PLY and SPZ: parses any bytes, and any bytes compressed, into Gaussians that
// can be drawn or throws an InputError.
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/base/files/gzip.h"
#include "redrive/edit/actor_body.h"
#include "redrive/field/gaussian.h"

namespace {

void parse(std::string_view bytes) {
  try {
    const redrive::ActorBody body = redrive::parse_actor_body(bytes, "van.ply");
    if (body.n == 0 || !(body.size_m.minCoeff() > 0 && body.size_m.maxCoeff() <= 200))
      __builtin_trap();
    if (body.numbers.size() != redrive::gaussian_blocks(body.n) * redrive::kBlockSize)
      __builtin_trap();
    for (const float number : body.numbers.span())
      if (!std::isfinite(number)) __builtin_trap();
  } catch (const redrive::InputError&) {
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  parse(bytes);
  if (bytes.starts_with("NGSP")) parse(redrive::gzip(bytes));
  return 0;
}
