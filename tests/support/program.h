// SPDX-License-Identifier: Apache-2.0
// Runs a program in a process of its own and collects its output and exit code.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

namespace redrive::testing {

struct ProgramResult {
  int exit_code = -1;  ///< -1: ended by a signal
  int signal = 0;
  std::string out, err;  ///< standard output and standard error
};

class Program {
 public:
  /// Starts the program. A write that makes a file larger than `file_limit_bytes` fails with EFBIG,
  /// as on a full disk.
  Program(const std::filesystem::path& binary, const std::vector<std::string>& arguments,
          std::optional<std::size_t> file_limit_bytes = {});
  ~Program();  ///< kills the program if it still runs
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  /// Waits until the program has written `text` to its standard output, a minute at most. Returns
  /// whether it has.
  bool wait_for_output(const std::string& text) const;
  void send(int signal);
  ProgramResult wait();

 private:
  pid_t pid_ = -1;
  std::filesystem::path folder_;  ///< holds the output
};

}  // namespace redrive::testing
