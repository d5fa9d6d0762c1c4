// SPDX-License-Identifier: Apache-2.0
// Documents name files that exist, and link to documents and headings that exist.
#include <algorithm>
#include <cctype>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace {

namespace fs = std::filesystem;

constexpr char kPathCharacters[] =
    "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_.-/";

std::string read(const fs::path& file) {
  std::ifstream stream(file);
  EXPECT_TRUE(stream) << file;
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

/// Without blocks and spans of code, which may hold what looks like a link.
std::string without_code(const std::string& text) {
  std::stringstream lines(text);
  std::string out;
  bool fenced = false, in_span = false;
  for (std::string line; std::getline(lines, line); out += '\n') {
    if (line.starts_with("```")) fenced = !fenced;
    if (fenced || line.starts_with("```") || line.starts_with("    ")) continue;
    if (line.empty()) in_span = false;
    for (const char c : line) {
      if (c == '`') in_span = !in_span;
      if (c != '`' && !in_span) out += c;
    }
  }
  return out;
}

/// Anchors of the headings as forges make them: lower case, spaces to hyphens, no other
/// punctuation.
std::set<std::string> anchors_of(const std::string& text) {
  std::stringstream lines(text);
  std::set<std::string> anchors;
  for (std::string line; std::getline(lines, line);) {
    const auto begin = line.find_first_not_of('#');
    if (begin == 0 || begin == std::string::npos || line[begin] != ' ') continue;
    std::string anchor;
    for (const char c : line.substr(begin + 1))
      if (c == ' ')
        anchor += '-';
      else if (std::isalnum(static_cast<unsigned char>(c)) || c == '-' || c == '_')
        anchor += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
    anchors.insert(anchor);
  }
  return anchors;
}

class Documents : public testing::TestWithParam<const char*> {};

// A path in backticks or in an indented flow diagram: starts with a top-level folder of the
// project.
TEST_P(Documents, NamePathsThatExist) {
  const fs::path root = REDRIVE_SOURCE;
  const std::string body = read(root / GetParam());
  int found = 0;
  for (const std::string folder :
       {"src/", "tests/", "tools/", "samples/", "scripts/", "fuzz/", "cmake/", "docs/", "bench/"})
    for (auto at = body.find(folder); at != std::string::npos; at = body.find(folder, at + 1)) {
      if (at > 0 && !std::strchr(" \n\t`(", body[at - 1])) continue;
      const auto end = std::min(body.find_first_not_of(kPathCharacters, at), body.size());
      std::string path = body.substr(at, end - at);
      if (body.substr(end, 1) == "<") path.erase(path.rfind('/'));  // src/x/<name>.h: the folder
      while (path.ends_with('.') || path.ends_with('/'))
        path.pop_back();                          // the end of a sentence, or of a folder
      if (path.size() < folder.size()) continue;  // the folder itself
      ++found;
      EXPECT_TRUE(fs::exists(root / path)) << GetParam() << " names " << path;
    }
  if (std::string(GetParam()) == "ARCHITECTURE.md") {
    EXPECT_GT(found, 0) << "the scan finds nothing";
  }
}

TEST_P(Documents, LinkToFilesAndHeadingsThatExist) {
  const fs::path file = fs::path(REDRIVE_SOURCE) / GetParam();
  const std::string text = read(file), prose = without_code(text);
  for (auto at = prose.find("]("); at != std::string::npos; at = prose.find("](", at + 1)) {
    const std::string link = prose.substr(at + 2, prose.find(')', at) - at - 2);
    if (link.find("://") != std::string::npos) continue;
    const auto hash = link.find('#');
    const fs::path target =
        hash == 0 ? file : (file.parent_path() / link.substr(0, hash)).lexically_normal();
    EXPECT_TRUE(fs::exists(target)) << GetParam() << " links to " << link;
    if (hash == std::string::npos || !fs::exists(target)) continue;
    EXPECT_TRUE(anchors_of(read(target)).contains(link.substr(hash + 1)))
        << GetParam() << " links to " << link << ", a heading that is not there";
  }
}

INSTANTIATE_TEST_SUITE_P(Docs, Documents,
                         testing::Values("ARCHITECTURE.md", "CONTRIBUTING.md", "README.md",
                                         "docs/benchmarks.md", "docs/cli.md", "docs/evaluation.md",
                                         "docs/experiments.md", "docs/hyperparameters.md",
                                         "docs/methods.md", "docs/poses.md", "docs/python.md",
                                         "docs/recordings.md", "docs/viewer.md",
                                         "samples/README.md", "tools/drive/README.md",
                                         "tools/object/README.md", "tools/street/README.md"),
                         [](const auto& info) {
                           std::string name = info.param;
                           for (char& c : name)
                             if (!std::isalnum(static_cast<unsigned char>(c))) c = '_';
                           return name;
                         });

}  // namespace
