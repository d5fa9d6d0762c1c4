// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/laz_items.h"

#include <algorithm>
#include <cstdlib>

namespace redrive {
namespace {

constexpr int kUpperBits = 8;  // bits of an error that are modelled; lower bits are nearly random

int number_of_return(std::uint8_t returns) { return returns & 7; }
int returns_of_pulse(std::uint8_t returns) { return returns >> 3 & 7; }
int scan_direction(std::uint8_t returns) { return returns >> 6 & 1; }

std::int32_t wrapped(std::uint32_t value) { return static_cast<std::int32_t>(value); }
std::uint32_t bits_of(std::int32_t value) { return static_cast<std::uint32_t>(value); }

/// Returns the context of an error by the number of bits of the previous errors. Two numbers share
/// a context; single returns have contexts of their own.
int size_context(int error_bits, int most, bool single_return) {
  return (std::min(error_bits, most) & ~1) + single_return;
}

}  // namespace

IntegerDecoder::IntegerDecoder(int bits, int contexts)
    : mask_(bits < 32 ? (1u << bits) - 1 : UINT32_MAX) {
  bit_counts_.assign(static_cast<std::size_t>(contexts),
                     SymbolModel(static_cast<std::uint32_t>(bits) + 1));
  for (int k = 1; k <= bits; ++k) errors_.emplace_back(1u << std::min(k, kUpperBits));
}

std::int32_t IntegerDecoder::decode(ArithmeticDecoder& decoder, std::uint32_t predicted,
                                    int context) {
  const int k = error_bits_ =
      static_cast<int>(decoder.symbol(bit_counts_[static_cast<std::size_t>(context)]));
  std::uint32_t error;
  if (k == 0) {
    error = decoder.bit(zero_or_one_);
  } else if (k == 32) {
    error = 1u << 31;  // the one error that has no smaller k
  } else {
    error = decoder.symbol(errors_[static_cast<std::size_t>(k) - 1]);
    if (k > kUpperBits) error = error << (k - kUpperBits) | decoder.bits(k - kUpperBits);
    // k bits stand for the errors 1 - 2^k .. -2^(k-1) (upper bit 0) and 2^(k-1) + 1 .. 2^k (upper
    // bit 1).
    error = error >> (k - 1) ? error + 1 : error + 1 - (1u << k);
  }
  return wrapped((predicted + error) & mask_);
}

void StreamingMedian::add(std::int32_t value) {
  const std::int32_t median = get();
  // Values on one side of the median replace the extreme of the other side.
  const bool below = drop_largest_ ? value < median : value <= median;
  auto slot = drop_largest_ ? sorted_.end() - 1 : sorted_.begin();
  *slot = value;
  for (; slot != sorted_.begin() && slot[-1] > slot[0]; --slot) std::swap(slot[-1], slot[0]);
  for (; slot != sorted_.end() - 1 && slot[0] > slot[1]; ++slot) std::swap(slot[0], slot[1]);
  drop_largest_ = below;
}

int return_context(std::uint8_t returns) {
  // The r-th of n = 1..5 returns has a context of its own, 0..14. Invalid combinations share them.
  static constexpr std::uint8_t kContext[8][8] = {
      {15, 14, 13, 12, 11, 10, 9, 8},  {14, 0, 1, 3, 6, 10, 10, 9},
      {13, 1, 2, 4, 7, 11, 11, 10},    {12, 3, 4, 5, 8, 12, 12, 11},
      {11, 6, 7, 8, 9, 13, 13, 12},    {10, 10, 11, 12, 13, 14, 14, 13},
      {9, 10, 11, 12, 13, 14, 15, 14}, {8, 9, 10, 11, 12, 13, 14, 15}};
  return kContext[returns_of_pulse(returns)][number_of_return(returns)];
}

void Point10Decoder::decode_changed_fields(ArithmeticDecoder& decoder) {
  const std::uint32_t changed = decoder.symbol(changed_);
  const auto byte_after = [&](ByteModels& models, std::uint8_t before) {
    return static_cast<std::uint8_t>(decoder.symbol(models.after(before)));
  };
  if (changed & 32) last_.returns = byte_after(returns_, last_.returns);
  const int context = return_context(last_.returns);
  std::uint16_t& intensity = last_intensity_[static_cast<std::size_t>(context)];
  if (changed & 16)
    intensity = static_cast<std::uint16_t>(
        intensity_coder_.decode(decoder, intensity, std::min(context, 3)));
  last_.intensity = intensity;
  if (changed & 8) last_.classification = byte_after(classification_, last_.classification);
  if (changed & 4) {
    SymbolModel& model = scan_angle_[static_cast<std::size_t>(scan_direction(last_.returns))];
    last_.scan_angle = static_cast<std::uint8_t>(last_.scan_angle + decoder.symbol(model));
  }
  if (changed & 2) last_.user_data = byte_after(user_data_, last_.user_data);
  if (changed & 1)
    last_.source_id =
        static_cast<std::uint16_t>(source_id_coder_.decode(decoder, last_.source_id, 0));
}

LasRecord Point10Decoder::decode(ArithmeticDecoder& decoder) {
  decode_changed_fields(decoder);
  const bool single = returns_of_pulse(last_.returns) == 1;
  const auto context = static_cast<std::size_t>(return_context(last_.returns));
  const auto level = static_cast<std::size_t>(
      std::abs(returns_of_pulse(last_.returns) - number_of_return(last_.returns)));

  const std::int32_t dx = dx_coder_.decode(decoder, bits_of(dx_[context].get()), single);
  dx_[context].add(dx);
  last_.x = wrapped(bits_of(last_.x) + bits_of(dx));
  const int dx_bits = dx_coder_.error_bits();

  const std::int32_t dy =
      dy_coder_.decode(decoder, bits_of(dy_[context].get()), size_context(dx_bits, 20, single));
  dy_[context].add(dy);
  last_.y = wrapped(bits_of(last_.y) + bits_of(dy));
  const int mean_bits = (dx_bits + dy_coder_.error_bits()) / 2;

  last_.z = last_z_[level] =
      z_coder_.decode(decoder, bits_of(last_z_[level]), size_context(mean_bits, 18, single));
  return last_;
}

// The next time is the last plus a step, predicted as `multiple` of the usual one. Each range of
// multiples has a context. After four steps that fit no multiple, the last becomes the usual one.
void GpsTimeDecoder::decode_step(ArithmeticDecoder& decoder, Sequence& sequence, int multiple) {
  constexpr int kLeast = -10, kMost = 500;
  const int context = multiple == 1       ? 1
                      : multiple == 0     ? 7
                      : multiple == kMost ? 4
                      : multiple >= 10    ? 3
                      : multiple > 0      ? 2
                      : multiple > kLeast ? 5
                                          : 6;
  const std::int32_t step =
      coder_.decode(decoder, bits_of(multiple) * bits_of(sequence.step), context);
  sequence.time += static_cast<std::uint64_t>(std::int64_t{step});
  if (multiple == 1) sequence.odd_steps = 0;
  if ((multiple == 0 || multiple == kLeast || multiple == kMost) && ++sequence.odd_steps > 3) {
    sequence.step = step;
    sequence.odd_steps = 0;
  }
}

// A jump of more than 32 bits: the upper half is predicted, the lower half is stored.
void GpsTimeDecoder::start_sequence(ArithmeticDecoder& decoder) {
  const std::uint32_t upper = bits_of(
      coder_.decode(decoder, static_cast<std::uint32_t>(sequences_[current_].time >> 32), 8));
  const std::uint64_t time = std::uint64_t{upper} << 32 | decoder.bits(32);
  current_ = newest_ = (newest_ + 1) % sequences_.size();
  sequences_[current_] = {.time = time};
}

std::uint64_t GpsTimeDecoder::decode(ArithmeticDecoder& decoder) {
  // Symbols while the sequence has a step: 0 other, 1..500 that multiple of it, 501..510
  // minus 1..10 of it, 511 none, 512 a new sequence, 513..515 one of the other three. While it has
  // none: 0 none, 1 the first step, 2 and 3..5 as 512 and 513..515.
  constexpr int kMostSteps = 500, kNoStep = 511, kNewSequence = 512;
  for (std::size_t switches = 0; switches < sequences_.size(); ++switches) {
    Sequence& sequence = sequences_[current_];
    int symbol = static_cast<int>(decoder.symbol(sequence.step ? multiple_ : first_step_));
    if (sequence.step == 0 && symbol == 1) {
      sequence.step = coder_.decode(decoder, 0, 0);
      sequence.time += static_cast<std::uint64_t>(std::int64_t{sequence.step});
      sequence.odd_steps = 0;
      return sequence.time;
    }
    if (sequence.step == 0) symbol = symbol == 0 ? kNoStep : symbol - 2 + kNewSequence;
    if (symbol == kNewSequence) start_sequence(decoder);
    if (symbol < kNoStep)
      decode_step(decoder, sequence, symbol <= kMostSteps ? symbol : kMostSteps - symbol);
    if (symbol <= kNewSequence) return sequences_[current_].time;
    current_ = (current_ + static_cast<std::size_t>(symbol - kNewSequence)) % sequences_.size();
  }
  decoder.refuse();  // a cycle of sequences
  return 0;
}

void ColourSkipper::skip(ArithmeticDecoder& decoder) {
  constexpr int kMoreThanGrey = 6, kOrder[] = {0, 1, 2, 4, 3, 5};
  const std::uint32_t changed = decoder.symbol(changed_);
  for (const int byte : kOrder)
    if ((byte < 2 || changed >> kMoreThanGrey & 1) && changed >> byte & 1)
      decoder.symbol(bytes_[static_cast<std::size_t>(byte)]);
}

}  // namespace redrive
