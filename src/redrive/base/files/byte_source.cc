// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/byte_source.h"

#include <algorithm>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include "redrive/base/error.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

class FileBytes : public ByteSource {
 public:
  explicit FileBytes(const fs::path& path)
      : path_(path), fd_(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)) {
    struct stat status {};
    if (fd_ < 0 || ::fstat(fd_, &status) != 0) fail(std::strerror(errno));
    if (!S_ISREG(status.st_mode)) fail("is no regular file");
    size_ = static_cast<std::uint64_t>(status.st_size);
    // Gigabytes often lie between the parts that are read: reading ahead would fetch them.
    ::posix_fadvise(fd_, 0, 0, POSIX_FADV_RANDOM);
  }
  ~FileBytes() override { ::close(fd_); }
  FileBytes(const FileBytes&) = delete;
  FileBytes& operator=(const FileBytes&) = delete;

  std::uint64_t size() const override { return size_; }
  std::string read(std::uint64_t offset, std::size_t size) const override {
    std::string bytes(offset >= size_ ? 0 : std::min<std::uint64_t>(size, size_ - offset), '\0');
    for (std::size_t have = 0; have < bytes.size();) {
      const ssize_t n =
          ::pread(fd_, bytes.data() + have, bytes.size() - have, static_cast<off_t>(offset + have));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) fail(std::strerror(errno));
      if (n == 0) bytes.resize(have);
      have += static_cast<std::size_t>(n);
    }
    return bytes;
  }

 private:
  [[noreturn]] void fail(const std::string& rule) const { throw InputError(path_, "", "", rule); }

  fs::path path_;
  int fd_;
  std::uint64_t size_ = 0;
};

}  // namespace

std::unique_ptr<ByteSource> open_bytes(const fs::path& path) {
  return std::make_unique<FileBytes>(path);
}

}  // namespace redrive
