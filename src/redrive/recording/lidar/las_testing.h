// SPDX-License-Identifier: Apache-2.0
// Writers of LAS and LAZ files for tests. The LAZ encoders mirror laz_items.h.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <span>
#include <string>
#include <vector>

#include "redrive/recording/lidar/laz_decoder.h"

namespace redrive::testing {

template <class T>
void append(std::string* bytes, T value) {
  bytes->append(reinterpret_cast<const char*>(&value), sizeof value);
}

template <class T>
void overwrite(std::string* bytes, std::size_t offset, T value) {
  std::memcpy(bytes->data() + offset, &value, sizeof value);
}

inline void append(std::string* bytes, const LasRecord& r) {
  append(bytes, r.x), append(bytes, r.y), append(bytes, r.z), append(bytes, r.intensity),
      append(bytes, r.returns);
  append(bytes, r.classification), append(bytes, r.scan_angle), append(bytes, r.user_data),
      append(bytes, r.source_id);
  append(bytes, r.gps_time_bits);
}

/// Returns a LAS 1.2 header of scale 0.001, offset 0 and point format 1, and `variable_records`.
/// The points follow.
inline std::string las_header(std::uint32_t points,
                              const std::vector<std::string>& variable_records = {}) {
  std::string bytes(227, '\0');
  bytes.replace(0, 4, "LASF");
  bytes[24] = 1, bytes[25] = 2;
  overwrite(&bytes, 94, std::uint16_t{227});
  overwrite(&bytes, 100, static_cast<std::uint32_t>(variable_records.size()));
  bytes[104] = 1;
  overwrite(&bytes, 105, std::uint16_t{28});
  overwrite(&bytes, 107, points);
  for (const std::size_t axis : {0, 1, 2}) overwrite(&bytes, 131 + 8 * axis, 0.001);
  for (const std::string& record : variable_records) bytes += record;
  overwrite(&bytes, 96, static_cast<std::uint32_t>(bytes.size()));
  return bytes;
}

inline std::string variable_record(std::string user, std::uint16_t id, const std::string& content) {
  std::string bytes(2, '\0');
  user.resize(16);
  bytes += user;
  append(&bytes, id), append(&bytes, static_cast<std::uint16_t>(content.size()));
  return bytes + std::string(32, ' ') + content;
}

inline std::string las_file(std::span<const LasRecord> points) {
  std::string bytes = las_header(static_cast<std::uint32_t>(points.size()));
  for (const LasRecord& point : points) append(&bytes, point);
  return bytes;
}

class ArithmeticEncoder {
 public:
  void bit(BitModel& model, bool bit) {
    const std::uint32_t zero = model.zero_probability() * (length_ >> BitModel::kProbabilityBits);
    bit ? narrow(zero, length_ - zero) : narrow(0, zero);
    model.count(bit);
  }
  void symbol(SymbolModel& model, std::uint32_t symbol) {
    const std::uint32_t unit = length_ >> SymbolModel::kProbabilityBits,
                        begin = model.cumulative_probability(symbol) * unit;
    const std::uint32_t end =
        symbol + 1 < model.size() ? model.cumulative_probability(symbol + 1) * unit : length_;
    narrow(begin, end - begin);
    model.count(symbol);
  }
  void bits(int n, std::uint32_t value) {
    if (n > 19) {
      bits(16, value & 0xffff);
      return bits(n - 16, value >> 16);
    }
    narrow(value * (length_ >> n), length_ >> n);
  }
  /// Returns the code, of exactly the length that the decoder reads, and ends the encoder.
  std::string finish() {
    // Writes any value in the interval: one byte if it is long, else two. The decoder then reads
    // zeros ahead.
    constexpr std::uint32_t kMinLength = 1u << 24;
    const bool one_byte = length_ > 2 * kMinLength;
    one_byte ? narrow(kMinLength, kMinLength / 2) : narrow(kMinLength / 2, kMinLength / 512);
    return code_ + std::string(one_byte ? 3 : 2, '\0');
  }

 private:
  void narrow(std::uint32_t begin, std::uint32_t length) {
    base_ += begin;
    if (base_ < begin) {  // carry
      std::size_t i = code_.size();
      while (code_[--i] == '\xff') code_[i] = '\0';
      ++code_[i];
    }
    for (length_ = length; length_ < 1u << 24; length_ <<= 8, base_ <<= 8)
      code_ += static_cast<char>(base_ >> 24);
  }
  std::string code_;
  std::uint32_t base_ = 0, length_ = UINT32_MAX;
};

class IntegerEncoder {
 public:
  IntegerEncoder(int bits, int contexts) : bits_(bits) {
    sizes_.assign(static_cast<std::size_t>(contexts),
                  SymbolModel(static_cast<std::uint32_t>(bits) + 1));
    for (int k = 1; k <= bits; ++k) errors_.emplace_back(1u << std::min(k, 8));
  }
  void encode(ArithmeticEncoder& out, std::uint32_t predicted, std::uint32_t value, int context) {
    const int unused = 32 - bits_;  // the error between -2^(bits - 1) and 2^(bits - 1) - 1
    const std::int64_t error = static_cast<std::int32_t>((value - predicted) << unused) >> unused;
    error_bits = std::bit_width(static_cast<std::uint64_t>(error <= 0 ? -error : error - 1));
    out.symbol(sizes_[static_cast<std::size_t>(context)], static_cast<std::uint32_t>(error_bits));
    if (error_bits == 0) return out.bit(zero_or_one_, error != 0);
    if (error_bits == 32) return;
    const auto code = static_cast<std::uint32_t>(
        error < 0 ? error + (std::int64_t{1} << error_bits) - 1 : error - 1);
    const int lower = std::max(error_bits - 8, 0);
    out.symbol(errors_[static_cast<std::size_t>(error_bits) - 1], code >> lower);
    if (lower > 0) out.bits(lower, code & ((1u << lower) - 1));
  }
  int error_bits = 0;

 private:
  int bits_;
  std::vector<SymbolModel> sizes_, errors_;
  BitModel zero_or_one_;
};

class Point10Encoder {
 public:
  explicit Point10Encoder(const LasRecord& first) : last_(first) {}

  void encode(ArithmeticEncoder& out, const LasRecord& r) {
    const int n = r.returns >> 3 & 7, level = std::abs(n - (r.returns & 7)), single = n == 1;
    const auto context = static_cast<std::size_t>(return_context(r.returns));
    std::uint16_t& intensity = intensity_[context];
    out.symbol(changed_, (r.returns != last_.returns) << 5 | (r.intensity != intensity) << 4 |
                             (r.classification != last_.classification) << 3 |
                             (r.scan_angle != last_.scan_angle) << 2 |
                             (r.user_data != last_.user_data) << 1 |
                             (r.source_id != last_.source_id));
    const auto byte = [&](ByteModels& models, std::uint8_t before, std::uint8_t now) {
      if (now != before) out.symbol(models.after(before), now);
    };
    byte(returns_, last_.returns, r.returns);
    if (r.intensity != intensity)
      intensity_coder_.encode(out, intensity, r.intensity,
                              static_cast<int>(std::min<std::size_t>(context, 3)));
    intensity = r.intensity;
    byte(classification_, last_.classification, r.classification);
    if (r.scan_angle != last_.scan_angle)
      out.symbol(angle_[r.returns >> 6 & 1],
                 static_cast<std::uint8_t>(r.scan_angle - last_.scan_angle));
    byte(user_data_, last_.user_data, r.user_data);
    if (r.source_id != last_.source_id) source_id_.encode(out, last_.source_id, r.source_id, 0);

    const auto step = [&](IntegerEncoder& coder, StreamingMedian& median, std::int32_t before,
                          std::int32_t now, int c) {
      const std::uint32_t d = static_cast<std::uint32_t>(now) - static_cast<std::uint32_t>(before);
      coder.encode(out, static_cast<std::uint32_t>(median.get()), d, c);
      median.add(static_cast<std::int32_t>(d));
    };
    step(x_coder_, dx_[context], last_.x, r.x, single);
    step(y_coder_, dy_[context], last_.y, r.y, (std::min(x_coder_.error_bits, 20) & ~1) + single);
    const int mean_bits = (x_coder_.error_bits + y_coder_.error_bits) / 2;
    std::int32_t& z = z_[static_cast<std::size_t>(level)];
    z_coder_.encode(out, static_cast<std::uint32_t>(z), static_cast<std::uint32_t>(r.z),
                    (std::min(mean_bits, 18) & ~1) + single);
    z = r.z;
    last_ = r;
  }

 private:
  LasRecord last_;
  std::array<StreamingMedian, 16> dx_, dy_;
  std::array<std::uint16_t, 16> intensity_{};
  std::array<std::int32_t, 8> z_{};
  SymbolModel changed_{64};
  ByteModels returns_, classification_, user_data_;
  std::array<SymbolModel, 2> angle_{SymbolModel(256), SymbolModel(256)};
  IntegerEncoder intensity_coder_{16, 4}, source_id_{16, 1}, x_coder_{32, 2}, y_coder_{32, 22},
      z_coder_{32, 20};
};

/// `symbols` counts the uses of each symbol, so that a test can check that it covers all.
class GpsTimeEncoder {
 public:
  explicit GpsTimeEncoder(std::uint64_t first) { sequences_[0].time = first; }

  void encode(ArithmeticEncoder& out, std::uint64_t time) {
    Sequence* s = &sequences_[current_];
    if (!fits(time, *s)) {
      for (std::size_t i = 1; i < 4; ++i) {
        if (!fits(time, sequences_[(current_ + i) % 4])) continue;
        put(out, *s, 512 + static_cast<int>(i));
        current_ = (current_ + i) % 4;
        return encode(out, time);
      }
      put(out, *s, 512);
      coder_.encode(out, static_cast<std::uint32_t>(s->time >> 32),
                    static_cast<std::uint32_t>(time >> 32), 8);
      out.bits(32, static_cast<std::uint32_t>(time));
      current_ = newest_ = (newest_ + 1) % 4;
      sequences_[current_] = {time, 0, 0};
      return;
    }
    const auto step = static_cast<std::int32_t>(time - s->time);
    s->time = time;
    if (step == 0) return put(out, *s, 511);
    if (s->step == 0) {
      put(out, *s, 1);
      coder_.encode(out, 0, static_cast<std::uint32_t>(step), 0);
      s->step = step;
      s->odd = 0;
      return;
    }
    const int multiple =
        static_cast<int>(std::clamp(std::round(double(step) / s->step), -10.0, 500.0));
    put(out, *s, multiple >= 0 ? multiple : 500 - multiple);
    const int contexts[] = {6, 5, 7, 1, 2, 3, 4};
    const int lowest[] = {-10, -9, 0, 1, 2, 10, 500};
    const int range = static_cast<int>(std::upper_bound(lowest, lowest + 7, multiple) - lowest) - 1;
    coder_.encode(out, static_cast<std::uint32_t>(multiple) * static_cast<std::uint32_t>(s->step),
                  static_cast<std::uint32_t>(step), contexts[range]);
    if (multiple == 1) s->odd = 0;
    if ((multiple == 0 || multiple == -10 || multiple == 500) && ++s->odd > 3)
      s->step = step, s->odd = 0;
  }
  std::array<int, 516> symbols{};
  std::array<int, 6> first_symbols{};

 private:
  struct Sequence {
    std::uint64_t time = 0;
    std::int32_t step = 0;
    int odd = 0;
  };
  static bool fits(std::uint64_t time, const Sequence& s) {
    return static_cast<std::int64_t>(time - s.time) == static_cast<std::int32_t>(time - s.time);
  }
  void put(ArithmeticEncoder& out, const Sequence& s, int symbol) {
    if (s.step != 0) {
      ++symbols[static_cast<std::size_t>(symbol)];
      return out.symbol(multiple_, static_cast<std::uint32_t>(symbol));
    }
    const int first = symbol == 511 ? 0 : symbol >= 512 ? symbol - 510 : 1;
    ++first_symbols[static_cast<std::size_t>(first)];
    out.symbol(first_step_, static_cast<std::uint32_t>(first));
  }
  std::array<Sequence, 4> sequences_;
  std::size_t current_ = 0, newest_ = 0;
  SymbolModel multiple_{516}, first_step_{6};
  IntegerEncoder coder_{32, 9};
};

/// Red, green and blue of point i, which change in all ways that the code tells apart.
inline std::array<std::uint16_t, 3> test_colour(std::size_t i) {
  const auto noise = [&](std::size_t k) {
    return static_cast<std::uint16_t>((i * 2654435761u + k * 40503u) >> 7);
  };
  switch (i % 5) {
    case 0: return {noise(0), noise(0), noise(0)};
    case 1: return {std::uint16_t(noise(1) & 0xff), 7, 300};
    case 2: return {noise(1), std::uint16_t(noise(1) + 3), std::uint16_t(noise(1) - 3)};
    default: return {noise(1), noise(2), noise(3)};
  }
}

inline std::uint8_t test_extra_byte(std::size_t i, std::size_t k) {
  return static_cast<std::uint8_t>(i * (k + 3) + k);
}

inline std::array<std::uint8_t, 6> bytes_of(const std::array<std::uint16_t, 3>& colour) {
  std::array<std::uint8_t, 6> bytes;
  for (std::size_t k = 0; k < 6; ++k)
    bytes[k] = static_cast<std::uint8_t>(colour[k / 2] >> (k % 2 ? 8 : 0));
  return bytes;
}

/// LASzip's RGB12 version 2: a byte is predicted from the last colour's and from the changes of
/// those before it.
class ColourEncoder {
 public:
  explicit ColourEncoder(const std::array<std::uint16_t, 3>& first) : last_(bytes_of(first)) {}
  void encode(ArithmeticEncoder& out, const std::array<std::uint16_t, 3>& colour) {
    const std::array<std::uint8_t, 6> now = bytes_of(colour);
    std::uint32_t changed = 0;
    for (std::size_t k = 0; k < 6; ++k) changed |= std::uint32_t{now[k] != last_[k]} << k;
    const bool grey = colour[0] == colour[1] && colour[0] == colour[2];
    changed |= std::uint32_t{!grey} << 6;
    out.symbol(changed_, changed);
    int change[2] = {0, 0};  // changes of the lower and the upper byte
    const auto byte = [&](std::size_t k) {
      if (changed >> k & 1)
        out.symbol(bytes_[k],
                   static_cast<std::uint8_t>(
                       now[k] - (k < 2 ? last_[k] : std::clamp(change[k % 2] + last_[k], 0, 255))));
    };
    for (const std::size_t k : {0, 1}) byte(k), change[k] = now[k] - last_[k];
    if (!grey) {
      byte(2);
      change[0] = (change[0] + now[2] - last_[2]) / 2;
      byte(4);
      byte(3);
      change[1] = (change[1] + now[3] - last_[3]) / 2;
      byte(5);
    }
    last_ = now;
  }

 private:
  std::array<std::uint8_t, 6> last_;
  SymbolModel changed_{128};
  std::vector<SymbolModel> bytes_{6, SymbolModel(256)};
};

inline std::string laszip_record(std::uint32_t points_per_chunk, const LazItems& items) {
  std::string content;
  for (const std::uint16_t v : {2, 0, 0x0202, 0, 0, 0})
    append(&content, v);  // compressor, coder, version 2.2.0, options
  append(&content, points_per_chunk), append(&content, std::int64_t{-1}),
      append(&content, std::int64_t{-1});
  std::vector<std::uint16_t> listed{6, 20, 2};  // type, size, version
  if (items.gps_time) listed.insert(listed.end(), {7, 8, 2});
  if (items.colours) listed.insert(listed.end(), {8, 6, 2});
  if (items.extra_bytes > 0)
    listed.insert(listed.end(), {0, static_cast<std::uint16_t>(items.extra_bytes), 2});
  append(&content, static_cast<std::uint16_t>(listed.size() / 3));
  for (const std::uint16_t v : listed) append(&content, v);
  return variable_record("laszip encoded", 22204, content);
}

/// Returns a LAZ file of point format 0 to 3, with the colours and bytes above.
inline std::string laz_file(std::span<const LasRecord> points, std::uint32_t points_per_chunk,
                            const LazItems& items = {}) {
  std::string bytes = las_header(
      static_cast<std::uint32_t>(points.size()),
      {variable_record("somebody else", 7, "what"), laszip_record(points_per_chunk, items)});
  bytes[104] = static_cast<char>(0x80 + items.gps_time + 2 * items.colours);
  overwrite(&bytes, 105, static_cast<std::uint16_t>(items.record_bytes()));
  const std::size_t begin = bytes.size();
  append(&bytes, std::int64_t{0});
  std::vector<std::uint32_t> sizes;
  for (std::size_t i = 0; i < points.size(); i += points_per_chunk) {
    const auto chunk =
        points.subspan(i, std::min<std::size_t>(points_per_chunk, points.size() - i));
    const std::size_t chunk_begin = bytes.size();
    append(&bytes, chunk[0]);
    if (!items.gps_time) bytes.resize(bytes.size() - 8);
    if (items.colours)
      for (const std::uint16_t value : test_colour(i)) append(&bytes, value);
    for (std::size_t k = 0; k < items.extra_bytes; ++k) append(&bytes, test_extra_byte(i, k));
    ArithmeticEncoder out;
    Point10Encoder fields(chunk[0]);
    GpsTimeEncoder times(chunk[0].gps_time_bits);
    ColourEncoder colours(test_colour(i));
    std::vector<SymbolModel> extra(items.extra_bytes, SymbolModel(256));
    for (std::size_t p = 1; p < chunk.size(); ++p) {
      fields.encode(out, chunk[p]);
      if (items.gps_time) times.encode(out, chunk[p].gps_time_bits);
      if (items.colours) colours.encode(out, test_colour(i + p));
      for (std::size_t k = 0; k < items.extra_bytes; ++k)
        out.symbol(extra[k], static_cast<std::uint8_t>(test_extra_byte(i + p, k) -
                                                       test_extra_byte(i + p - 1, k)));
    }
    bytes += out.finish();
    sizes.push_back(static_cast<std::uint32_t>(bytes.size() - chunk_begin));
  }
  overwrite(&bytes, begin, static_cast<std::int64_t>(bytes.size()));
  append(&bytes, std::uint32_t{0}), append(&bytes, static_cast<std::uint32_t>(sizes.size()));
  if (sizes.empty()) return bytes;
  ArithmeticEncoder out;
  IntegerEncoder coder(32, 2);
  for (std::size_t i = 0; i < sizes.size(); ++i)
    coder.encode(out, i ? sizes[i - 1] : 0, sizes[i], 1);
  return bytes + out.finish();
}

}  // namespace redrive::testing
