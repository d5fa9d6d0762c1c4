// SPDX-License-Identifier: Apache-2.0
// Where the columns of an Arrow file lie: its metadata (arrow.fbs), read and checked.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "arrow_generated.h"

namespace redrive {

struct ArrowLayout {
  /// Bytes of an integer; its sign.
  struct Integer {
    std::size_t bytes = 0;
    bool is_signed = false;
  };
  struct Column {
    std::string name;
    arrow::Type type = arrow::Type::NONE;
    Integer integer = {};  ///< type of the values, or of indices into the dictionary
    arrow::Precision precision = arrow::Precision::kDouble;
    std::optional<std::int64_t> dictionary;
    std::size_t first_buffer = 0;  ///< validity, then offsets of texts, then values
  };
  /// Some rows of all columns, or the values of a dictionary.
  struct Batch {
    std::size_t rows = 0;
    std::optional<arrow::Codec> codec;
    std::vector<arrow::Buffer> buffers;  ///< offsets: in the file
  };

  std::filesystem::path file;
  std::map<std::string, Column> columns;
  std::vector<Batch> batches;
  std::map<std::int64_t, Batch> dictionaries;
  std::size_t rows = 0;
};

/// Returns `size` bytes of a file from `offset` on, which it has.
using ReadAt = std::function<std::string(std::uint64_t offset, std::uint64_t size)>;

/// InputError names what is damaged. All buffers lie within the file.
ArrowLayout read_arrow_layout(const ReadAt& read, std::uint64_t file_bytes,
                              const std::filesystem::path& file);

}  // namespace redrive
