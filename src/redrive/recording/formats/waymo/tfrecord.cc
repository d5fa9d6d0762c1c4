// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/waymo/tfrecord.h"

#include <bit>
#include <cstring>
#include <string>

#include <boost/crc.hpp>

#include "redrive/base/error.h"

namespace redrive::waymo {
namespace {

constexpr std::size_t kHeadBytes = 12, kTailBytes = 4;

/// The checksum of TensorFlow: CRC-32C, turned by 15 bits, plus a constant
/// (tensorflow/core/lib/hash/crc32c.h).
std::uint32_t masked_crc(const char* bytes, std::size_t size) {
  boost::crc_optimal<32, 0x1edc6f41, 0xffffffff, 0xffffffff, true, true> crc;
  crc.process_bytes(bytes, size);
  return std::rotr(static_cast<std::uint32_t>(crc.checksum()), 15) + 0xa282ead8u;
}

}  // namespace

std::vector<ByteSpan> list_records(const ByteSource& bytes, const std::filesystem::path& file,
                                   std::vector<DamagedRecord>* damaged) {
  static_assert(std::endian::native == std::endian::little);
  std::vector<ByteSpan> records;
  for (std::uint64_t at = 0; at < bytes.size();) {
    const std::string head = bytes.read(at, kHeadBytes);
    std::uint64_t size = 0;
    std::uint32_t crc = 0;
    if (head.size() == kHeadBytes) {
      std::memcpy(&size, head.data(), sizeof size);
      std::memcpy(&crc, head.data() + sizeof size, sizeof crc);
    }
    const bool is_head = head.size() == kHeadBytes && crc == masked_crc(head.data(), sizeof size);
    if (!is_head && records.empty())
      throw InputError(file, "", "", "is no TFRecord file: the checksum of its start is wrong");
    const std::uint64_t left = bytes.size() - at - head.size();
    if (!is_head || left < kTailBytes || size > left - kTailBytes) {
      damaged->push_back({"frames", std::ssize(records),
                          InputError(file, "record " + std::to_string(records.size()), "",
                                     is_head ? "is cut off" : "the checksum of its length is wrong")
                              .what()});
      break;
    }
    records.push_back({at + kHeadBytes, at + kHeadBytes + size});
    at += kHeadBytes + size + kTailBytes;
  }
  return records;
}

}  // namespace redrive::waymo
