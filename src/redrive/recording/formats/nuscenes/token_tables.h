// SPDX-License-Identifier: Apache-2.0
// A folder of JSON tables whose records refer to each other by tokens, as in nuScenes.
#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "redrive/base/json_field.h"
#include "redrive/recording/parse/record_scanner.h"

namespace redrive {

struct TextHash {
  using is_transparent = void;
  std::size_t operator()(std::string_view text) const {
    return std::hash<std::string_view>()(text);
  }
};
/// Maps tokens to consecutive numbers.
using Tokens = std::unordered_map<std::string, std::size_t, TextHash, std::equal_to<>>;

/// Feeds a table into its scanner: scan_file, but for tests and fuzzing.
using ReadTable = std::function<void(RecordScanner*)>;

/// The tables of a folder. Messages call a record's fields "record 12.timestamp".
class TokenTables {
 public:
  TokenTables(std::filesystem::path folder, ReadTable read)
      : folder_(std::move(folder)), read_(std::move(read)) {}

  std::filesystem::path file(const std::string& table) const { return folder_ / (table + ".json"); }

  /// Calls use(record, index) for each record. InputError as RecordScanner, and for records that
  /// are no JSON.
  using Use = std::function<void(const JsonField& record, std::size_t index)>;
  void each(const std::string& table, const Use& use) const;

  /// Calls use(record, index, number) for each record whose text `key` is a token in `wanted`, with
  /// the token's number there. Other records are not parsed.
  using UseNumbered =
      std::function<void(const JsonField& record, std::size_t index, std::size_t number)>;
  void each_of(const std::string& table, const std::string& key, const Tokens& wanted,
               const UseNumbered& use) const;

 private:
  std::filesystem::path folder_;
  ReadTable read_;
};

/// Tokens of another table that records of `file` have under `key`.
class References {
 public:
  References(std::filesystem::path file, std::string key)
      : file_(std::move(file)), key_(std::move(key)) {}

  /// Returns the number of the token that `record` has.
  std::size_t add(const JsonField& record, std::size_t index);
  std::size_t size() const { return tokens_.size(); }

  /// Calls `use` for the record of each token. InputError for a token without a record, and for one
  /// with two.
  void resolve(const TokenTables& tables, const std::string& table,
               const TokenTables::UseNumbered& use) const;

 private:
  std::filesystem::path file_;
  std::string key_;
  Tokens tokens_;
  std::vector<std::size_t> records_;  ///< the first record that has the token, one per number
};

}  // namespace redrive
