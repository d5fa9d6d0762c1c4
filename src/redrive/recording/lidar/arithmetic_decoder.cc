// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/arithmetic_decoder.h"

#include <algorithm>

namespace redrive {
namespace {

constexpr std::uint32_t kMinLength = 1u << 24;
constexpr int kScaleBits = 31;  // probabilities are counts * (2^31 / total), rounded down twice, as
                                // in the encoder

}  // namespace

// Probabilities are updated ever less often: each cycle is 5/4 of the last, up to a limit.
void BitModel::update() {
  constexpr std::uint32_t kMaxTotal = 1u << kProbabilityBits, kMaxCycle = 64;
  total_ += cycle_;
  if (total_ > kMaxTotal) {
    total_ = (total_ + 1) / 2;
    zeros_ = (zeros_ + 1) / 2;
    total_ += zeros_ == total_;
  }
  zero_probability_ = (zeros_ * ((1u << kScaleBits) / total_)) >> (kScaleBits - kProbabilityBits);
  until_update_ = cycle_ = std::min(5 * cycle_ / 4, kMaxCycle);
}

SymbolModel::SymbolModel(std::uint32_t size)
    : counts_(size, 1), cumulative_probabilities_(size), cycle_(size) {
  update();
  until_update_ = cycle_ = (size + 6) / 2;
}

void SymbolModel::update() {
  constexpr std::uint32_t kMaxTotal = 1u << kProbabilityBits;
  total_ += cycle_;
  if (total_ > kMaxTotal) {
    total_ = 0;
    for (std::uint16_t& count : counts_) {
      count = static_cast<std::uint16_t>((count + 1) / 2);
      total_ += count;
    }
  }
  const std::uint32_t scale = (1u << kScaleBits) / total_;
  std::uint32_t below = 0;
  for (std::size_t i = 0; i < counts_.size(); ++i) {
    cumulative_probabilities_[i] =
        static_cast<std::uint16_t>((below * scale) >> (kScaleBits - kProbabilityBits));
    below += counts_[i];
  }
  until_update_ = cycle_ = std::min(5 * cycle_ / 4, 8 * (size() + 6));
}

ArithmeticDecoder::ArithmeticDecoder(std::string_view bytes) : bytes_(bytes) {
  for (int i = 0; i < 4; ++i) value_ = value_ << 8 | next_byte();
  broken_ |= value_ >= length_;
}

std::uint32_t ArithmeticDecoder::next_byte() {
  if (position_ < bytes_.size()) return static_cast<unsigned char>(bytes_[position_++]);
  broken_ = true;
  return 0;
}

void ArithmeticDecoder::refill() {
  while (length_ < kMinLength) {
    value_ = value_ << 8 | next_byte();
    length_ <<= 8;
  }
}

bool ArithmeticDecoder::bit(BitModel& model) {
  const std::uint32_t zero_length =
      model.zero_probability() * (length_ >> BitModel::kProbabilityBits);
  const bool bit = value_ >= zero_length;
  if (bit) {
    value_ -= zero_length;
    length_ -= zero_length;
  } else {
    length_ = zero_length;
  }
  refill();
  model.count(bit);
  return bit;
}

std::uint32_t ArithmeticDecoder::symbol(SymbolModel& model) {
  const std::uint32_t unit = length_ >> SymbolModel::kProbabilityBits;
  // Finds the last symbol whose part begins at or before the value. The last symbol also gets the
  // remainder of rounding.
  std::uint32_t symbol = 0;
  for (std::uint32_t n = model.size(); n > 1;) {
    const std::uint32_t half = n / 2;
    symbol += model.cumulative_probability(symbol + half) * unit <= value_ ? half : 0;
    n -= half;
  }
  const std::uint32_t begin = model.cumulative_probability(symbol) * unit;
  length_ =
      (symbol + 1 < model.size() ? model.cumulative_probability(symbol + 1) * unit : length_) -
      begin;
  value_ -= begin;
  refill();
  model.count(symbol);
  return symbol;
}

std::uint32_t ArithmeticDecoder::bits(int n) {
  constexpr int kMostAtOnce = 19, kLowerHalf = 16;
  if (n > kMostAtOnce) {
    const std::uint32_t lower = bits(kLowerHalf);
    return bits(n - kLowerHalf) << kLowerHalf | lower;
  }
  length_ >>= n;
  const std::uint32_t found = value_ / length_;
  value_ -= found * length_;
  broken_ |= found >> n != 0;
  refill();
  return found & ((1u << n) - 1);
}

}  // namespace redrive
