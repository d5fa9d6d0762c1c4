// SPDX-License-Identifier: Apache-2.0
#include "redrive/image/ppm.h"

#include <charconv>

#include "redrive/base/error.h"

namespace redrive {

std::optional<PpmHead> parse_ppm_head(std::string_view bytes) {
  constexpr int kMaxSide = 65536;
  if (!bytes.starts_with("P6") && !bytes.starts_with("P5")) return std::nullopt;
  const char *at = bytes.data() + 2, *const end = bytes.data() + bytes.size();
  const auto is_space = [](char c) { return c == ' ' || c == '\n' || c == '\t' || c == '\r'; };
  int numbers[3] = {};
  for (int& number : numbers) {
    if (at == end || !is_space(*at)) return std::nullopt;
    while (at != end && is_space(*at)) ++at;
    const auto [next, error] = std::from_chars(at, end, number);
    if (error != std::errc() || number < 1) return std::nullopt;
    at = next;
  }
  if (at == end || !is_space(*at) || numbers[2] != 255) return std::nullopt;
  PpmHead head{numbers[0], numbers[1], bytes[1] == '6' ? 3 : 1,
               static_cast<std::size_t>(at + 1 - bytes.data())};
  if (head.width > kMaxSide || head.height > kMaxSide ||
      std::int64_t{head.width} * head.height > kMaxImagePixels)
    return std::nullopt;
  return head;
}

std::string ppm_head_text(int width, int height, int channels) {
  return (channels == 3 ? "P6\n" : "P5\n") + std::to_string(width) + " " + std::to_string(height) +
         "\n255\n";
}

Image8 decode_ppm(std::string_view bytes, const std::filesystem::path& path) {
  const std::optional<PpmHead> head = parse_ppm_head(bytes);
  if (!head) throw InputError(path, "", "", "is no PPM image of 8 bits");
  const std::string_view pixels = bytes.substr(head->size);
  if (pixels.size() < head->pixel_bytes())
    throw InputError(path, "pixels", std::to_string(pixels.size()) + " bytes",
                     "its size needs " + std::to_string(head->pixel_bytes()));
  Image8 image{head->width, head->height, {}, {}, {}};
  if (head->channels == 3) {
    image.rgb.assign(pixels.begin(), pixels.begin() + std::ptrdiff_t(head->pixel_bytes()));
    return image;
  }
  image.rgb.reserve(3 * head->pixel_bytes());
  for (std::size_t i = 0; i < head->pixel_bytes(); ++i)
    image.rgb.insert(image.rgb.end(), 3, static_cast<std::uint8_t>(pixels[i]));
  return image;
}

}  // namespace redrive
