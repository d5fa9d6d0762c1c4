// SPDX-License-Identifier: Apache-2.0
// Writes tables as pandas 1.0 pickles them, for tests.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "redrive/recording/parse/little_endian.h"

namespace redrive::testing {

/// Columns of one type make a block each, in protocol 3.
class PickledTable {
 public:
  void add(const std::string& name, const std::vector<double>& values) {
    begin_block(name);
    add_array("f8", {1, values.size()}, bytes_of(values));
    end_block();
  }
  void add(const std::string& name, const std::vector<std::int64_t>& values) {
    begin_block(name);
    add_array("i8", {1, values.size()}, bytes_of(values));
    end_block();
  }
  void add(const std::string& name, const std::vector<bool>& values) {
    begin_block(name);
    add_array("b1", {1, values.size()}, bytes_of(std::vector<char>(values.begin(), values.end())));
    end_block();
  }
  void add(const std::string& name, const std::vector<std::string>& values) {
    begin_block(name);
    add_array("O8", {1, values.size()}, list_of(values));
    end_block();
  }

  std::string pickle() const {
    PickledTable out;
    out.pickle_ = "\x80\x03";
    out.add_object("pandas.core.frame\nDataFrame");
    out.pickle_ += "}(";
    out.add_text("_data");
    out.add_object("pandas.core.internals.managers\nBlockManager");
    out.pickle_ += "(]]]}(";
    out.add_text("0.14.1");
    out.pickle_ += "}(";
    out.add_text("axes");
    out.pickle_ += "](";
    out.pickle_ += names_index() + "e";
    out.add_text("blocks");
    out.pickle_ += "](" + pickle_ + "euutbub.";
    return out.pickle_;
  }

 private:
  template <class T>
  static std::string bytes_of(const std::vector<T>& values) {
    std::string data;
    for (const T& value : values) add_bytes(value, &data);
    return with_size('B', data);
  }
  static std::string with_size(char opcode, const std::string& data) {
    std::string out(1, opcode);
    add_bytes(static_cast<std::uint32_t>(data.size()), &out);
    return out + data;
  }
  static std::string list_of(const std::vector<std::string>& texts) {
    std::string out = "](";
    for (const std::string& text : texts) out += with_size('X', text);
    return out + "e";
  }
  static std::string integer(std::size_t value) {
    std::string out = "J";
    add_bytes(static_cast<std::int32_t>(value), &out);
    return out;
  }
  void add_text(const std::string& text) { pickle_ += with_size('X', text); }
  void add_object(const std::string& global) { pickle_ += "c" + global + "\n)\x81"; }

  void begin_block(const std::string& name) {
    names_.push_back(name);
    pickle_ += "}(";
    add_text("values");
  }
  void end_block() {
    add_text("mgr_locs");
    const std::string at = integer(names_.size() - 1), end = integer(names_.size());
    pickle_ += "cbuiltins\nslice\n" + at + end + "K\x01\x87Ru";
  }
  void add_array(const std::string& type, const std::vector<std::size_t>& shape,
                 const std::string& data) {
    pickle_ += "cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK";
    pickle_ += std::string("\0\x85", 2) + "C\x01" + "b\x87R(K\x01(";
    for (const std::size_t size : shape) pickle_ += integer(size);
    pickle_ += "tcnumpy\ndtype\n" + with_size('X', type) + "\x89\x88\x87R(K\x03";
    pickle_ += with_size('X', type == "O8" || type == "b1" ? "|" : "<") + "NNN" +
               integer(std::size_t(-1)) + integer(std::size_t(-1)) + std::string("K\0tb\x89", 5);
    pickle_ += data + "tb";
  }
  std::string names_index() const {
    PickledTable index;
    index.pickle_ = "cpandas.core.indexes.base\n_new_Index\ncpandas.core.indexes.base\nIndex\n}(";
    index.add_text("data");
    index.add_array("O8", {names_.size()}, list_of(names_));
    index.pickle_ += "u\x86R";
    return index.pickle_;
  }

  std::string pickle_;
  std::vector<std::string> names_;
};

}  // namespace redrive::testing
