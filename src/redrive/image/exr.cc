// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/exr.h"

#include "redrive/base/error.h"

#ifdef REDRIVE_EXR

#include <cstdlib>
#include <cstring>

#include <tinyexr.h>

#include "redrive/base/files/files.h"

namespace redrive {

std::optional<std::string> exr_obstacle() { return std::nullopt; }

void write_exr(const std::filesystem::path& file, int width, int height,
               std::span<const float> values) {
  REDRIVE_CHECK_OP(values.size(), ==, static_cast<std::size_t>(width) * height);
  EXRHeader header;
  InitEXRHeader(&header);
  EXRChannelInfo channel{};
  std::strcpy(channel.name, "Z");
  int type = TINYEXR_PIXELTYPE_FLOAT;
  header.num_channels = 1;
  header.channels = &channel;
  header.pixel_types = header.requested_pixel_types = &type;
  header.compression_type = TINYEXR_COMPRESSIONTYPE_ZIP;
  EXRImage image;
  InitEXRImage(&image);
  unsigned char* plane = reinterpret_cast<unsigned char*>(const_cast<float*>(values.data()));
  image.num_channels = 1;
  image.images = &plane;
  image.width = width;
  image.height = height;
  unsigned char* memory = nullptr;
  const char* message = nullptr;
  const std::size_t size = SaveEXRImageToMemory(&image, &header, &memory, &message);
  if (size == 0) {
    const std::string why = message ? message : "tinyexr fails";
    FreeEXRErrorMessage(message);
    throw IoError(file, why);
  }
  const std::string bytes(reinterpret_cast<const char*>(memory), size);
  std::free(memory);
  write_file(file, bytes);
}

}  // namespace redrive

#else

namespace redrive {

std::optional<std::string> exr_obstacle() {
  return "this program was built without tinyexr (Debian package libtinyexr-dev)";
}

void write_exr(const std::filesystem::path&, int, int, std::span<const float>) {
  REDRIVE_CHECK(false);
}

}  // namespace redrive

#endif
