// SPDX-License-Identifier: Apache-2.0
// Tables as other programs write them, for tests.
#pragma once

#include <string>
#include <vector>

#include "redrive/recording/parse/arrow_writer.h"

namespace redrive::testing {

class ArrowFile : public ArrowWriter {
 public:
  using ArrowWriter::ArrowWriter;

  /// A column of a type without parameters whose values are 8 bytes each.
  void add_other(const std::string& name, arrow::Type type, std::size_t rows) {
    columns_.push_back(
        {.name = name, .kind = {type}, .rows = rows, .values = std::string(8 * rows, '\0')});
  }
  /// The last column's rows without a value; bytes stay.
  void leave_out(const std::vector<std::size_t>& rows) { columns_.back().missing = rows; }
  /// Replaces the last column's texts by indices into a dictionary.
  void make_dictionary() { columns_.back().by_dictionary = true; }
};

}  // namespace redrive::testing
