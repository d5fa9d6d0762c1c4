// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/memory_limit.h"

#include <algorithm>
#include <charconv>
#include <fstream>
#include <optional>
#include <string>

#include "redrive/base/error.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

/// Returns the number at the start of a file; nothing if the file is missing or contains "max".
std::optional<std::uint64_t> number_in(const fs::path& file) {
  std::ifstream in(file);
  std::uint64_t value = 0;
  if (!(in >> value)) return std::nullopt;
  return value;
}

std::uint64_t installed(const fs::path& file) {
  std::ifstream in(file);
  std::string name;
  std::uint64_t kib = 0;
  while (in >> name) {
    if (name == "MemTotal:" && in >> kib) return 1024 * kib;
    std::getline(in, name);
  }
  throw IoError(file, "has no MemTotal");
}

}  // namespace

std::uint64_t memory_bytes(const fs::path& root) {
  std::uint64_t least = installed(root / "proc/meminfo");
  std::ifstream groups(root / "proc/self/cgroup");
  for (std::string line; std::getline(groups, line);) {  // hierarchy:controllers:/path/of/the/group
    const std::size_t first = line.find(':'), second = line.find(':', first + 1);
    if (second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1);
    const bool unified = controllers.empty();
    if (!unified && ("," + controllers + ",").find(",memory,") == std::string::npos) continue;
    const fs::path mount = root / (unified ? "sys/fs/cgroup" : "sys/fs/cgroup/memory");
    // Inside a container the path may be the host's and not be there; the container's own limit is
    // then at the top.
    for (fs::path group = fs::path(line.substr(second + 1)).relative_path();;
         group = group.parent_path()) {
      const auto limit =
          number_in(mount / group / (unified ? "memory.max" : "memory.limit_in_bytes"));
      least = std::min(least, limit.value_or(least));
      if (group.empty()) break;
    }
  }
  return least;
}

}  // namespace redrive
