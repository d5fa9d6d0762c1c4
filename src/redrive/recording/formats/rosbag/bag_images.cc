// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/bag_images.h"

#include <algorithm>
#include <iterator>
#include <string_view>

#include <opencv2/imgproc.hpp>

#include "redrive/base/error.h"
#include "redrive/base/opencv_threads.h"
#include "redrive/image/image_io.h"
#include "redrive/image/ppm.h"

namespace redrive::rosbag {
namespace {

constexpr int kCopied = -1;

struct Encoding {
  std::string_view name;
  int channels;    ///< in the message
  int conversion;  ///< cv::ColorConversionCodes to RGB, or kCopied
};
// OpenCV names a Bayer pattern by its second row: rggb is BG.
constexpr Encoding kEncodings[] = {{"rgb8", 3, kCopied},
                                   {"8UC3", 3, cv::COLOR_BGR2RGB},
                                   {"bgr8", 3, cv::COLOR_BGR2RGB},
                                   {"rgba8", 4, cv::COLOR_RGBA2RGB},
                                   {"8UC4", 4, cv::COLOR_BGRA2RGB},
                                   {"bgra8", 4, cv::COLOR_BGRA2RGB},
                                   {"mono8", 1, kCopied},
                                   {"8UC1", 1, kCopied},
                                   {"bayer_rggb8", 1, cv::COLOR_BayerBG2RGB},
                                   {"bayer_bggr8", 1, cv::COLOR_BayerRG2RGB},
                                   {"bayer_gbrg8", 1, cv::COLOR_BayerGR2RGB},
                                   {"bayer_grbg8", 1, cv::COLOR_BayerGB2RGB},
                                   {"yuv422", 2, cv::COLOR_YUV2RGB_UYVY},
                                   {"uyvy", 2, cv::COLOR_YUV2RGB_UYVY},
                                   {"yuv422_yuy2", 2, cv::COLOR_YUV2RGB_YUYV},
                                   {"yuyv", 2, cv::COLOR_YUV2RGB_YUYV}};

const Encoding* find_encoding(const std::string& name) {
  const auto found = std::ranges::find(kEncodings, name, &Encoding::name);
  return found == std::end(kEncodings) ? nullptr : &*found;
}

std::string head_of(const ImageMessage& image, const Encoding& encoding) {
  const bool grey = encoding.conversion == kCopied && encoding.channels == 1;
  return ppm_head_text(static_cast<int>(image.width), static_cast<int>(image.height), grey ? 1 : 3);
}

}  // namespace

bool is_known_encoding(const std::string& encoding) { return find_encoding(encoding) != nullptr; }

std::uint64_t ppm_bytes(const ImageMessage& image) {
  const Encoding& encoding = *find_encoding(image.encoding);
  const bool grey = encoding.conversion == kCopied && encoding.channels == 1;
  return head_of(image, encoding).size() +
         std::uint64_t{image.width} * image.height * (grey ? 1 : 3);
}

std::string as_ppm(const ImageMessage& image, std::size_t most, const std::filesystem::path& file) {
  const Encoding* const encoding = find_encoding(image.encoding);
  if (!encoding) throw InputError(file, "encoding", image.encoding, "is not known");
  const std::uint64_t pixels = std::uint64_t{image.width} * image.height,
                      row = std::uint64_t{image.width} * std::uint64_t(encoding->channels);
  constexpr std::uint32_t kMaxSide = 65536;
  if (pixels == 0 || pixels > std::uint64_t{kMaxImagePixels} ||
      std::max(image.width, image.height) > kMaxSide)
    throw InputError(file, "width, height",
                     std::to_string(image.width) + ", " + std::to_string(image.height),
                     "are 1 to 65536 pixels, 2^28 together at most");
  // Patterns are two pixels wide, and Bayer's two rows high.
  const bool pattern = encoding->conversion != kCopied && encoding->channels < 3;
  if (pattern && (image.width < 2 || image.height < 2 || image.width % 2 != 0))
    throw InputError(file, "width, height", size_text(int(image.width), int(image.height)),
                     "is even, 2 pixels or more, for " + image.encoding);
  if (image.step < row || std::uint64_t{image.step} * image.height > image.size)
    throw InputError(file, "step, data",
                     std::to_string(image.step) + ", " + std::to_string(image.size) + " bytes",
                     "is too short for " + std::to_string(image.height) + " rows of " +
                         std::to_string(row) + " bytes");
  std::string out = head_of(image, *encoding);
  if (most <= out.size()) return out.substr(0, most);
  // Only the rows that are asked for, and two more, of which patterns are interpolated.
  const bool grey = encoding->conversion == kCopied && encoding->channels == 1;
  const std::size_t of_row = std::size_t{image.width} * (grey ? 1 : 3);
  std::size_t rows = image.height;
  if (most - out.size() < of_row * rows) {
    rows = std::min<std::size_t>(rows, (most - out.size()) / of_row + 4);
    rows = std::min<std::size_t>(image.height, rows + rows % 2);
  }
  rows = std::min(rows, image.data.size() / image.step);
  if (rows < (pattern ? 2 : 1)) return out.substr(0, most);
  const cv::Mat from(static_cast<int>(rows), static_cast<int>(image.width),
                     CV_8UC(encoding->channels), const_cast<char*>(image.data.data()), image.step);
  cv::Mat rgb;
  if (encoding->conversion == kCopied)
    rgb = from;
  else
    cv::cvtColor(from, rgb, encoding->conversion);
  for (std::size_t y = 0; y < rows; ++y)
    out.append(reinterpret_cast<const char*>(rgb.ptr(static_cast<int>(y))), of_row);
  if (out.size() > most) out.resize(most);
  return out;
}

}  // namespace redrive::rosbag
