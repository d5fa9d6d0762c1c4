// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/gzip.h"

#include <array>
#include <cstdint>
#include <memory>
#include <utility>

#include <zlib.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr int kGzip = 15 + 16;  // the largest window, with gzip's header
constexpr std::size_t kBlock = 1 << 16;

/// Runs deflate or inflate over all of the input. Nothing where that fails, and beyond `most` bytes
/// of output.
template <class Step>
std::optional<std::string> through(z_stream* stream, std::string_view bytes, std::size_t most,
                                   const Step& step) {
  std::string out;
  std::array<char, kBlock> block;
  int code = Z_OK;
  while (code != Z_STREAM_END) {
    if (stream->avail_in == 0 && !bytes.empty()) {
      const std::string_view part = bytes.substr(0, std::size_t{1} << 30);
      stream->next_in = reinterpret_cast<Bytef*>(const_cast<char*>(part.data()));
      stream->avail_in = static_cast<uInt>(part.size());
      bytes.remove_prefix(part.size());
    }
    stream->next_out = reinterpret_cast<Bytef*>(block.data());
    stream->avail_out = kBlock;
    code = step(stream, bytes.empty() ? Z_FINISH : Z_NO_FLUSH);
    // Z_BUF_ERROR without output: the input ends early.
    const std::size_t made = kBlock - stream->avail_out;
    if (code != Z_OK && code != Z_STREAM_END && !(code == Z_BUF_ERROR && made > 0))
      return std::nullopt;
    if (made > most - out.size()) return std::nullopt;
    out.append(block.data(), made);
  }
  return out;
}

}  // namespace

std::string gzip(std::string_view bytes) {
  z_stream stream{};
  REDRIVE_CHECK_OP(deflateInit2(&stream, 9, Z_DEFLATED, kGzip, 9, Z_DEFAULT_STRATEGY), ==, Z_OK);
  const std::unique_ptr<z_stream, decltype(&deflateEnd)> end(&stream, deflateEnd);
  std::optional<std::string> file = through(&stream, bytes, SIZE_MAX, deflate);
  REDRIVE_CHECK(file.has_value());
  return *std::move(file);
}

std::optional<std::string> gunzip_at_most(std::size_t most, std::string_view file) {
  constexpr int kGzipOrZlib = 15 + 32;
  z_stream stream{};
  REDRIVE_CHECK_OP(inflateInit2(&stream, kGzipOrZlib), ==, Z_OK);
  const std::unique_ptr<z_stream, decltype(&inflateEnd)> end(&stream, inflateEnd);
  return through(&stream, file, most, inflate);
}

std::string gunzip(std::string_view file) {
  std::optional<std::string> bytes = gunzip_at_most(SIZE_MAX, file);
  REDRIVE_CHECK(bytes.has_value());
  return *std::move(bytes);
}

}  // namespace redrive
