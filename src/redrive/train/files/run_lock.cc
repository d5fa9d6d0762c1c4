// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/run_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "redrive/base/error.h"

namespace redrive {

RunLock::RunLock(const std::filesystem::path& root)
    : fd_(::open(root.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
  if (fd_ < 0)
    throw InputError(
        root, "", "",
        errno == ENOENT || errno == ENOTDIR ? "no such run folder" : std::strerror(errno));
  // File systems that cannot lock folders (some network ones) train without a lock.
  if (::flock(fd_, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK) {
    ::close(fd_);
    throw UsageError(root.string(), "", "is being trained by another process");
  }
}

RunLock::~RunLock() { ::close(fd_); }

}  // namespace redrive
