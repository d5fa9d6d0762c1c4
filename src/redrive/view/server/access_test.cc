// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/access.h"

#include <gtest/gtest.h>

namespace redrive::view {
namespace {

TEST(Access, TokensAreLongAndDiffer) {
  const std::string a = random_token(), b = random_token();
  EXPECT_EQ(a.size(), 32u);
  EXPECT_EQ(a.find_first_not_of("0123456789abcdef"), std::string::npos);
  EXPECT_NE(a, b);
}

TEST(Access, ComparesTokens) {
  EXPECT_TRUE(equal_in_constant_time("abc", "abc"));
  EXPECT_TRUE(equal_in_constant_time("", ""));
  for (const char* other : {"", "ab", "abd", "bbc", "abcd"})
    EXPECT_FALSE(equal_in_constant_time("abc", other)) << other;
}

TEST(Access, KnowsItsHosts) {
  for (const char* host : {"localhost", "localhost:7007", "LocalHost:1", "127.0.0.1:7007",
                           "192.168.1.2:80", "[::1]:7007", "[::1]", "box.local:7007"})
    EXPECT_TRUE(is_own_host(host, "box.local")) << host;
  for (const char* host : {"", ":7007", "example.org", "example.org:7007", "localhost.example.org",
                           "127.0.0.1.example.org", "[::1", "127.0.0.1@example.org"})
    EXPECT_FALSE(is_own_host(host, "127.0.0.1")) << host;
}

TEST(Access, KnowsItsOrigin) {
  EXPECT_TRUE(is_own_origin("http://127.0.0.1:7007", "127.0.0.1:7007"));
  for (const char* origin : {"", "null", "http://127.0.0.1", "http://127.0.0.1:7008",
                             "https://127.0.0.1:7007", "http://example.org", "127.0.0.1:7007"})
    EXPECT_FALSE(is_own_origin(origin, "127.0.0.1:7007")) << origin;
  EXPECT_FALSE(is_own_origin("http://", ""));
}

TEST(Access, SplitsTargets) {
  EXPECT_EQ(parse_target("/abc/").token, "abc");
  EXPECT_EQ(parse_target("/abc/").file, "");
  EXPECT_EQ(parse_target("/abc/viewer.js?x=/y").file, "viewer.js");
  EXPECT_EQ(parse_target("/abc/../x").file, "../x");  // is no file of the page
  for (const char* target : {"", "/", "/abc", "abc/", "/?/", "http://x/"})
    EXPECT_FALSE(parse_target(target).valid && !parse_target(target).token.empty()) << target;
}

}  // namespace
}  // namespace redrive::view
