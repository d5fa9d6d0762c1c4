// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/image_io.h"

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/image/jpeg.h"
#include "redrive/image/png.h"
#include "redrive/image/ppm.h"

namespace redrive {
namespace {

constexpr int kJpegQuality = 92;

}  // namespace

Image8 read_image(const std::filesystem::path& path) {
  const std::string bytes = read_file(path, kMaxImageBytes);
  if (is_jpeg(bytes)) return decode_jpeg(bytes, path);
  if (is_png(bytes)) return decode_png(bytes, path);
  if (parse_ppm_head(bytes)) return decode_ppm(bytes, path);
  throw InputError(path, "", "",
                   bytes.empty() ? "the file is empty" : "neither a JPEG nor a PNG image");
}

Image16 read_png16(const std::filesystem::path& path) {
  const std::string bytes = read_file(path, kMaxImageBytes);
  if (!is_png(bytes)) throw InputError(path, "", "", "not a PNG image");
  return decode_png16(bytes, path);
}

void write_image(const std::filesystem::path& path, const Image8& image) {
  if (has_extension(path, {".png"}))
    write_file(path, encode_png(image));
  else if (has_extension(path, {".jpg", ".jpeg"}))
    write_file(path, encode_jpeg(image, kJpegQuality));
  else
    throw UsageError("image file", path.string(), "must end in .png, .jpg or .jpeg");
}

void write_png16(const std::filesystem::path& path, const Image16& image) {
  if (!has_extension(path, {".png"}))
    throw UsageError("image file", path.string(), "must end in .png: JPEG has no 16 bits");
  write_file(path, encode_png16(image));
}

std::string size_text(int width, int height) {
  return std::to_string(width) + " x " + std::to_string(height);
}

}  // namespace redrive
