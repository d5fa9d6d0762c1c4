// SPDX-License-Identifier: Apache-2.0
// Cameras of a COLMAP model, as text and as binary: parses any bytes or throws an InputError.
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/camera/camera.h"
#include "redrive/recording/formats/photographs/colmap_files.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  using namespace redrive::colmap;
  for (const auto parse : {parse_cameras_text, parse_cameras_binary}) {
    try {
      for (const auto& record : parse(bytes, "cameras"))
        redrive::make_camera(to_calibration(record, "cameras"));
    } catch (const redrive::InputError&) {
    }
  }
  return 0;
}
