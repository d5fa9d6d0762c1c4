// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/gzip.h"

#include <array>
#include <memory>

#include <zlib.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr int kGzip = 15 + 16;  // the largest window, with gzip's header
constexpr std::size_t kBlock = 1 << 16;

/// Runs deflate or inflate over all of the input.
template <class Step>
std::string through(z_stream* stream, std::string_view bytes, const Step& step) {
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
    REDRIVE_CHECK(code == Z_OK || code == Z_STREAM_END || (code == Z_BUF_ERROR && made > 0));
    out.append(block.data(), made);
  }
  return out;
}

}  // namespace

std::string gzip(std::string_view bytes) {
  z_stream stream{};
  REDRIVE_CHECK_OP(deflateInit2(&stream, 9, Z_DEFLATED, kGzip, 9, Z_DEFAULT_STRATEGY), ==, Z_OK);
  const std::unique_ptr<z_stream, decltype(&deflateEnd)> end(&stream, deflateEnd);
  return through(&stream, bytes, deflate);
}

std::string gunzip(std::string_view file) {
  z_stream stream{};
  REDRIVE_CHECK_OP(inflateInit2(&stream, kGzip), ==, Z_OK);
  const std::unique_ptr<z_stream, decltype(&inflateEnd)> end(&stream, inflateEnd);
  return through(&stream, file, inflate);
}

}  // namespace redrive
