// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/unfinished.h"

#include <atomic>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <string>

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr int kMostNames = 100;  ///< names of files that are written for one place at a time

std::atomic<int> unfinished{0};
std::atomic<int> finished{0};
static_assert(std::atomic<int>::is_always_lock_free);

/// Returns a hidden name that contains the program's own, so that it is no user's file.
fs::path beside(const fs::path& place, const std::string& ending) {
  std::string name = ".";
  name.append(place.filename().string()).append(ending);
  return place.parent_path() / name;
}

bool names(const fs::path& path, int descriptor) {
  struct stat here {
  }, there{};
  return fstat(descriptor, &here) == 0 && lstat(path.c_str(), &there) == 0 &&
         here.st_dev == there.st_dev && here.st_ino == there.st_ino;
}

int make_file(const fs::path& path) {
  return ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666);
}

int make_folder(const fs::path& path) {
  if (::mkdir(path.c_str(), 0777) != 0) return -1;
  return ::open(path.c_str(), O_RDONLY | O_DIRECTORY | O_NOFOLLOW | O_CLOEXEC);
}

/// Removes the leftover at `path` unless a living process holds its lock. Returns whether the name
/// is free now, or was taken and freed by others.
bool remove_leftover(const fs::path& path) {
  const int left = ::open(path.c_str(), O_RDONLY | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC);
  if (left < 0 && errno == ENOENT) return true;
  std::error_code error;
  bool is_free = false;
  if (left < 0) {  // a link, or another user's file
    is_free = fs::is_symlink(fs::symlink_status(path, error)) && fs::remove(path, error);
  } else if (::flock(left, LOCK_EX | LOCK_NB) == 0) {
    is_free = true;
    if (names(path, left)) fs::remove_all(path, error), is_free = !error;
  }
  if (left >= 0) ::close(left);
  return is_free;
}

/// Makes a file or folder that is locked. Returns its descriptor, or -1 with errno, which is EEXIST
/// where another process has it.
int make_locked(const fs::path& path, int (*make)(const fs::path&)) {
  constexpr int kTries = 8;
  for (int i = 0; i < kTries; ++i) {
    const int made = make(path);
    if (made < 0 && errno != EEXIST) return -1;
    if (made >= 0) {
      // Another process may take it for a leftover before it is locked.
      const bool taken = ::flock(made, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK;
      if (!taken && names(path, made)) return made;
      ::close(made);
    } else if (!remove_leftover(path)) {
      break;
    }
  }
  errno = EEXIST;
  return -1;
}

/// Records that the last unfinished file or folder is in place; others are parts of a folder.
void note_finished(bool is_in_place) {
  if (is_in_place && unfinished == 1) ++finished;
}

/// Makes the folder's new name durable. Some file systems cannot sync folders; the file is whole
/// anyway.
void sync_folder(const fs::path& folder) {
  const int file =
      ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (file < 0) return;
  ::fsync(file);
  ::close(file);
}

/// A folder beside its destination, removed unless it is moved there.
class UnfinishedFolder {
 public:
  explicit UnfinishedFolder(const fs::path& place) : path_(beside(place, ".redrive-tmp")) {
    ++unfinished;
    descriptor_ = make_locked(path_, make_folder);
    if (descriptor_ >= 0) return;
    const int why = errno;
    --unfinished;
    if (why == EEXIST)
      throw UsageError(
          place.string(), "",
          "is being written by another process, or " + path_.string() + " is in its way");
    throw IoError(path_, std::strerror(why));
  }
  ~UnfinishedFolder() {
    std::error_code ignored;
    if (!moved_) fs::remove_all(path_, ignored);
    ::close(descriptor_);
    --unfinished;
  }
  UnfinishedFolder(const UnfinishedFolder&) = delete;
  UnfinishedFolder& operator=(const UnfinishedFolder&) = delete;

  const fs::path& path() const { return path_; }
  void move_to(const fs::path& place, std::error_code& error) {
    fs::rename(path_, place, error);
    moved_ = !error;
    note_finished(moved_);
  }
  /// Exchanges both folders, so that one of them is in place at any time; the old one is then the
  /// unfinished one. Some network file systems cannot.
  void replace(const fs::path& place, std::error_code& error) {
    if (::renameat2(AT_FDCWD, path_.c_str(), AT_FDCWD, place.c_str(), RENAME_EXCHANGE) == 0)
      return note_finished(true);
    fs::remove_all(place, error);
    if (!error) move_to(place, error);
  }

 private:
  fs::path path_;
  int descriptor_ = -1;
  bool moved_ = false;
};

}  // namespace

bool has_unfinished() { return unfinished > 0; }
int finished_count() { return finished; }

UnfinishedFile::UnfinishedFile(const fs::path& place) : place_(place) {
  ++unfinished;
  for (int i = 1; i <= kMostNames && descriptor_ < 0; ++i) {
    path_ = beside(place, ".redrive-tmp" + (i == 1 ? "" : std::to_string(i)));
    descriptor_ = make_locked(path_, make_file);
    if (descriptor_ < 0 && errno != EEXIST) break;
  }
  if (descriptor_ >= 0) return;
  --unfinished;
  fail("create");
}

UnfinishedFile::~UnfinishedFile() {
  if (!path_.empty()) ::unlink(path_.c_str());
  ::close(descriptor_);
  --unfinished;
}

void UnfinishedFile::fail(const char* what) const {
  throw IoError(place_, std::string("cannot ") + what + ": " + std::strerror(errno));
}

void UnfinishedFile::write(std::string_view bytes) const {
  while (!bytes.empty()) {
    const ssize_t n = ::write(descriptor_, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) fail("write");
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
}

void UnfinishedFile::finish() {
  if (::fsync(descriptor_) != 0) fail("write to disk");
  if (::rename(path_.c_str(), place_.c_str()) != 0) fail("replace");
  path_.clear();
  note_finished(true);
  sync_folder(place_.parent_path());
}

void write_folder(const fs::path& folder, bool replace,
                  const std::function<void(const fs::path&)>& fill) {
  const fs::path place = folder.has_filename() ? folder : folder.parent_path();  // "out/" is out
  std::error_code error, ignored;
  if (place.has_parent_path()) fs::create_directories(place.parent_path(), error);
  if (error) throw IoError(place.parent_path(), error.message());
  UnfinishedFolder made(place);
  fill(made.path());
  if (replace && fs::is_directory(fs::status(place, ignored)))
    made.replace(place, error);
  else
    made.move_to(place, error);
  if (!error) return;
  if (fs::exists(fs::symlink_status(place, ignored)))
    throw UsageError(place.string(), "", "exists, since another process wrote it meanwhile");
  throw IoError(place, error.message());
}

}  // namespace redrive
