// SPDX-License-Identifier: Apache-2.0
// Checks of a file that a command will write.
#pragma once

#include <filesystem>

#include "redrive/base/error.h"

namespace redrive {

/// Throws UsageError naming `option` unless the file's folder exists and the file does not, or
/// `force` allows to overwrite it.
inline void check_output_file(const char* option, const std::filesystem::path& file, bool force) {
  if (const std::filesystem::path folder = file.parent_path();
      !folder.empty() && !std::filesystem::is_directory(folder))
    throw UsageError(option, file.string(), "its folder does not exist");
  if (std::filesystem::is_directory(file)) throw UsageError(option, file.string(), "is a folder");
  if (std::filesystem::exists(file) && !force)
    throw UsageError(option, file.string(), "exists; --force overwrites it");
}

}  // namespace redrive
