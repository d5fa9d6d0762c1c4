// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/token_tables.h"

#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"

namespace redrive {
namespace {

/// Returns the text of "key": "text" in a record where it is written plainly. `quoted`: the key
/// with its quotes.
std::optional<std::string_view> find_text(std::string_view record, std::string_view quoted) {
  std::size_t at = record.find(quoted);
  if (at == record.npos) return std::nullopt;
  at = record.find_first_not_of(" \t\r\n", at + quoted.size());
  if (at == record.npos || record[at] != ':') return std::nullopt;
  at = record.find_first_not_of(" \t\r\n", at + 1);
  if (at == record.npos || record[at] != '"') return std::nullopt;
  const std::size_t end = record.find_first_of("\"\\", at + 1);
  if (end == record.npos || record[end] != '"') return std::nullopt;
  return record.substr(at + 1, end - at - 1);
}

void use_record(std::string_view text, const std::filesystem::path& file, std::size_t index,
                const TokenTables::Use& use) {
  const std::string name = "record " + std::to_string(index);
  nlohmann::json document;
  try {
    document[name] = parse_json(text, file);
  } catch (const InputError&) {  // names line and column within the record
    throw InputError(file, name, text.substr(0, 80), "not valid JSON");
  }
  use(JsonField(document, file).at(name), index);
}

}  // namespace

void TokenTables::each(const std::string& table, const Use& use) const {
  RecordScanner scanner(file(table), [&](std::string_view text, std::size_t index) {
    use_record(text, file(table), index, use);
  });
  read_(&scanner);
}

void TokenTables::each_of(const std::string& table, const std::string& key, const Tokens& wanted,
                          const UseNumbered& use) const {
  const std::string quoted = '"' + key + '"';
  RecordScanner scanner(file(table), [&](std::string_view text, std::size_t index) {
    std::string parsed;
    std::optional<std::string_view> token = find_text(text, quoted);
    if (!token) {
      use_record(text, file(table), index,
                 [&](const JsonField& record, std::size_t) { parsed = record.at(key).string(); });
      token = parsed;
    }
    const auto found = wanted.find(*token);
    if (found == wanted.end()) return;
    use_record(text, file(table), index, [&](const JsonField& record, std::size_t) {
      // The text may belong to an object inside the record.
      if (record.at(key).string() != found->first)
        record.at(key).fail("a second one, inside of the record, is " + found->first);
      use(record, index, found->second);
    });
  });
  read_(&scanner);
}

std::size_t References::add(const JsonField& record, std::size_t index) {
  const auto [known, is_new] = tokens_.emplace(record.at(key_).string(), tokens_.size());
  if (is_new) records_.push_back(index);
  return known->second;
}

void References::resolve(const TokenTables& tables, const std::string& table,
                         const TokenTables::UseNumbered& use) const {
  std::vector<bool> found(tokens_.size());
  tables.each_of(table, "token", tokens_,
                 [&](const JsonField& record, std::size_t index, std::size_t number) {
                   if (found[number]) record.at("token").fail("a second record of this token");
                   found[number] = true;
                   use(record, index, number);
                 });
  for (const auto& [token, number] : tokens_)
    if (!found[number])
      throw InputError(file_, "record " + std::to_string(records_[number]) + "." + key_, token,
                       table + ".json has no record of this token");
}

}  // namespace redrive
