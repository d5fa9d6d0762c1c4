// SPDX-License-Identifier: Apache-2.0
// LASzip's prediction of a LAS point's fields from the points before it, and the decoding of the
// residuals: items POINT10, GPSTIME11, RGB12 and BYTE, each version 2 (M. Isenburg, "LASzip:
// lossless compression of LiDAR data", PE&RS 79(2), 2013). Integers wrap around as in two's
// complement. The state lasts for one chunk.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "redrive/recording/lidar/arithmetic_decoder.h"

namespace redrive {

/// Point format 1 as the file stores it; format 0 without the time.
struct LasRecord {
  std::int32_t x = 0, y = 0, z = 0;  ///< times scale plus offset: metres
  std::uint16_t intensity = 0;
  std::uint8_t returns =
      0;  ///< bits 0-2 number of this return, 3-5 returns of the pulse, 6 scan direction, 7 edge
  std::uint8_t classification = 0, scan_angle = 0, user_data = 0;
  std::uint16_t source_id = 0;
  std::uint64_t gps_time_bits = 0;  ///< bits of the double

  bool operator==(const LasRecord&) const = default;
};

/// LASzip's order-0 coder of integers: decodes the number of bits of a prediction's error, in one
/// of `contexts`, then the error.
class IntegerDecoder {
 public:
  IntegerDecoder(int bits, int contexts);  ///< bits 16 (results in 0..2^16 - 1) or 32 (signed)
  std::int32_t decode(ArithmeticDecoder& decoder, std::uint32_t predicted, int context);
  /// bits of the last error: |error| <= 2^error_bits
  int error_bits() const { return error_bits_; }

 private:
  std::uint32_t mask_;
  int error_bits_ = 0;
  std::vector<SymbolModel> bit_counts_;  ///< [contexts]
  BitModel zero_or_one_;
  std::vector<SymbolModel> errors_;  ///< [bits]: the upper 8 bits of errors of 1..bits bits
};

/// One model of bytes for each previous value of the byte, created on first use.
class ByteModels {
 public:
  SymbolModel& after(std::uint8_t before) {
    if (!models_[before]) models_[before] = std::make_unique<SymbolModel>(256);
    return *models_[before];
  }

 private:
  std::array<std::unique_ptr<SymbolModel>, 256> models_;
};

/// Approximate median of the last values: each new one replaces the largest or the smallest of
/// five, alternately.
class StreamingMedian {
 public:
  std::int32_t get() const { return sorted_[2]; }
  void add(std::int32_t value);

 private:
  std::array<std::int32_t, 5> sorted_{};
  bool drop_largest_ = true;
};

/// Returns the context, 0..15, of a return: from returns of the pulse and number of the return.
int return_context(std::uint8_t returns);

/// Decodes all fields of a point except its time.
class Point10Decoder {
 public:
  explicit Point10Decoder(const LasRecord& first) : last_(first) {}
  LasRecord decode(ArithmeticDecoder& decoder);

 private:
  void decode_changed_fields(ArithmeticDecoder& decoder);

  LasRecord last_;
  std::array<StreamingMedian, 16> dx_, dy_;         ///< one per return_context
  std::array<std::uint16_t, 16> last_intensity_{};  ///< one per return_context
  std::array<std::int32_t, 8> last_z_{};  ///< one per |returns of the pulse - number of the return|
  SymbolModel changed_{64};
  ByteModels returns_, classification_, user_data_;
  std::array<SymbolModel, 2> scan_angle_{SymbolModel(256),
                                         SymbolModel(256)};  ///< one per scan direction
  IntegerDecoder intensity_coder_{16, 4}, source_id_coder_{16, 1}, dx_coder_{32, 2},
      dy_coder_{32, 22}, z_coder_{32, 20};
};

/// Decodes times of up to four interleaved sequences, each with a usual step. The bits of the
/// doubles are treated as integers.
class GpsTimeDecoder {
 public:
  explicit GpsTimeDecoder(std::uint64_t first) { sequences_[0].time = first; }
  std::uint64_t decode(ArithmeticDecoder& decoder);  ///< the bits of the double

 private:
  struct Sequence {
    std::uint64_t time = 0;
    std::int32_t step = 0;
    int odd_steps = 0;  ///< consecutive steps that are no multiple of the usual one
  };
  void decode_step(ArithmeticDecoder& decoder, Sequence& sequence, int multiple);
  void start_sequence(ArithmeticDecoder& decoder);

  std::array<Sequence, 4> sequences_;
  std::size_t current_ = 0, newest_ = 0;
  SymbolModel multiple_{516}, first_step_{6};
  IntegerDecoder coder_{32, 9};
};

/// Decodes bytes whose values are not needed: each has a model of its own, which depends on none.
class ByteSkipper {
 public:
  explicit ByteSkipper(std::size_t bytes) : models_(bytes, SymbolModel(256)) {}
  void skip(ArithmeticDecoder& decoder) {
    for (SymbolModel& model : models_) decoder.symbol(model);
  }

 private:
  std::vector<SymbolModel> models_;
};

/// Decodes colours whose values are not needed. A symbol says which bytes of red, green and blue
/// changed (lower, upper: bits 0 and 1, 2 and 3, 4 and 5) and whether there is more than grey
/// (bit 6); the change of each has a model of its own.
class ColourSkipper {
 public:
  void skip(ArithmeticDecoder& decoder);

 private:
  SymbolModel changed_{128};
  std::vector<SymbolModel> bytes_{6, SymbolModel(256)};
};

}  // namespace redrive
