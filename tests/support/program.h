// SPDX-License-Identifier: Apache-2.0
// Runs a program as a user would and looks at what it says and how it ends.
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
  std::string out, err;  ///< what it printed
};

class Program {
 public:
  /// Starts it. `file_limit_bytes`: no file may grow beyond it, writing further fails (as on a full
  /// disk, with EFBIG).
  Program(const std::filesystem::path& binary, const std::vector<std::string>& arguments,
          std::optional<std::size_t> file_limit_bytes = {});
  ~Program();  ///< kills it if it still runs
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  void send(int signal);
  ProgramResult wait();

 private:
  pid_t pid_ = -1;
  std::filesystem::path folder_;  ///< of its output
};

}  // namespace redrive::testing
