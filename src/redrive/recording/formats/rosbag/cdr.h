// SPDX-License-Identifier: Apache-2.0
// Reads values in CDR, the serialisation of ROS 2 messages (DDS-XTypes 1.3, 7.4.1): four bytes that
// name the byte order, then values that are aligned to their sizes from there on.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>

#include "redrive/base/error.h"

namespace redrive::rosbag {

class CdrReader {
 public:
  /// `topic`: for messages. InputError: an encapsulation other than plain CDR.
  CdrReader(std::string_view bytes, const std::filesystem::path& bag, std::string_view topic)
      : bytes_(bytes), bag_(bag), topic_(topic) {
    if (bytes.size() < 4) fail("a message", std::to_string(bytes.size()) + " bytes", "is cut off");
    if (bytes[0] != 0 || (bytes[1] != 0 && bytes[1] != 1))
      fail("encapsulation",
           std::to_string(static_cast<unsigned char>(bytes[0])) + " " +
               std::to_string(static_cast<unsigned char>(bytes[1])),
           "is 0 0 or 0 1, plain CDR");
    swapped_ = bytes[1] == 0;
    bytes_.remove_prefix(4);
  }

  template <class T>
  T number(std::string_view field) {
    at_ = (at_ + sizeof(T) - 1) / sizeof(T) * sizeof(T);
    need(sizeof(T), field);
    char raw[sizeof(T)];
    std::memcpy(raw, bytes_.data() + at_, sizeof(T));
    if (swapped_) std::reverse(raw, raw + sizeof(T));
    at_ += sizeof(T);
    return std::bit_cast<T>(raw);
  }
  std::string_view text(std::string_view field) {
    const std::string_view with_zero = bytes(field);
    return with_zero.substr(0, with_zero.empty() ? 0 : with_zero.size() - 1);
  }
  /// Returns a sequence of bytes; with `cut`, what is there of it.
  std::string_view bytes(std::string_view field, bool cut = false) {
    std::size_t size = length(field);
    if (cut) size = std::min(size, bytes_.size() - at_);
    need(size, field);
    const std::string_view value = bytes_.substr(at_, size);
    at_ += size;
    return value;
  }
  /// Returns the length of a sequence whose items have at least `item` bytes.
  std::size_t count(std::string_view field, std::size_t item) {
    const std::size_t n = length(field);
    if (n > (bytes_.size() - at_) / item)
      fail(field, std::to_string(n) + " items", "is longer than its message");
    return n;
  }
  std::size_t length(std::string_view field) { return number<std::uint32_t>(field); }

  [[noreturn]] void fail(std::string_view field, std::string_view value,
                         std::string_view rule) const {
    throw InputError(bag_, topic_ + " " + std::string(field), value, rule);
  }

 private:
  void need(std::size_t size, std::string_view field) const {
    if (at_ > bytes_.size() || size > bytes_.size() - at_)
      fail(field, std::to_string(size) + " bytes", "is longer than its message");
  }

  std::string_view bytes_;
  const std::filesystem::path& bag_;
  std::string topic_;
  std::size_t at_ = 0;
  bool swapped_ = false;
};

}  // namespace redrive::rosbag
