// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/rosbag/unpack.h"

#include <algorithm>
#include <memory>

#include <lz4frame.h>
#include <zstd.h>

namespace redrive::rosbag {
namespace {

/// Appends up to 256 KB at a time to `out`, so that a damaged size costs no memory. `step`
/// decompresses from `in` and says how much it read and wrote; false: damaged.
template <class Step>
bool unpack_by(const Step& step, std::size_t want, const std::function<std::string()>& next,
               std::string* out) {
  constexpr std::size_t kStep = 1 << 18;
  while (out->size() < want) {
    const std::string in = next();
    if (in.empty()) break;
    for (std::size_t read = 0; out->size() < want;) {
      const std::size_t before = out->size(), room = std::min(kStep, want - before);
      out->resize(before + room);
      std::size_t n_in = in.size() - read, n_out = room;
      if (!step(in.data() + read, &n_in, out->data() + before, &n_out)) return false;
      out->resize(before + n_out);
      read += n_in;
      if (read == in.size() && n_out < room) break;
      if (n_in == 0 && n_out == 0) return false;
    }
  }
  return true;
}

}  // namespace

std::optional<std::string> unpack_start(Packing packing, std::size_t want,
                                        const std::function<std::string()>& next) {
  std::string out;
  constexpr std::size_t kMostAtOnce = 16 << 20;  // `want` may be wrong
  out.reserve(std::min(want, kMostAtOnce));
  bool whole = true;
  if (packing == Packing::kNone) {
    while (out.size() < want) {
      const std::string in = next();
      if (in.empty()) break;
      out.append(in, 0, want - out.size());
    }
  } else if (packing == Packing::kLz4) {
    LZ4F_dctx* made = nullptr;
    if (LZ4F_isError(LZ4F_createDecompressionContext(&made, LZ4F_VERSION))) return std::nullopt;
    const std::unique_ptr<LZ4F_dctx, decltype(&LZ4F_freeDecompressionContext)> context(
        made, &LZ4F_freeDecompressionContext);
    whole = unpack_by(
        [&](const char* in, std::size_t* n_in, char* to, std::size_t* n_out) {
          return !LZ4F_isError(LZ4F_decompress(made, to, n_out, in, n_in, nullptr));
        },
        want, next, &out);
  } else {
    const std::unique_ptr<ZSTD_DStream, decltype(&ZSTD_freeDStream)> stream(ZSTD_createDStream(),
                                                                            &ZSTD_freeDStream);
    if (!stream) return std::nullopt;
    ZSTD_DCtx_setParameter(stream.get(), ZSTD_d_windowLogMax, 27);
    whole = unpack_by(
        [&](const char* in, std::size_t* n_in, char* to, std::size_t* n_out) {
          ZSTD_inBuffer from{in, *n_in, 0};
          ZSTD_outBuffer into{to, *n_out, 0};
          if (ZSTD_isError(ZSTD_decompressStream(stream.get(), &into, &from))) return false;
          *n_in = from.pos;
          *n_out = into.pos;
          return true;
        },
        want, next, &out);
  }
  if (!whole) return std::nullopt;
  return out;
}

}  // namespace redrive::rosbag
