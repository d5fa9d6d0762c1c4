// SPDX-License-Identifier: Apache-2.0
// The adaptive arithmetic code of LASzip: A. Said, "Introduction to Arithmetic Coding", HP Labs
// 2004 (the coder), M. Isenburg, "LASzip: lossless compression of LiDAR data", PE&RS 79(2), 2013
// (its use). Every constant here is part of the format.
//
// The coder keeps an interval of `length` in 2^24..2^32-1. A model divides it in proportion to the
// frequencies of the symbols so far. The part of the next symbol becomes the interval, and bytes
// are shifted in until its length has 24 bits again.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

namespace redrive {

/// Frequency of zeros of a bit. Probabilities are in units of 2^-13.
class BitModel {
 public:
  static constexpr int kProbabilityBits = 13;
  std::uint32_t zero_probability() const { return zero_probability_; }
  void count(bool bit) {
    zeros_ += !bit;
    if (--until_update_ == 0) update();
  }

 private:
  void update();
  std::uint32_t zeros_ = 1, total_ = 2, zero_probability_ = 1u << (kProbabilityBits - 1),
                cycle_ = 4, until_update_ = 4;
};

/// Frequencies of `size` symbols. Probabilities are in units of 2^-15.
class SymbolModel {
 public:
  static constexpr int kProbabilityBits = 15;
  explicit SymbolModel(std::uint32_t size);

  std::uint32_t size() const { return static_cast<std::uint32_t>(counts_.size()); }
  /// Returns the probability of all symbols below `symbol` (< size()); strictly increasing.
  std::uint32_t cumulative_probability(std::uint32_t symbol) const {
    return cumulative_probabilities_[symbol];
  }
  void count(std::uint32_t symbol) {
    ++counts_[symbol];
    if (--until_update_ == 0) update();
  }

 private:
  void update();
  std::vector<std::uint16_t>
      counts_;  ///< halved by the next update once their sum exceeds 2^15, by at most 4176
  std::vector<std::uint16_t> cumulative_probabilities_;  ///< as of the last update
  std::uint32_t total_ = 0, cycle_ = 0, until_update_ = 0;
};

/// Decodes symbols from `bytes` (which must outlive it). Any bytes can be decoded without harm;
/// broken() tells whether they were a valid code.
class ArithmeticDecoder {
 public:
  explicit ArithmeticDecoder(std::string_view bytes);

  bool bit(BitModel& model);
  std::uint32_t symbol(SymbolModel& model);
  std::uint32_t bits(int n);  ///< n equally likely bits, 1..32

  /// Whether the bytes ended too early, or contain what no encoder writes. Later symbols are
  /// meaningless.
  bool broken() const { return broken_; }
  void refuse() { broken_ = true; }  ///< sets broken: no encoder writes these symbols
  std::size_t bytes_read() const { return position_; }

 private:
  std::uint32_t next_byte();
  void refill();
  std::string_view bytes_;
  std::size_t position_ = 0;
  std::uint32_t value_ = 0;  ///< position of the code in the interval
  std::uint32_t length_ = UINT32_MAX;
  bool broken_ = false;
};

}  // namespace redrive
