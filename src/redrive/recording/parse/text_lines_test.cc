// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/parse/text_lines.h"

#include "redrive/recording/core/recording_testing.h"

namespace redrive {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

TEST(TextLines, SplitsWords) {
  const std::filesystem::path file = "dir/a.txt";
  const std::string text = " 1.5\t-2 x \r\n\n3\n\n \n";
  const std::vector<TextLine> lines = text_lines(text, file);
  ASSERT_EQ(lines.size(), 3u);
  ASSERT_EQ(lines[0].size(), 3u);
  EXPECT_EQ(lines[0].number(0, "a", -2, 2), 1.5);
  EXPECT_EQ(lines[0].integer(1, "b", -2, 2), -2);
  EXPECT_EQ(lines[0].word(2), "x");
  EXPECT_EQ(lines[1].size(), 0u);
  EXPECT_EQ(lines[2].word(0), "3");
  EXPECT_TRUE(text_lines("\n\n", file).empty());
  EXPECT_TRUE(text_lines("", file).empty());
}

TEST(TextLines, NamesFileLineFieldAndValue) {
  const std::filesystem::path file = "dir/a.txt";
  const std::string text = "0\nnan inf 1e999 5 2x " + std::string(200, 'y') + " \x01\n";
  const TextLine line = text_lines(text, file)[1];
  const auto number = [&](std::size_t i) {
    return input_error([&] { line.number(i, "speed", -2, 2); });
  };
  EXPECT_THAT(number(0), HasSubstr("dir/a.txt: line 2, speed = nan: a finite number"));
  EXPECT_THAT(number(1), HasSubstr("inf: a finite number"));
  EXPECT_THAT(number(2), HasSubstr("1e999: a finite number"));
  EXPECT_THAT(number(3), HasSubstr("speed = 5: must be between -2 and 2"));
  EXPECT_THAT(number(4), HasSubstr("2x: a finite number"));
  EXPECT_THAT(number(5), HasSubstr(std::string(80, 'y') + "..."));
  EXPECT_THAT(number(6), HasSubstr("= ?: a finite number"));
  EXPECT_THAT(input_error([&] { line.integer(4, "id", 0, 9); }), HasSubstr("a whole number"));
  EXPECT_THAT(input_error([&] { line.integer(3, "id", 0, 4); }),
              HasSubstr("id = 5: must be between 0 and 4"));
  EXPECT_THAT(input_error([&] { line.expect_size(3, "three"); }),
              AllOf(HasSubstr("line 2, number of values = 7"), HasSubstr("expected 3: three")));
}

}  // namespace
}  // namespace redrive
