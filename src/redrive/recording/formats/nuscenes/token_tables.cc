// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/formats/nuscenes/token_tables.h"

#include <exception>
#include <optional>
#include <utility>

#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/parallel.h"

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

std::string name_of_record(std::size_t index) { return "record " + std::to_string(index); }

/// Returns an object that has the record under its name. InputError if it is no JSON.
nlohmann::json parse_record_text(std::string_view text, const std::filesystem::path& file,
                                 std::size_t index) {
  const std::string name = name_of_record(index);
  nlohmann::json document;
  try {
    document[name] = parse_json(text, file);
  } catch (const InputError&) {  // names line and column within the record
    throw InputError(file, name, text.substr(0, 80), "not valid JSON");
  }
  return document;
}

void use_record(std::string_view text, const std::filesystem::path& file, std::size_t index,
                const TokenTables::Use& use) {
  const nlohmann::json document = parse_record_text(text, file, index);
  use(JsonField(document, file).at(name_of_record(index)), index);
}

/// Records whose tokens are sought, and which are parsed, by all threads. They are used in their
/// order.
class RecordBatch {
 public:
  RecordBatch(std::filesystem::path file, std::string key, const Tokens& wanted,
              const TokenTables::UseNumbered& use)
      : file_(std::move(file)),
        key_(std::move(key)),
        quoted_('"' + key_ + '"'),
        wanted_(wanted),
        use_(use) {}

  void add(std::string_view text, std::size_t index) {
    records_.push_back({texts_.size(), text.size(), index});
    texts_ += text;
    if (texts_.size() > kBytes) flush();
  }

  /// InputError of the first record that is no JSON or whose use throws; the batch is empty then,
  /// too.
  void flush() {
    constexpr std::size_t kGrain = 64;
    std::vector<Record> records = std::exchange(records_, {});
    const std::string texts = std::exchange(texts_, {});
    const auto each = [&](const std::function<void(Record*)>& body) {
      pool_.run_ranges(records.size(), kGrain, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) body(&records[i]);
      });
    };
    each([&](Record* record) { look_at(texts, record); });
    for (const Record& record : records) {
      if (record.failure) std::rethrow_exception(record.failure);
      if (record.found)
        use_(JsonField(record.document, file_).at(name_of_record(record.index)), record.index,
             record.found->second);
    }
    each([](Record* record) { record->document = nullptr; });
  }

 private:
  static constexpr std::size_t kBytes = 256 << 10;  ///< parsed, they fit into a cache
  struct Record {
    std::size_t at, size, index;
    const Tokens::value_type* found = nullptr;  ///< the wanted token that it has
    nlohmann::json document = nullptr;          ///< where it has one
    std::exception_ptr failure = nullptr;
  };

  void look_at(std::string_view texts, Record* record) const {
    const std::string_view text = texts.substr(record->at, record->size);
    const auto parsed_token = [&] {
      record->document = parse_record_text(text, file_, record->index);
      return JsonField(record->document, file_).at(name_of_record(record->index)).at(key_);
    };
    try {
      const std::optional<std::string_view> token = find_text(text, quoted_);
      const auto found = wanted_.find(token ? *token : parsed_token().string());
      if (found == wanted_.end()) return;
      record->found = &*found;
      // The text that was found may belong to an object inside the record.
      if (const JsonField field = parsed_token(); field.string() != found->first)
        field.fail("a second one, inside of the record, is " + found->first);
    } catch (const InputError&) {
      record->failure = std::current_exception();
    }
  }

  std::filesystem::path file_;
  std::string key_, quoted_;
  const Tokens& wanted_;
  const TokenTables::UseNumbered& use_;
  ThreadPool pool_{hardware_threads()};
  std::string texts_;
  std::vector<Record> records_;
};

}  // namespace

void TokenTables::each(const std::string& table, const Use& use) const {
  RecordScanner scanner(file(table), [&](std::string_view text, std::size_t index) {
    use_record(text, file(table), index, use);
  });
  read_(&scanner);
}

void TokenTables::each_of(const std::string& table, const std::string& key, const Tokens& wanted,
                          const UseNumbered& use) const {
  RecordBatch batch(file(table), key, wanted, use);
  RecordScanner scanner(file(table),
                        [&](std::string_view text, std::size_t index) { batch.add(text, index); });
  try {
    read_(&scanner);
  } catch (const InputError&) {
    batch.flush();  // errors in records before come first
    throw;
  }
  batch.flush();
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
