// SPDX-License-Identifier: Apache-2.0
// The safetensors container: 8 bytes length of the header (little endian), the header as JSON, the
// raw data. Float32 and words of 32 bits only.
//   {"__metadata__": {name: text, ...}, tensor: {"dtype": "F32" or "U32", "shape": [...],
//   "data_offsets": [begin, end]}, ...}
#pragma once

#include <cstdint>
#include <cstring>
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

struct SafetensorsEntry {
  std::string name;
  std::vector<std::int64_t> shape;
  std::span<const float> values;         ///< row-major
  std::span<const std::uint32_t> words;  ///< instead of values
};

/// A file with `entries` in the order of their data. Its values are not copied.
struct SafetensorsFile {
  std::string header;  ///< with its length; padded with spaces to align the data to 8 bytes
  std::vector<SafetensorsEntry> entries;

  /// Header and data, as long as the file and its values live.
  std::vector<std::string_view> parts() const;
};
SafetensorsFile make_safetensors(const std::map<std::string, std::string>& metadata,
                                 std::vector<SafetensorsEntry> entries);

/// A parsed file, which refers to its bytes.
struct Safetensors {
  struct Tensor {
    std::vector<std::int64_t> shape;
    bool is_float = true;   ///< F32; otherwise U32
    std::string_view data;  ///< at any address

    std::size_t size() const { return data.size() / 4; }
    void copy_to(void* values) const { std::memcpy(values, data.data(), data.size()); }
  };
  std::map<std::string, std::string> metadata;
  std::map<std::string, Tensor> tensors;
};

/// Parses a file. Throws InputError naming the field for a header that is too long or no JSON,
/// another type, a shape that does not match its offsets, data that overlaps, has holes or is
/// missing, or a float that is not finite.
Safetensors parse_safetensors(std::string_view bytes, const std::filesystem::path& file);

}  // namespace redrive
