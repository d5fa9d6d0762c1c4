// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files.h"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>
#include <utility>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// A file descriptor that closes itself.
class Descriptor {
 public:
  Descriptor(const std::filesystem::path& path, int flags)
      : fd_(::open(path.c_str(), flags | O_CLOEXEC, 0666)) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }
  bool ok() const { return fd_ >= 0; }
  bool close() { return ::close(std::exchange(fd_, -1)) == 0; }

 private:
  int fd_;
};

bool write_all(int fd, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}

}  // namespace

std::string read_file(const std::filesystem::path& path) {
  const Descriptor file(path, O_RDONLY);
  struct stat status {};
  if (!file.ok() || ::fstat(file.get(), &status) != 0)
    throw InputError(path, "", "", std::strerror(errno));
  if (S_ISDIR(status.st_mode)) throw InputError(path, "", "", "is a folder, a file was expected");
  std::string bytes;
  bytes.reserve(static_cast<std::size_t>(status.st_size));
  char block[1 << 16];
  while (true) {
    const ssize_t n = ::read(file.get(), block, sizeof(block));
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) throw InputError(path, "", "", std::strerror(errno));
    if (n == 0) return bytes;
    bytes.append(block, static_cast<std::size_t>(n));
  }
}

void write_file(const std::filesystem::path& path, std::string_view bytes) {
  write_file(path, std::span(&bytes, 1));
}

void write_file(const std::filesystem::path& path, std::span<const std::string_view> parts) {
  // A fixed name, so that the next write replaces the leftover of a killed process; hidden and with
  // the program's name, so that it is no user's file.
  const std::filesystem::path temporary =
      path.parent_path() / std::string(".").append(path.filename().string()).append(".redrive-tmp");
  const auto fail = [&](const char* what) {
    const int error = errno;
    ::unlink(temporary.c_str());
    throw IoError(path, std::string("cannot ") + what + ": " + std::strerror(error));
  };
  Descriptor file(temporary, O_WRONLY | O_CREAT | O_TRUNC);
  if (!file.ok()) fail("create");
  for (const std::string_view bytes : parts)
    if (!write_all(file.get(), bytes)) fail("write");
  if (::fsync(file.get()) != 0) fail("write to disk");
  if (!file.close()) fail("close");
  if (::rename(temporary.c_str(), path.c_str()) != 0) fail("replace");
  // The new name is durable once the folder is on disk, too. Some file systems cannot sync folders;
  // the file is whole anyway.
  const Descriptor folder(path.has_parent_path() ? path.parent_path() : ".",
                          O_RDONLY | O_DIRECTORY);
  if (folder.ok()) ::fsync(folder.get());
}

bool has_extension(const std::filesystem::path& path,
                   std::initializer_list<std::string_view> extensions) {
  std::string own = path.extension().string();
  std::transform(own.begin(), own.end(), own.begin(),
                 [](unsigned char c) { return std::tolower(c); });
  return std::find(extensions.begin(), extensions.end(), own) != extensions.end();
}

nlohmann::json parse_json(std::string_view text, const std::filesystem::path& path) {
  // Printing a value, as messages do, recurses once per level: a file of brackets would overflow
  // the stack.
  const auto shallow = [&](int depth, nlohmann::json::parse_event_t, nlohmann::json&) {
    if (depth > 64) throw InputError(path, "", "", "not usable JSON: nested deeper than 64 levels");
    return true;
  };
  try {
    return nlohmann::json::parse(text, shallow);
  } catch (const nlohmann::json::exception& error) {
    // "[json.exception.parse_error.101] parse error at line 1, column 5: ..." without the library's
    // own name.
    std::string_view what = error.what();
    if (const std::size_t end = what.find("] "); what.starts_with("[") && end != what.npos)
      what.remove_prefix(end + 2);
    throw InputError(path, "", "", "not valid JSON: " + std::string(what));
  }
}

nlohmann::json read_json(const std::filesystem::path& path) {
  return parse_json(read_file(path), path);
}

}  // namespace redrive
