// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/output_folder.h"

#include <string>

#include "redrive/base/error.h"
#include "redrive/base/files.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// A file of every folder that was made here, and of no other.
constexpr const char* kMarker = ".redrive-export";

}  // namespace

void check_output_folder(const char* option, const fs::path& folder, bool force) {
  if (folder.empty()) throw UsageError(option, "", "needs a folder");
  if (!fs::exists(fs::symlink_status(folder))) return;
  if (!force) throw UsageError(option, folder.string(), "exists; --force replaces it");
  if (!fs::is_directory(fs::symlink_status(folder)) || !fs::exists(folder / kMarker))
    throw UsageError(option, folder.string(),
                     "is no folder that redrive made, which would have " + std::string(kMarker) +
                         "; --force does not replace it");
}

void write_output_folder(const fs::path& folder, const std::function<void(const fs::path&)>& fill) {
  const fs::path final = folder.has_filename() ? folder : folder.parent_path();  // "out/" is out
  const auto beside = [&](const char* ending) {
    return final.parent_path() / ("." + final.filename().string() + ending);
  };
  const fs::path temporary = beside(".redrive-tmp"), before = beside(".redrive-old");
  std::error_code error, ignored;
  if (final.has_parent_path()) fs::create_directories(final.parent_path(), error);
  fs::remove_all(temporary, ignored);  // left by a program that was killed
  if (error || !fs::create_directory(temporary, error))
    throw IoError(temporary, error ? error.message() : "exists already");
  try {
    fill(temporary);
    write_file(temporary / kMarker, "redrive made this folder; --force replaces it\n");
    const bool replaces = fs::exists(final);
    if (replaces) {
      fs::remove_all(before, ignored);
      fs::rename(final, before, error);
    }
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
