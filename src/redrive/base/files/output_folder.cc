// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/output_folder.h"

#include <string>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/unfinished.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// The file that marks every folder made here.
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

void write_output_folder(const char* option, const fs::path& folder, bool force,
                         const std::function<void(const fs::path&)>& fill) {
  write_folder(folder, force, [&](const fs::path& made) {
    check_output_folder(option, folder, force);  // again, now that no other process writes it
    fill(made);
    write_file(made / kMarker, "redrive made this folder; --force replaces it\n");
  });
}

}  // namespace redrive
