// SPDX-License-Identifier: Apache-2.0
// The decoders of LAZ against the encoders in las_testing.h. Real files (lidar_real_test.cc) and a
// file decoded by another program (las_test.cc) guard against mistakes in both.
#include "redrive/recording/lidar/laz_items.h"

#include <numeric>
#include <random>

#include "redrive/recording/core/recording_testing.h"
#include "redrive/recording/lidar/las_testing.h"

namespace redrive {
namespace {

using namespace std::string_view_literals;
using testing::ArithmeticEncoder;

TEST(ArithmeticDecoder, DividesTheIntervalByProbability) {
  // Four equally likely symbols have a quarter of 2^32 each; the first byte of the code selects
  // one.
  for (const auto& [code, expected] : {std::pair{"\x00\x00\x00\x00"sv, 0u},
                                       {"\x3f\x00\x00\x00"sv, 0u},
                                       {"\x40\x00\x00\x00"sv, 1u},
                                       {"\x80\x00\x00\x00"sv, 2u},
                                       {"\xff\x00\x00\x00"sv, 3u}}) {
    SymbolModel model(4);
    ArithmeticDecoder decoder(code);
    EXPECT_EQ(decoder.symbol(model), expected);
    EXPECT_FALSE(decoder.broken());
  }
  ArithmeticDecoder decoder("\xab\x80\x00\x00\x00\x00"sv);
  EXPECT_EQ(decoder.bits(8), 0xabu);
}

TEST(ArithmeticDecoder, ReportsTheEndOfTheCode) {
  EXPECT_TRUE(ArithmeticDecoder("\x12\x34\x56"sv).broken());
  ArithmeticDecoder decoder("\x12\x34\x56\x78\x9a"sv);
  decoder.bits(8);
  EXPECT_FALSE(decoder.broken());
  EXPECT_EQ(decoder.bytes_read(), 5u);
  decoder.bits(8);
  EXPECT_TRUE(decoder.broken());
  EXPECT_TRUE(ArithmeticDecoder("\xff\xff\xff\xff"sv).broken());  // the interval ends before
}

TEST(ArithmeticDecoder, ReachesTheEntropy) {
  // A source of p = 1/16, 15/16 has 0.3373 bits a symbol; one of 1/2, 1/4, 1/8, 1/8 has 1.75.
  // Adaptation costs less than 2 %.
  constexpr int kSymbols = 200000;
  std::mt19937 random(1);
  std::vector<bool> bits;
  std::vector<std::uint32_t> symbols;
  for (int i = 0; i < kSymbols; ++i) {
    const std::uint32_t r = random();
    bits.push_back(r % 16 == 0);
    const std::uint32_t eighth = r >> 29;
    symbols.push_back(eighth < 4 ? 0 : eighth < 6 ? 1 : eighth - 4);
  }
  BitModel bit_model;
  SymbolModel symbol_model(4);
  ArithmeticEncoder bit_encoder, symbol_encoder;
  for (const bool bit : bits) bit_encoder.bit(bit_model, bit);
  for (const std::uint32_t symbol : symbols) symbol_encoder.symbol(symbol_model, symbol);
  const std::string bit_code = bit_encoder.finish(), symbol_code = symbol_encoder.finish();
  EXPECT_NEAR(bit_code.size() * 8.0 / kSymbols, 0.3373, 0.02 * 0.3373);
  EXPECT_NEAR(symbol_code.size() * 8.0 / kSymbols, 1.75, 0.02 * 1.75);

  bit_model = {};
  symbol_model = SymbolModel(4);
  ArithmeticDecoder bit_decoder(bit_code), symbol_decoder(symbol_code);
  for (int i = 0; i < kSymbols; ++i) {
    ASSERT_EQ(bit_decoder.bit(bit_model), bits[static_cast<std::size_t>(i)]) << i;
    ASSERT_EQ(symbol_decoder.symbol(symbol_model), symbols[static_cast<std::size_t>(i)]) << i;
  }
  EXPECT_EQ(bit_decoder.bytes_read(), bit_code.size());
  EXPECT_EQ(symbol_decoder.bytes_read(), symbol_code.size());
  EXPECT_FALSE(bit_decoder.broken() || symbol_decoder.broken());
}

TEST(IntegerDecoder, DecodesErrorsOfEverySize) {
  for (const int bits : {16, 32}) {
    SCOPED_TRACE(bits);
    const std::uint32_t mask = bits == 16 ? 0xffff : 0xffffffff;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> predicted_and_value;
    for (const std::uint32_t predicted :
         {0u, 1u, 1000u, 0x7fffu, 0x8000u, 0xffffu, 0x7fffffffu, 0x80000000u, 0xffffffffu})
      for (int k = 0; k < bits; ++k)
        for (const std::uint32_t error :
             {(1u << k) - 1, 1u << k, (1u << k) + 1, ~(1u << k), -(1u << k), 1u - (1u << k)})
          predicted_and_value.emplace_back(predicted & mask, (predicted + error) & mask);
    testing::IntegerEncoder encoder(bits, 2);
    ArithmeticEncoder out;
    std::vector<int> error_bits;
    for (std::size_t i = 0; i < predicted_and_value.size(); ++i) {
      encoder.encode(out, predicted_and_value[i].first, predicted_and_value[i].second, i % 2);
      error_bits.push_back(encoder.error_bits);
    }
    for (int k = 0; k <= bits; ++k) EXPECT_THAT(error_bits, ::testing::Contains(k));
    const std::string code = out.finish();
    IntegerDecoder integers(bits, 2);
    ArithmeticDecoder decoder(code);
    for (std::size_t i = 0; i < predicted_and_value.size(); ++i) {
      const auto [predicted, value] = predicted_and_value[i];
      ASSERT_EQ(static_cast<std::uint32_t>(integers.decode(decoder, predicted, i % 2)), value) << i;
      ASSERT_EQ(integers.error_bits(), error_bits[i]) << i;
    }
    EXPECT_EQ(decoder.bytes_read(), code.size());
  }
}

TEST(StreamingMedian, ReplacesSmallestAndLargestAlternately) {
  StreamingMedian median;  // 0 0 0 0 0
  const std::pair<int, int> value_and_median[] = {
      {10, 0},    // 0 0 0 0 10, now replaces the smallest
      {10, 0},    // 0 0 0 10 10
      {10, 10},   // 0 0 10 10 10
      {20, 10},   // 0 10 10 10 20
      {-5, 10},   // -5 10 10 10 20: below the median, replaces the largest
      {-7, 10},   // -7 -5 10 10 10
      {-9, -5},   // -9 -7 -5 10 10
      {-5, -5},   // -9 -7 -5 -5 10: not below, replaces the smallest
      {100, -5},  // -7 -5 -5 10 100
      {100, 10},  // -5 -5 10 100 100
  };
  for (const auto& [value, expected] : value_and_median) {
    median.add(value);
    EXPECT_EQ(median.get(), expected) << "after " << value;
  }
}

TEST(GpsTimeDecoder, DecodesEverySymbol) {
  std::vector<std::uint64_t> times{1000};
  const auto step = [&](std::int64_t by) {
    times.push_back(times.back() + static_cast<std::uint64_t>(by));
  };
  const auto jump_to = [&](std::uint64_t time) { times.push_back(time); };
  step(0), step(1000);  // no step yet; the first one
  for (int multiple = -10; multiple <= 500; ++multiple) {
    step(multiple * 1000 + 7);
    step(1000);  // the usual step stays
  }
  step(0);
  for (int i = 0; i < 6; ++i) step(-70000);  // the usual step from the fifth on
  for (int i = 0; i < 6; ++i) step(3);
  for (int i = 0; i < 6; ++i) step(2000), step(1);
  step(INT32_MAX), step(INT32_MIN);
  const std::uint64_t sequences[] = {times.back(), 1ull << 40, 1ull << 50, 0xfedcba9876543210};
  for (const std::uint64_t first : sequences) jump_to(first);  // new ones
  for (const int i : {1, 0, 2, 3})
    jump_to(sequences[i]);  // back and forth while they have no steps
  for (const int i : {0, 2, 1, 3, 0, 1, 2, 3, 2, 1, 0, 3, 1, 0, 2})
    jump_to(sequences[i] + 5), step(100), step(100);
  for (const int i : {0, 2, 1, 3, 0, 1, 2, 3, 2, 1, 0, 3, 1, 0, 2}) jump_to(sequences[i]);
  jump_to(1ull << 60);  // replaces the oldest
  jump_to(sequences[0]);

  testing::GpsTimeEncoder encoder(times[0]);
  ArithmeticEncoder out;
  for (std::size_t i = 1; i < times.size(); ++i) encoder.encode(out, times[i]);
  for (std::size_t symbol = 0; symbol < 516; ++symbol)
    EXPECT_GT(encoder.symbols[symbol], 0) << symbol;
  for (std::size_t symbol = 0; symbol < 6; ++symbol)
    EXPECT_GT(encoder.first_symbols[symbol], 0) << symbol;

  const std::string code = out.finish();
  ArithmeticDecoder decoder(code);
  GpsTimeDecoder decoded(times[0]);
  for (std::size_t i = 1; i < times.size(); ++i) ASSERT_EQ(decoded.decode(decoder), times[i]) << i;
  EXPECT_FALSE(decoder.broken());
  EXPECT_EQ(decoder.bytes_read(), code.size());
}

TEST(GpsTimeDecoder, RejectsCyclesOfSequences) {
  ArithmeticEncoder out;
  SymbolModel first_step(6);
  for (int i = 0; i < 5; ++i) out.symbol(first_step, 3);
  const std::string code = out.finish();
  ArithmeticDecoder decoder(code);
  GpsTimeDecoder times(7);
  times.decode(decoder);
  EXPECT_TRUE(decoder.broken());
}

TEST(ReturnContext, IsUniqueForEachReturnOfAPulse) {
  int expected = 0;
  for (int n = 1; n <= 5; ++n)
    for (int r = 1; r <= n; ++r)
      EXPECT_EQ(return_context(static_cast<std::uint8_t>(n << 3 | r)), expected++);
  EXPECT_EQ(return_context(0), 15);
  EXPECT_EQ(return_context(0xc0 | 1 << 3 | 1), 0);  // scan direction and edge do not matter
}

}  // namespace
}  // namespace redrive
