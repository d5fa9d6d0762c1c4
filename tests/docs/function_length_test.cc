// SPDX-License-Identifier: Apache-2.0
// A function has at most 80 lines. The format gives its first and last line: both begin at the left
// margin, or two columns from it within a class, and the last is a brace alone.
#include <filesystem>
#include <fstream>
#include <set>
#include <string>

#include <gtest/gtest.h>

namespace {

/// Lists of hyperparameters, a formula with its derivatives, and a step that takes one window
/// through all losses.
const std::set<std::string> kLonger = {"GridModel::visit_hyperparameters",
                                       "SplatModel::visit_hyperparameters",
                                       "project_gaussian_adjoint", "SplatModel::step_window"};

bool is_exempt(const std::string& signature) {
  for (const std::string& name : kLonger)
    if (signature.find(name + "(") != std::string::npos) return true;
  return false;
}

TEST(FunctionLength, Is80LinesAtMost) {
  constexpr int kMost = 80;
  int functions = 0;
  for (const auto& entry :
       std::filesystem::recursive_directory_iterator(REDRIVE_SOURCE "/src/redrive")) {
    const std::string name = entry.path().string();
    if (!name.ends_with(".cc") && !name.ends_with(".h")) continue;
    if (name.ends_with("_test.cc") || name.ends_with("_testing.h")) continue;
    std::ifstream file(entry.path());
    std::string line, begins[2];
    int first[2] = {0, 0};
    for (int number = 1; std::getline(file, line); ++number) {
      const std::size_t column = line.find_first_not_of(' ');
      if (column != 0 && column != 2) continue;
      if (line.substr(column) == "}") {
        ++functions;
        EXPECT_TRUE(number - first[column / 2] < kMost || is_exempt(begins[column / 2]))
            << name << ":" << first[column / 2] << ": " << number + 1 - first[column / 2]
            << " lines: " << begins[column / 2];
      } else if (line[column] != '}' && line[column] != '#' && line[column] != '/') {
        first[column / 2] = number;
        begins[column / 2] = line;
      }
    }
  }
  EXPECT_GT(functions, 1000);
}

}  // namespace
