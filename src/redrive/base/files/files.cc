// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/files.h"

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/files/unfinished.h"
#include "redrive/base/memory_limit.h"

namespace redrive {
namespace {

/// A regular file that is open for reading.
class InputFile {
 public:
  explicit InputFile(const std::filesystem::path& path)
      // O_NONBLOCK: a pipe without a writer must not block.
      : path_(path), fd_(::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC)) {
    struct stat status {};
    const bool there = fd_ >= 0 && ::fstat(fd_, &status) == 0;
    const int why = errno;
    if (there && S_ISREG(status.st_mode)) {
      size_ = static_cast<std::uint64_t>(status.st_size);
      return;
    }
    if (fd_ >= 0) ::close(fd_);
    if (!there) fail(std::strerror(why));
    fail(S_ISDIR(status.st_mode) ? "is a folder, a file was expected"
                                 : "is a pipe or a device, a regular file was expected");
  }
  ~InputFile() { ::close(fd_); }
  InputFile(const InputFile&) = delete;
  InputFile& operator=(const InputFile&) = delete;

  std::uint64_t size() const { return size_; }
  /// Reads at most `size` bytes; none at the file's end.
  std::size_t read(char* bytes, std::size_t size) const {
    while (true) {
      const ssize_t n = ::read(fd_, bytes, size);
      if (n >= 0) return static_cast<std::size_t>(n);
      if (errno != EINTR) fail(std::strerror(errno));
    }
  }
  /// Reads at most `size` bytes from there on; fewer only where the file ends.
  std::string read_at(std::uint64_t offset, std::size_t size) const {
    std::string bytes(size, '\0');
    std::size_t have = 0;
    while (have < size) {
      const ssize_t n =
          ::pread(fd_, bytes.data() + have, size - have, static_cast<off_t>(offset + have));
      if (n == 0) break;
      if (n > 0)
        have += static_cast<std::size_t>(n);
      else if (errno != EINTR)
        fail(std::strerror(errno));
    }
    bytes.resize(have);
    return bytes;
  }
  [[noreturn]] void fail(const std::string& rule) const { throw InputError(path_, "", "", rule); }

 private:
  const std::filesystem::path& path_;
  int fd_;
  std::uint64_t size_ = 0;
};

constexpr int kMaxLevels = 64;

/// Puts quotes around NaN, Infinity and -Infinity, which JSON does not have and Python writes, so
/// that they are wrong where a number belongs and nowhere else. Empty if there is none.
std::string with_quoted_numbers(std::string_view text) {
  std::string quoted;
  std::size_t copied = 0;
  if (text.find("NaN") == text.npos && text.find("Infinity") == text.npos) return quoted;
  bool in_string = false;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '"') in_string = !in_string;
    if (in_string && text[i] == '\\') ++i;
    if (in_string) continue;
    for (const std::string_view word : {"NaN", "Infinity", "-Infinity"})
      if (text.substr(i).starts_with(word)) {
        quoted.append(text.substr(copied, i - copied)).append(1, '"').append(word).append(1, '"');
        copied = i + word.size();
        i = copied - 1;
        break;
      }
  }
  return quoted.empty() ? quoted : quoted.append(text.substr(copied));
}

/// Returns the most brackets that are open at a time. Up to the first fault of the text that is
/// right; the parser says where that is.
int json_levels(std::string_view text) {
  int level = 0, most = 0;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '"') {
      for (++i; i < text.size() && text[i] != '"'; ++i)
        if (text[i] == '\\') ++i;
    } else if (c == '[' || c == '{') {
      most = std::max(most, ++level);
    } else if (c == ']' || c == '}') {
      --level;
    }
  }
  return most;
}

}  // namespace

std::string read_file(const std::filesystem::path& path, std::uint64_t most) {
  const auto container = container_of(path);
  if (container && container->size(path) <= most) return container->read(path, most);
  const InputFile file(path);
  // Asks for the machine's memory only where it may matter.
  if (file.size() > kMaxTextBytes) most = std::min(most, memory_bytes());
  const auto check = [&](std::uint64_t size) {
    if (size > most)
      throw InputError(path, "size", std::to_string(size) + " bytes",
                       "such a file may have " + std::to_string(most));
  };
  check(file.size());
  std::string bytes;
  bytes.reserve(file.size());
  char block[1 << 16];
  while (const std::size_t n = file.read(block, sizeof block)) {
    bytes.append(block, n);
    check(bytes.size());  // files of /proc have more than their size
  }
  return bytes;
}

std::string read_head(const std::filesystem::path& path, std::size_t size) {
  if (const auto container = container_of(path)) return container->read(path, size);
  return InputFile(path).read_at(0, size);
}

FileEnds read_ends(const std::filesystem::path& path, std::size_t head, std::size_t tail) {
  if (const auto container = container_of(path))
    return {container->size(path).value_or(0), container->read(path, head), ""};
  const InputFile file(path);
  const auto within = [&](std::size_t size) {
    return static_cast<std::size_t>(std::min<std::uint64_t>(size, file.size()));
  };
  return {file.size(), file.read_at(0, within(head)),
          file.read_at(file.size() - within(tail), within(tail))};
}

void read_blocks(const std::filesystem::path& path,
                 const std::function<void(std::string_view)>& take) {
  const InputFile file(path);
  std::string block(1 << 20, '\0');
  while (const std::size_t n = file.read(block.data(), block.size()))
    take(std::string_view(block).substr(0, n));
}

void write_file(const std::filesystem::path& path, std::string_view bytes) {
  write_file(path, std::span(&bytes, 1));
}

void write_file(const std::filesystem::path& path, std::span<const std::string_view> parts) {
  UnfinishedFile file(path);
  for (const std::string_view bytes : parts) file.write(bytes);
  file.finish();
}

void make_folders_within(const std::filesystem::path& root, const std::filesystem::path& folders) {
  std::filesystem::path folder = root;
  std::error_code error;
  for (const std::filesystem::path& part : folders) {
    folder /= part;
    std::filesystem::create_directory(folder, error);
    const auto there = std::filesystem::symlink_status(folder);
    if (std::filesystem::is_symlink(there))
      throw IoError(folder, "is a link; nothing is written outside of " + root.string());
    if (error || !std::filesystem::is_directory(there))
      throw IoError(folder, error ? error.message() : "is no folder");
  }
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
  // the stack. Counted here, since a parser with a callback takes quadratic time (nlohmann 3.11).
  if (json_levels(text) > kMaxLevels)
    throw InputError(path, "", "", "not usable JSON: nested deeper than 64 levels");
  try {
    const std::string quoted = with_quoted_numbers(text);
    return nlohmann::json::parse(quoted.empty() ? text : quoted);
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
