// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/record_scanner.h"

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing::input_error;

std::vector<std::string> scanned(std::string_view text, std::size_t block) {
  std::vector<std::string> records;
  RecordScanner scanner("t.json", [&](std::string_view record, std::size_t index) {
    EXPECT_EQ(index, records.size());
    records.emplace_back(record);
  });
  for (std::size_t i = 0; i < text.size(); i += block) scanner.add(text.substr(i, block));
  scanner.finish();
  return records;
}

TEST(RecordScanner, CutsATableWhereverItsBytesAreCut) {
  const std::string text =
      " [\n{\"a\": \"}]\\\"{\", \"b\": [1, {\"c\": \"\\\\\"}]}\r\n,\t{} , {\"d\": 2}] ";
  for (std::size_t block = 1; block <= text.size(); ++block)
    EXPECT_THAT(
        scanned(text, block),
        ElementsAre("{\"a\": \"}]\\\"{\", \"b\": [1, {\"c\": \"\\\\\"}]}", "{}", "{\"d\": 2}"))
        << block;
  EXPECT_TRUE(scanned("[]", 1).empty());
}

TEST(RecordScanner, RejectsOtherTexts) {
  const auto message = [](const std::string& text) {
    return input_error([&] { scanned(text, 3); });
  };
  for (const char* text : {"{}", "[1]", "[{},]", "[{} {}]", "[,{}]", "[]]", "[]x", "x"})
    EXPECT_THAT(message(text), HasSubstr("t.json: record ")) << text;
  EXPECT_THAT(message("[{}, 3]"), HasSubstr("record 1: an array of objects was expected"));
  for (const char* text : {"", "[", "[{}", "[{\"a\": \"b", "[{},"})
    EXPECT_THAT(message(text), HasSubstr("without the end of its array")) << text;
  EXPECT_THAT(message("[{\"a\": " + std::string(64, '[')), HasSubstr("deeper than 64 levels"));
  EXPECT_THAT(message("[{\"a\": \"" + std::string(1 << 20, 'x') + "\"}]"),
              HasSubstr("record 0: is larger than 1 MB"));
}

TEST(RecordScanner, ReadsAFile) {
  const TemporaryFolder folder;
  folder.write("t.json", "[{\"a\": 1}, {}]");
  std::size_t records = 0;
  RecordScanner scanner(folder.path / "t.json", [&](std::string_view, std::size_t) { ++records; });
  scan_file(&scanner);
  EXPECT_EQ(records, 2u);
  RecordScanner missing(folder.path / "u.json", [](std::string_view, std::size_t) {});
  EXPECT_THAT(input_error([&] { scan_file(&missing); }), HasSubstr("u.json: No such file"));
  RecordScanner none(folder.path, [](std::string_view, std::size_t) {});
  EXPECT_THAT(input_error([&] { scan_file(&none); }), HasSubstr("is a folder"));
}

}  // namespace
}  // namespace redrive
