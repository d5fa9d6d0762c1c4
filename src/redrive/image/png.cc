// SPDX-License-Identifier: Apache-2.0
// libpng reports errors by longjmp. Functions that it may leave this way are called within
// PngCodec::guarded, where no object with a destructor is alive.
#include "redrive/image/png.h"

#include <algorithm>
#include <bit>
#include <csetjmp>
#include <cstring>

#include <png.h>
#include <zlib.h>

#include "redrive/base/error.h"
#include "redrive/image/image_io.h"

namespace redrive {
namespace {

/// Deflate writes at least two bits for 258 bytes.
constexpr std::uint64_t kMaxRawPerByte = 258 * 8 / 2;

/// A reader or writer of libpng with the text of its error.
struct PngCodec {
  png_structp png = nullptr;
  png_infop info = nullptr;
  char error[128] = "";

  /// Runs `call`; false if libpng reported an error.
  template <class Call>
  bool guarded(const Call& call) {
    if (setjmp(png_jmpbuf(png)) != 0) return false;
    call();
    return true;
  }
  static void on_error(png_structp png, png_const_charp text) {
    auto* const codec = static_cast<PngCodec*>(png_get_error_ptr(png));
    std::strncpy(codec->error, text, sizeof codec->error - 1);
    png_longjmp(png, 1);
  }
  static void on_warning(png_structp, png_const_charp) {}
};

class PngReader {
 public:
  PngReader(std::string_view bytes, const std::filesystem::path& path)
      : bytes_(bytes), rest_(bytes), path_(path) {
    codec_.png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &codec_, PngCodec::on_error,
                                        PngCodec::on_warning);
    if (codec_.png) codec_.info = png_create_info_struct(codec_.png);
    if (!codec_.info) {
      png_destroy_read_struct(&codec_.png, nullptr, nullptr);
      throw std::bad_alloc();
    }
    png_set_read_fn(codec_.png, &rest_, read);
  }
  ~PngReader() { png_destroy_read_struct(&codec_.png, &codec_.info, nullptr); }
  PngReader(const PngReader&) = delete;
  PngReader& operator=(const PngReader&) = delete;

  void read_header() {
    require([&] { png_read_info(codec_.png, codec_.info); });
    const std::string size = size_text(width(), height());
    if (std::int64_t{width()} * height() > kMaxImagePixels)
      throw InputError(path_, "size", size, "too large");
    if (std::uint64_t{png_get_rowbytes(codec_.png, codec_.info)} * height() >
        kMaxRawPerByte * bytes_.size())
      throw InputError(path_, "size", size,
                       "the PNG is truncated or damaged: its " + std::to_string(bytes_.size()) +
                           " bytes cannot hold so many pixels");
  }
  int width() const { return static_cast<int>(png_get_image_width(codec_.png, codec_.info)); }
  int height() const { return static_cast<int>(png_get_image_height(codec_.png, codec_.info)); }
  bool is_grey16() const {
    return png_get_color_type(codec_.png, codec_.info) == PNG_COLOR_TYPE_GRAY &&
           png_get_bit_depth(codec_.png, codec_.info) == 16;
  }

  /// Configures the conversion of pixels to RGB or RGBA with 8 bits; returns the number of
  /// channels.
  int convert_to_rgb8() {
    require([&] {
      png_set_expand(codec_.png);  // palettes, fewer than 8 bits, tRNS
      png_set_scale_16(codec_.png);
      png_set_gray_to_rgb(codec_.png);
      update();
    });
    return png_get_channels(codec_.png, codec_.info);
  }
  void convert_to_native16() {
    require([&] {
      if constexpr (std::endian::native == std::endian::little) png_set_swap(codec_.png);
      update();
    });
  }

  /// Reads all pixels into [height, row_bytes] and checks that the file is whole.
  void read_pixels(std::uint8_t* pixels, std::size_t row_bytes) {
    REDRIVE_CHECK_OP(png_get_rowbytes(codec_.png, codec_.info), ==, row_bytes);
    std::vector<png_bytep> rows(static_cast<std::size_t>(height()));
    for (std::size_t y = 0; y < rows.size(); ++y) rows[y] = pixels + y * row_bytes;
    require([&] {
      png_read_image(codec_.png, rows.data());
      png_read_end(codec_.png, nullptr);
    });
  }

 private:
  static void read(png_structp png, png_bytep to, std::size_t size) {
    auto* const remaining = static_cast<std::string_view*>(png_get_io_ptr(png));
    if (size > remaining->size()) png_error(png, "the file ends too early");
    std::memcpy(to, remaining->data(), size);
    remaining->remove_prefix(size);
  }
  void update() {
    png_set_interlace_handling(codec_.png);
    png_read_update_info(codec_.png, codec_.info);
  }
  template <class Call>
  void require(const Call& call) {
    if (!codec_.guarded(call))
      throw InputError(path_, "", "",
                       std::string("the PNG is truncated or damaged: ") + codec_.error);
  }

  std::string_view bytes_, rest_;
  const std::filesystem::path& path_;
  PngCodec codec_;
};

void append(png_structp png, png_bytep from, std::size_t size) {
  static_cast<std::string*>(png_get_io_ptr(png))->append(reinterpret_cast<const char*>(from), size);
}

/// `pixels`: [height, width, channels of `colour_type`], 16 bits in native order.
std::string encode(int width, int height, int bits, int colour_type, const std::uint8_t* pixels,
                   std::size_t row_bytes) {
  std::string bytes;
  PngCodec codec;
  codec.png = png_create_write_struct(PNG_LIBPNG_VER_STRING, &codec, PngCodec::on_error,
                                      PngCodec::on_warning);
  if (codec.png) codec.info = png_create_info_struct(codec.png);
  const bool good = codec.info && codec.guarded([&] {
    png_set_write_fn(codec.png, &bytes, append, nullptr);
    // Fast rather than small: runs of equal differences to the left neighbour.
    png_set_filter(codec.png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_set_compression_level(codec.png, Z_BEST_SPEED);
    png_set_compression_strategy(codec.png, Z_RLE);
    png_set_IHDR(codec.png, codec.info, static_cast<png_uint_32>(width),
                 static_cast<png_uint_32>(height), bits, colour_type, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_write_info(codec.png, codec.info);
    if (bits == 16 && std::endian::native == std::endian::little) png_set_swap(codec.png);
    for (int y = 0; y < height; ++y)
      png_write_row(codec.png, pixels + static_cast<std::size_t>(y) * row_bytes);
    png_write_end(codec.png, codec.info);
  });
  png_destroy_write_struct(&codec.png, &codec.info);
  REDRIVE_CHECK(good);
  return bytes;
}

}  // namespace

bool is_png(std::string_view bytes) { return bytes.starts_with("\x89PNG\r\n\x1a\n"); }

Image8 decode_png(std::string_view bytes, const std::filesystem::path& path) {
  PngReader reader(bytes, path);
  reader.read_header();
  const int channels = reader.convert_to_rgb8();
  Image8 image{reader.width(), reader.height(), {}};
  const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
  image.rgb.resize(3 * pixels);
  if (channels == 3) {
    reader.read_pixels(image.rgb.data(), 3u * image.width);
    return image;
  }
  std::vector<std::uint8_t> rgba(4 * pixels);
  reader.read_pixels(rgba.data(), 4u * image.width);
  image.alpha.resize(pixels);
  for (std::size_t i = 0; i < pixels; ++i) {
    std::copy_n(&rgba[4 * i], 3, &image.rgb[3 * i]);
    image.alpha[i] = rgba[4 * i + 3];
  }
  return image;
}

Image16 decode_png16(std::string_view bytes, const std::filesystem::path& path) {
  PngReader reader(bytes, path);
  reader.read_header();
  if (!reader.is_grey16()) throw InputError(path, "", "", "must have one channel of 16 bits");
  reader.convert_to_native16();
  Image16 image{reader.width(), reader.height(), {}};
  image.values.resize(static_cast<std::size_t>(image.width) * image.height);
  reader.read_pixels(reinterpret_cast<std::uint8_t*>(image.values.data()), 2u * image.width);
  return image;
}

std::string encode_png(const Image8& image) {
  const std::size_t pixels = static_cast<std::size_t>(image.width) * image.height;
  REDRIVE_CHECK_OP(image.rgb.size(), ==, 3 * pixels);
  if (image.alpha.empty())
    return encode(image.width, image.height, 8, PNG_COLOR_TYPE_RGB, image.rgb.data(),
                  3u * image.width);
  REDRIVE_CHECK_OP(image.alpha.size(), ==, pixels);
  std::vector<std::uint8_t> rgba(4 * pixels);
  for (std::size_t i = 0; i < pixels; ++i) {
    std::copy_n(&image.rgb[3 * i], 3, &rgba[4 * i]);
    rgba[4 * i + 3] = image.alpha[i];
  }
  return encode(image.width, image.height, 8, PNG_COLOR_TYPE_RGB_ALPHA, rgba.data(),
                4u * image.width);
}

std::string encode_png16(const Image16& image) {
  REDRIVE_CHECK_OP(image.values.size(), ==, std::size_t(image.width) * image.height);
  return encode(image.width, image.height, 16, PNG_COLOR_TYPE_GRAY,
                reinterpret_cast<const std::uint8_t*>(image.values.data()), 2u * image.width);
}

}  // namespace redrive
