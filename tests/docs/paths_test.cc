// SPDX-License-Identifier: Apache-2.0
// Documents that name files must name files that exist.
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>

#include <gtest/gtest.h>

namespace {

constexpr char kPathCharacters[] =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.-/";

class DocumentPaths : public testing::TestWithParam<const char*> {};

// A path in backticks or in an indented flow diagram: starts with a top-level folder of the
// project.
TEST_P(DocumentPaths, Exist) {
  const std::filesystem::path root = REDRIVE_SOURCE;
  std::ifstream file(root / GetParam());
  ASSERT_TRUE(file) << GetParam();
  std::stringstream text;
  text << file.rdbuf();
  const std::string body = text.str();
  int found = 0;
  for (const std::string folder :
       {"src/", "tests/", "tools/", "samples/", "scripts/", "fuzz/", "cmake/", "docs/"})
    for (auto at = body.find(folder); at != std::string::npos; at = body.find(folder, at + 1)) {
      if (at > 0 && !std::strchr(" \n\t`(", body[at - 1])) continue;
      std::string path = body.substr(at, body.find_first_not_of(kPathCharacters, at) - at);
      while (path.ends_with('.') || path.ends_with('/'))
        path.pop_back();                          // the end of a sentence, or of a folder
      if (path.size() < folder.size()) continue;  // the folder alone
      ++found;
      EXPECT_TRUE(std::filesystem::exists(root / path)) << GetParam() << " names " << path;
    }
  EXPECT_GT(found, 0) << GetParam() << " names no file";
}

INSTANTIATE_TEST_SUITE_P(Docs, DocumentPaths,
                         testing::Values("ARCHITECTURE.md", "README.md", "CONTRIBUTING.md"));

}  // namespace
