// SPDX-License-Identifier: Apache-2.0
// Fixture of the end-to-end tests: runs the built program on a tiny drive in a temporary folder.
#pragma once

#include <stdlib.h>

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "tests/support/program.h"
#include "tests/support/tiny_recording.h"

namespace redrive::testing {

namespace fs = std::filesystem;

class EndToEnd : public ::testing::Test {
 protected:
  EndToEnd() { write_tiny_recording(drive_); }
  ~EndToEnd() override { fs::remove_all(folder_); }

  static ProgramResult redrive(const std::vector<std::string>& arguments,
                               std::optional<std::size_t> file_limit_bytes = {}) {
    return Program(REDRIVE_BINARY, arguments, file_limit_bytes).wait();
  }

  /// Arguments of a training that takes milliseconds a step, followed by `more`.
  std::vector<std::string> train_arguments(const fs::path& run,
                                           const std::vector<std::string>& more = {}) const {
    std::vector<std::string> arguments = {"train",           drive_.string(),
                                          "--out",           run.string(),
                                          "--method",        "nerf",
                                          "--width",         "32",
                                          "--samples",       "12",
                                          "--batch",         "128",
                                          "--learning-rate", "2e-3",
                                          "--threads",       "2"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return arguments;
  }

  /// Trains `steps` steps and returns the run's folder. Expects exit code 0.
  fs::path trained(const std::string& name, int steps, std::vector<std::string> more = {}) const {
    more.insert(more.end(), {"--epochs", "1000", "--max-steps", std::to_string(steps)});
    const ProgramResult ended = redrive(train_arguments(folder_ / name, more));
    EXPECT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
    return folder_ / name;
  }

  static fs::path new_folder() {
    std::string name = (fs::temp_directory_path() / "redrive-e2e-XXXXXX").string();
    return mkdtemp(name.data());
  }

  const fs::path folder_ = new_folder(), drive_ = folder_ / "drive";
};

/// The bytes of every file below a folder, by path.
inline std::map<std::string, std::string> contents(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder))
    if (entry.is_regular_file()) files[entry.path().string()] = read_file(entry.path());
  return files;
}

}  // namespace redrive::testing
