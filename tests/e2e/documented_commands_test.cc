// SPDX-License-Identifier: Apache-2.0
// Every command line in the documents and scripts has commands and options that the program has.
#include <map>
#include <regex>
#include <set>

#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

/// Returns the options that a command's help lists; empty where there is no such command.
std::set<std::string> options_of(const std::vector<std::string>& command) {
  static std::map<std::vector<std::string>, std::set<std::string>> known;
  const auto found = known.find(command);
  if (found != known.end()) return found->second;
  std::vector<std::string> words = {"help"};
  words.insert(words.end(), command.begin(), command.end());
  const ProgramResult help = Program(REDRIVE_BINARY, words).wait();
  std::set<std::string>& options = known[command];
  if (help.exit_code != kExitOk) return options;
  const std::regex option("(^|\n)  (-h, )?(--[a-z-]+)");
  for (std::sregex_iterator at(help.out.begin(), help.out.end(), option), end; at != end; ++at)
    options.insert((*at)[3]);
  return options;
}

std::vector<std::string> words_in(const std::string& line) {
  const std::regex word("[^\\s\\[\\]|`()]+");
  std::vector<std::string> words;
  for (std::sregex_iterator at(line.begin(), line.end(), word), end; at != end; ++at)
    words.push_back(at->str());
  return words;
}

/// Returns the command lines of a document, each joined with the lines that continue it.
std::vector<std::string> command_lines(const std::string& text) {
  const std::regex command(
      "(^|\n) {4}(redrive [a-z][^\n#]*(\n {8,}[^\n#]*)*)|`(redrive [a-z][^`]* --[^`]*)`");
  std::vector<std::string> lines;
  for (std::sregex_iterator at(text.begin(), text.end(), command), end; at != end; ++at)
    lines.push_back((*at)[2].matched ? (*at)[2] : (*at)[4]);
  return lines;
}

void check_line(const fs::path& file, const std::string& line) {
  std::vector<std::string> words = words_in(line);
  words.erase(words.begin());
  if (words.front() == "help") return;
  std::vector<std::string> command = {words.front()};
  if (command[0] == "render" && words.size() > 1) command.push_back(words[1]);
  const std::set<std::string> options = options_of(command);
  EXPECT_FALSE(options.empty()) << file << ": " << line << ": no command " << command[0];
  for (const std::string& word : words) {
    if (!word.starts_with("--")) continue;
    const std::string option = word.substr(0, word.find_first_of("=,.;:"));
    EXPECT_TRUE(options.contains(option)) << file << ": " << line << ": no option " << option;
  }
}

TEST(DocumentedCommands, Exist) {
  int lines = 0;
  for (const fs::path folder : {REDRIVE_SOURCE, REDRIVE_SOURCE "/docs"})
    for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
      if (entry.path().extension() != ".md") continue;
      for (const std::string& line : command_lines(read_file(entry.path()))) {
        check_line(entry.path(), line);
        ++lines;
      }
    }
  EXPECT_GT(lines, 60);
}

}  // namespace
}  // namespace redrive::testing
