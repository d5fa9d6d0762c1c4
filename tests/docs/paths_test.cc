// SPDX-License-Identifier: Apache-2.0
// Documents that name files must name files that exist.
#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

namespace {

class DocumentPaths : public testing::TestWithParam<const char*> {};

// A path in backticks or in an indented flow diagram: starts with a top-level folder of the project.
TEST_P(DocumentPaths, Exist) {
  const std::filesystem::path root = REDRIVE_SOURCE;
  std::ifstream file(root / GetParam());
  ASSERT_TRUE(file) << GetParam();
  std::stringstream text;
  text << file.rdbuf();
  const std::string body = text.str();
  const std::regex path_pattern(R"((^|[\s`(])((src|tests|tools|samples|scripts|fuzz|cmake|docs)(/[A-Za-z0-9_.-]+)+))");
  int found = 0;
  for (std::sregex_iterator it(body.begin(), body.end(), path_pattern), end; it != end; ++it) {
    std::string path = (*it)[2];
    while (!path.empty() && path.back() == '.') path.pop_back();
    ++found;
    EXPECT_TRUE(std::filesystem::exists(root / path)) << GetParam() << " names " << path;
  }
  EXPECT_GT(found, 0) << GetParam() << " names no file";
}

INSTANTIATE_TEST_SUITE_P(Docs, DocumentPaths, testing::Values("ARCHITECTURE.md", "README.md", "CONTRIBUTING.md"));

}  // namespace
