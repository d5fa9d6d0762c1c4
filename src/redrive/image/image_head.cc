// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/image_head.h"

#include <algorithm>
#include <cmath>
#include <string_view>

#include "redrive/base/files/file_container.h"
#include "redrive/base/files/files.h"
#include "redrive/image/ppm.h"

namespace redrive {
namespace {

using std::string_view;

constexpr std::size_t kUsualHeadBytes = 1 << 12, kHeadBytes = 1 << 18;  // EXIF may be large

/// An unsigned number of `size` bytes; nothing beyond the end.
std::optional<unsigned> number_at(string_view bytes, std::size_t at, int size, bool big_endian) {
  if (at > bytes.size() || bytes.size() - at < static_cast<std::size_t>(size)) return std::nullopt;
  unsigned value = 0;
  for (int i = 0; i < size; ++i) {
    const auto byte = static_cast<unsigned char>(bytes[at + (big_endian ? i : size - 1 - i)]);
    value = value << 8 | byte;
  }
  return value;
}

/// Value of a tag in the directory at `at` of TIFF data: a SHORT, or a LONG where `is_long`.
std::optional<unsigned> tag_value(string_view tiff, std::size_t at, unsigned tag, bool is_long,
                                  bool big_endian) {
  constexpr std::size_t kEntry = 12;
  const auto entries = number_at(tiff, at, 2, big_endian);
  for (std::size_t i = 0; entries && i < *entries; ++i) {
    const std::size_t entry = at + 2 + i * kEntry;
    const auto found = number_at(tiff, entry, 2, big_endian);
    if (!found) return std::nullopt;
    if (*found == tag) return number_at(tiff, entry + 8, is_long ? 4 : 2, big_endian);
  }
  return std::nullopt;
}

/// FocalLengthIn35mmFilm of the TIFF data of an EXIF segment.
std::optional<double> film_focal_mm(string_view tiff) {
  constexpr unsigned kExifDirectory = 0x8769, kFocalLengthIn35mmFilm = 0xA405;
  const bool big_endian = tiff.starts_with("MM");
  const auto first = number_at(tiff, 4, 4, big_endian);
  if (!first) return std::nullopt;
  const auto exif = tag_value(tiff, *first, kExifDirectory, true, big_endian);
  if (!exif) return std::nullopt;
  const auto focal = tag_value(tiff, *exif, kFocalLengthIn35mmFilm, false, big_endian);
  if (!focal || *focal == 0) return std::nullopt;  // 0: unknown
  return static_cast<double>(*focal);
}

std::optional<ImageHead> png_head(string_view bytes) {
  const auto width = number_at(bytes, 16, 4, true), height = number_at(bytes, 20, 4, true),
             type = number_at(bytes, 25, 1, true);
  if (!width || !height || !type) return std::nullopt;
  constexpr unsigned kColour = 2, kPalette = 1;  // bits of the type
  return ImageHead{static_cast<int>(*width), static_cast<int>(*height),
                   (*type & (kColour | kPalette)) == 0, std::nullopt};
}

std::optional<ImageHead> jpeg_head(string_view bytes) {
  constexpr string_view kExif("Exif\0\0", 6);
  std::optional<double> focal;
  for (std::size_t at = 2;;) {
    const auto start = number_at(bytes, at, 1, true), marker = number_at(bytes, at + 1, 1, true),
               length = number_at(bytes, at + 2, 2, true);
    if (!length || *start != 0xFF) return std::nullopt;
    if (*marker == 0xFF) {  // padding
      ++at;
      continue;
    }
    if (*length < 2) return std::nullopt;
    const string_view segment = bytes.substr(at + 4, *length - 2);
    if (*marker == 0xE1 && segment.starts_with(kExif))
      focal = film_focal_mm(segment.substr(kExif.size()));
    // Frames: C0 to CF without the tables C4, CC and the reserved C8.
    if (*marker >= 0xC0 && *marker <= 0xCF && *marker != 0xC4 && *marker != 0xC8 &&
        *marker != 0xCC) {
      const auto height = number_at(segment, 1, 2, true), width = number_at(segment, 3, 2, true),
                 channels = number_at(segment, 5, 1, true);
      if (!channels) return std::nullopt;
      return ImageHead{static_cast<int>(*width), static_cast<int>(*height), *channels == 1, focal};
    }
    at += 2 + *length;
  }
}

}  // namespace

std::optional<double> ImageHead::focal_px() const {
  if (!film_focal_mm) return std::nullopt;
  return *film_focal_mm * std::hypot(width, height) / std::hypot(36.0, 24.0);
}

std::optional<ImageHead> parse_image_head(string_view bytes) {
  std::optional<ImageHead> head;
  if (bytes.starts_with("\x89PNG\r\n\x1a\n")) head = png_head(bytes);
  if (bytes.starts_with("\xFF\xD8")) head = jpeg_head(bytes);
  if (const auto ppm = parse_ppm_head(bytes))
    head = ImageHead{ppm->width, ppm->height, ppm->channels == 1, std::nullopt};
  if (head && (head->width < 1 || head->height < 1)) return std::nullopt;
  return head;
}

std::optional<ImageHead> read_image_head(const std::filesystem::path& path) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(path, error) && !container_of(path)) return std::nullopt;
  if (const auto head = parse_image_head(read_head(path, kUsualHeadBytes))) return head;
  return parse_image_head(read_head(path, kHeadBytes));
}

ImageFileEnds read_image_ends(const std::filesystem::path& path) {
  constexpr string_view kPng("\x89PNG\r\n\x1a\n"), kPngEnd("IEND\xAE\x42\x60\x82"),
      kJpeg("\xFF\xD8"), kJpegEnd("\xFF\xD9");
  const auto [bytes, head, tail] = read_ends(path, kUsualHeadBytes, kPngEnd.size());
  ImageFileEnds ends{bytes, parse_image_head(head), container_of(path) != nullptr};
  if (!ends.head && head.size() == kUsualHeadBytes)
    ends.head = parse_image_head(read_head(path, kHeadBytes));
  ends.has_end = ends.has_end || (head.starts_with(kPng) && tail == kPngEnd) ||
                 (head.starts_with(kJpeg) && tail.ends_with(kJpegEnd));
  return ends;
}

}  // namespace redrive
