// SPDX-License-Identifier: Apache-2.0
// Output of several processes in one stream: whole lines, each with a prefix that says what it is
// about.
#pragma once

#include <memory>
#include <string>

namespace redrive {

/// While it lives, standard output and standard error of stdio are written line by line, and
/// progress is printed as lines even where a launcher gives each process a terminal.
class PrefixedOutput {
 public:
  PrefixedOutput();
  ~PrefixedOutput();
  PrefixedOutput(const PrefixedOutput&) = delete;
  PrefixedOutput& operator=(const PrefixedOutput&) = delete;

  /// Sets the prefix of the calling thread's lines; empty: none.
  static void set_prefix(const std::string& prefix);
  /// Drops all lines of this process, or stops dropping them.
  static void set_silent(bool silent);

 private:
  struct Stream;
  std::unique_ptr<Stream> out_, err_;
  int standard_output_ = -1;  // a copy of the descriptor
};

}  // namespace redrive
