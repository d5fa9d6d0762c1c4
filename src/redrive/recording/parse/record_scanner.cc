// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/record_scanner.h"

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxRecordBytes = 1 << 20;  // tables of data sets have some hundred bytes
constexpr int kMaxDepth = 64;  // printing a value, as messages do, recurses once a level

bool is_space(char c) { return c == ' ' || c == '\n' || c == '\r' || c == '\t'; }

}  // namespace

std::size_t RecordScanner::skip_record(std::string_view bytes, std::size_t i) {
  while (i < bytes.size()) {
    // Most bytes of a table are in strings.
    while (in_string_ && !escaped_ && i < bytes.size() && bytes[i] != '"' && bytes[i] != '\\') ++i;
    if (i == bytes.size()) break;
    const char c = bytes[i++];
    if (in_string_) {
      if (escaped_)
        escaped_ = false;
      else if (c == '\\')
        escaped_ = true;
      else if (c == '"')
        in_string_ = false;
    } else if (c == '"') {
      in_string_ = true;
    } else if (c == '{' || c == '[') {
      if (++depth_ > kMaxDepth) fail("is nested deeper than 64 levels");
    } else if ((c == '}' || c == ']') && --depth_ == 0) {
      at_ = At::kAfterRecord;
      return i;
    }
  }
  return i;
}

void RecordScanner::add(std::string_view bytes) {
  for (std::size_t i = 0; i < bytes.size();) {
    const char c = bytes[i];
    if (at_ == At::kRecord || (c == '{' && (at_ == At::kFirst || at_ == At::kAfterComma))) {
      at_ = At::kRecord;
      const std::size_t end = skip_record(bytes, i);
      const std::string_view text = bytes.substr(i, end - i);
      i = end;
      if (begun_.size() + text.size() > kMaxRecordBytes) fail("is larger than 1 MB");
      if (at_ == At::kRecord || !begun_.empty()) begun_ += text;
      if (at_ == At::kRecord) return;
      use_(begun_.empty() ? text : std::string_view(begun_), records_++);
      begun_.clear();
      continue;
    }
    ++i;
    if (is_space(c)) continue;
    if (c == '[' && at_ == At::kBegin)
      at_ = At::kFirst;
    else if (c == ',' && at_ == At::kAfterRecord)
      at_ = At::kAfterComma;
    else if (c == ']' && (at_ == At::kFirst || at_ == At::kAfterRecord))
      at_ = At::kEnd;
    else
      fail("an array of objects was expected");
  }
}

void RecordScanner::finish() const {
  if (at_ != At::kEnd)
    fail("ends after " + std::to_string(records_) + " records without the end of its array");
}

void RecordScanner::fail(const std::string& rule) const {
  throw InputError(file_, "record " + std::to_string(records_), "", rule);
}

void scan_file(RecordScanner* scanner) {
  read_blocks(scanner->file(), [&](std::string_view block) { scanner->add(block); });
  scanner->finish();
}

}  // namespace redrive
