// SPDX-License-Identifier: Apache-2.0
// Files and folders that are written beside their destination and moved there when complete.
//
// Their names are new, so no existing file or link is overwritten. Each is locked while its process
// lives, which distinguishes the leftovers of a dead process, which are removed, from the output of
// a living one. On file systems without locks leftovers stay.
#pragma once

#include <filesystem>
#include <functional>
#include <string_view>

namespace redrive {

/// A file beside `place`, removed unless it is finished. Several may be written for one place.
class UnfinishedFile {
 public:
  explicit UnfinishedFile(const std::filesystem::path& place);  ///< IoError
  ~UnfinishedFile();
  UnfinishedFile(const UnfinishedFile&) = delete;
  UnfinishedFile& operator=(const UnfinishedFile&) = delete;

  const std::filesystem::path& path() const { return path_; }
  void write(std::string_view bytes) const;  ///< IoError
  /// Moves the file, once it is on disk, to its destination and replaces what lies there. IoError.
  void finish();

 private:
  [[noreturn]] void fail(const char* what) const;

  std::filesystem::path place_, path_;
  int descriptor_ = -1;
};

/// Makes a folder beside `place`, calls `fill` with it and moves it to `place`, where nothing or an
/// empty folder may lie, or with `replace` any folder, which is then removed. If anything throws,
/// everything is as before. UsageError if another process is writing it or has written it
/// meanwhile; IoError.
void write_folder(const std::filesystem::path& place, bool replace,
                  const std::function<void(const std::filesystem::path& folder)>& fill);

/// Whether this process has an unfinished file or folder. A signal handler may call it.
bool has_unfinished();
/// Returns how many this process finished, without those within an unfinished folder. A signal
/// handler may call it.
int finished_count();

}  // namespace redrive
