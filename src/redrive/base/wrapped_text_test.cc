// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/wrapped_text.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(WrappedText, BreaksBetweenWords) {
  EXPECT_EQ(wrapped("one two three", 0, 2, 8), "one two\n  three");
  EXPECT_EQ(wrapped("one two three", 4, 4, 10), "one\n    two\n    three");
}

TEST(WrappedText, BreaksLongLinesAlone) {
  EXPECT_EQ(with_short_lines("a short one\na line of four words\n", 11),
            "a short one\na line of\n  four\n  words\n");
  EXPECT_EQ(with_short_lines("  name   12   34", 10), "  name  \n    12  \n    34");
  EXPECT_EQ(with_short_lines("no end", 80), "no end");
  EXPECT_EQ(with_short_lines("\u00fc\u00fc \u00fc", 4), "\u00fc\u00fc \u00fc")
      << "letters, not bytes";
  EXPECT_EQ(with_short_lines("/a/long/path is kept", 8), "/a/long/path\n  is\n  kept");
}

}  // namespace
}  // namespace redrive
