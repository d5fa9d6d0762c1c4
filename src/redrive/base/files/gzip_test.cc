// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/gzip.h"

#include <stdexcept>

#include <gtest/gtest.h>

namespace redrive {
namespace {

TEST(Gzip, GivesTheBytesBack) {
  std::string bytes;
  for (int i = 0; i < 300000; ++i) bytes += static_cast<char>(i / 1000);
  for (const std::string& some : {std::string(), std::string("a"), bytes}) {
    const std::string file = gzip(some);
    EXPECT_EQ(file.substr(0, 2), "\x1f\x8b");
    EXPECT_EQ(gunzip(file), some);
    EXPECT_EQ(gzip(some), file);
  }
  EXPECT_LT(gzip(bytes).size(), bytes.size() / 2);
}

TEST(Gzip, NoticesDamage) {
  const std::string file = gzip("some bytes");
  EXPECT_THROW(gunzip(file.substr(0, file.size() - 4)), std::logic_error);
  EXPECT_THROW(gunzip("no file"), std::logic_error);
  EXPECT_THROW(gunzip(""), std::logic_error);
  for (std::size_t size = 0; size < file.size(); ++size)
    EXPECT_FALSE(gunzip_at_most(1000, std::string_view(file).substr(0, size))) << size;
}

TEST(Gzip, StopsAtMost) {
  const std::string file = gzip(std::string(200000, 'a'));
  EXPECT_EQ(gunzip_at_most(200000, file), std::string(200000, 'a'));
  EXPECT_FALSE(gunzip_at_most(199999, file));
  EXPECT_FALSE(gunzip_at_most(0, file));
}

}  // namespace
}  // namespace redrive
