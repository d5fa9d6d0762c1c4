// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/lidar/laz_decoder.h"

#include <algorithm>
#include <string>

#include "redrive/base/error.h"
#include "redrive/recording/parse/little_endian.h"

namespace redrive {
namespace {

constexpr std::size_t kTablePositionBytes = 8, kTableHeaderBytes = 8;
constexpr std::size_t kFillBytes = 4;  // fill the decoder, behind a chunk's first point

struct Table {
  std::size_t begin = 0;  ///< offset in the file, the end of the last chunk
  std::vector<std::size_t> chunk_bytes;
};

Table read_table(std::string_view bytes, const LazLayout& layout,
                 const std::filesystem::path& file) {
  const auto fail = [&](const std::string& field, auto value, const std::string& rule) {
    throw InputError(file, field, std::to_string(value), rule);
  };
  const std::size_t first_chunk = layout.begin + kTablePositionBytes;
  if (first_chunk + kTableHeaderBytes > bytes.size())
    fail("points", bytes.size() - layout.begin,
         "bytes are left for them: no room for the chunk table (truncated)");
  const auto position = little_endian<std::int64_t>(bytes, layout.begin);
  if (position < static_cast<std::int64_t>(first_chunk) ||
      position > static_cast<std::int64_t>(bytes.size() - kTableHeaderBytes))
    fail("chunk table position", position,
         "must lie between the points and the end of the file's " + std::to_string(bytes.size()) +
             " bytes (truncated, or never finished)");
  Table table;
  table.begin = static_cast<std::size_t>(position);
  const auto version = little_endian<std::uint32_t>(bytes, table.begin);
  if (version != 0) fail("chunk table version", version, "must be 0");
  const auto chunks = little_endian<std::uint32_t>(bytes, table.begin + 4);
  const std::uint64_t expected =
      (std::uint64_t{layout.points} + layout.points_per_chunk - 1) / layout.points_per_chunk;
  if (chunks != expected)
    fail("number of chunks", chunks,
         "must be " + std::to_string(expected) + ": " + std::to_string(layout.points) +
             " points in chunks of " + std::to_string(layout.points_per_chunk));
  const std::size_t least_chunk = layout.items.record_bytes() + kFillBytes;
  // Check the number of chunks against the size of the file before decoding the table.
  if (chunks > (table.begin - first_chunk) / least_chunk)
    fail("number of chunks", chunks, "do not fit in the file");

  ArithmeticDecoder decoder(bytes.substr(table.begin + kTableHeaderBytes));
  IntegerDecoder sizes(32, 2);
  std::uint32_t size = 0;
  std::size_t room = table.begin - first_chunk;
  for (std::uint32_t chunk = 0; chunk < chunks; ++chunk) {
    size = static_cast<std::uint32_t>(sizes.decode(decoder, size, 1));
    if (decoder.broken())
      fail("chunk table", chunk,
           "the size of this chunk cannot be read: the table is damaged or truncated");
    if (size < least_chunk || size > room)
      fail("chunk " + std::to_string(chunk) + " size", size,
           "bytes: must be at least " + std::to_string(least_chunk) + " and fit in the " +
               std::to_string(room) + " before the chunk table");
    room -= size;
    table.chunk_bytes.push_back(size);
  }
  if (room != 0) fail("chunk table", room, "bytes lie between the last chunk and the table");
  return table;
}

}  // namespace

LasRecord las_record(std::string_view bytes, const LazItems& items) {
  return {.x = little_endian<std::int32_t>(bytes, 0),
          .y = little_endian<std::int32_t>(bytes, 4),
          .z = little_endian<std::int32_t>(bytes, 8),
          .intensity = little_endian<std::uint16_t>(bytes, 12),
          .returns = little_endian<std::uint8_t>(bytes, 14),
          .classification = little_endian<std::uint8_t>(bytes, 15),
          .scan_angle = little_endian<std::uint8_t>(bytes, 16),
          .user_data = little_endian<std::uint8_t>(bytes, 17),
          .source_id = little_endian<std::uint16_t>(bytes, 18),
          .gps_time_bits = items.gps_time ? little_endian<std::uint64_t>(bytes, 20) : 0};
}

std::vector<LasRecord> decode_laz(std::string_view bytes, const LazLayout& layout,
                                  const std::filesystem::path& file) {
  const Table table = read_table(bytes, layout, file);
  const std::size_t record_bytes = layout.items.record_bytes();
  std::vector<LasRecord> records;
  std::size_t begin = layout.begin + kTablePositionBytes;
  for (std::size_t chunk = 0; chunk < table.chunk_bytes.size(); ++chunk) {
    const std::string_view code = bytes.substr(begin, table.chunk_bytes[chunk]);
    begin += code.size();
    const LasRecord first = las_record(code, layout.items);
    records.push_back(first);
    ArithmeticDecoder decoder(code.substr(record_bytes));
    Point10Decoder fields(first);
    GpsTimeDecoder times(first.gps_time_bits);
    ColourSkipper colours;
    ByteSkipper extra(layout.items.extra_bytes);
    const std::size_t end =
        std::min<std::size_t>(layout.points, records.size() - 1 + layout.points_per_chunk);
    while (records.size() < end && !decoder.broken()) {
      LasRecord record = fields.decode(decoder);
      if (layout.items.gps_time) record.gps_time_bits = times.decode(decoder);
      if (layout.items.colours) colours.skip(decoder);
      extra.skip(decoder);
      records.push_back(record);
    }
    const std::string where = "chunk " + std::to_string(chunk);
    if (decoder.broken())
      throw InputError(file, where, "point " + std::to_string(records.size() - 1),
                       "the compressed data are damaged or truncated");
    // The encoder writes exactly the bytes that the decoder reads. No other check detects damage in
    // the middle of a chunk.
    if (const std::size_t unread = code.size() - record_bytes - decoder.bytes_read(); unread != 0)
      throw InputError(file, where, std::to_string(unread) + " bytes",
                       "are left after its last point: the compressed data are damaged");
  }
  return records;
}

}  // namespace redrive
