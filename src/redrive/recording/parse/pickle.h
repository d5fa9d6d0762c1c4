// SPDX-License-Identifier: Apache-2.0
// Pickles of Python, protocols 2 to 5, read as data: no class is looked up and nothing is called.
// Python's pickletools.py defines the opcodes. recording/parse/data_frame.h makes tables of them.
#pragma once

#include <cstdint>
#include <deque>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace redrive {

struct PickleValue {
  enum class Kind {
    kNone,
    kBool,
    kInteger,
    kNumber,
    kText,
    kBytes,
    kTuple,
    kList,
    kDict,
    kGlobal,
    kObject
  };
  Kind kind = Kind::kNone;
  std::int64_t integer = 0;    ///< kInteger, kBool
  double number = 0;           ///< kNumber
  std::string_view text = {};  ///< kText, kBytes; kGlobal: "module name"
  /// Indices of values. kTuple, kList: elements; kDict: keys and values in turn; kObject: what was
  /// called, its arguments and, where it has one, its state.
  std::vector<std::uint32_t> items = {};
};

/// The values of one pickle. They may refer to each other in circles.
class Pickle {
 public:
  /// Parses the bytes, which must outlive the pickle. InputError names opcode and byte: other
  /// opcodes, objects of others than `globals` ("module name"), more than 4 million values.
  Pickle(std::string_view bytes, std::filesystem::path file,
         std::span<const std::string_view> globals);

  const PickleValue& root() const { return values_[root_]; }
  const PickleValue& at(std::uint32_t index) const { return values_[index]; }
  /// Element i of a tuple or list, part i of an object. InputError unless there is one.
  const PickleValue& item(const PickleValue& of, std::size_t i) const;
  /// Value of a text key of a dict; null if there is none.
  const PickleValue* find(const PickleValue& dict, std::string_view key) const;
  /// Whether a value is an object that was made by calling the last word of a global.
  bool is_object(const PickleValue& value, std::string_view name) const;
  [[noreturn]] void fail(const std::string& field, const std::string& value,
                         const std::string& rule) const;
  const std::filesystem::path& file() const { return file_; }
  std::size_t size() const { return bytes_.size(); }  ///< bytes

 private:
  friend class PickleMachine;

  std::string_view bytes_;
  std::filesystem::path file_;
  std::vector<PickleValue> values_;
  std::deque<std::string> decoded_;  ///< bytes that protocol 2 keeps as text
  std::uint32_t root_ = 0;
};

}  // namespace redrive
