// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/export_folder.h"

#include <unistd.h>

#include <string>

#include "redrive/base/error.h"

namespace redrive {

namespace fs = std::filesystem;

void check_export_folder(const char* option, const fs::path& folder, bool force,
                         const fs::path& marker) {
  if (folder.empty()) throw UsageError(option, "", "needs a folder");
  if (!fs::exists(fs::symlink_status(folder))) return;
  if (!force) throw UsageError(option, folder.string(), "exists; --force replaces it");
  if (!fs::is_directory(fs::symlink_status(folder)) || !fs::exists(folder / marker))
    throw UsageError(option, folder.string(),
                     "is no earlier export, which would have " + marker.string() +
                         "; --force does not replace it");
}

void write_export_folder(const fs::path& folder, const std::function<void(const fs::path&)>& fill) {
  const fs::path final = folder.has_filename() ? folder : folder.parent_path();  // "out/" is out
  const std::string suffix = ".tmp-" + std::to_string(::getpid());
  const fs::path temporary = final.string() + suffix, before = final.string() + ".old" + suffix;
  std::error_code error, ignored;
  if (final.has_parent_path()) fs::create_directories(final.parent_path(), error);
  if (error || !fs::create_directory(temporary, error))
    throw IoError(temporary, error ? error.message() : "exists already");
  try {
    fill(temporary);
    const bool replaces = fs::exists(final);
    if (replaces) fs::rename(final, before, error);
    if (error) throw IoError(final, error.message());
    fs::rename(temporary, final, error);
    if (error) {
      const std::string why = error.message();
      if (replaces) fs::rename(before, final, ignored);
      throw IoError(final, why);
    }
    if (replaces) fs::remove_all(before, ignored);
  } catch (...) {
    fs::remove_all(temporary, ignored);
    throw;
  }
}

}  // namespace redrive
