// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/file_container.h"

#include <map>
#include <mutex>
#include <shared_mutex>
#include <string_view>

namespace redrive {
namespace {

struct Mounts {
  std::shared_mutex mutex;
  std::map<std::string, std::shared_ptr<const FileContainer>> by_folder;
};
Mounts& mounts() {
  static Mounts all;
  return all;
}

}  // namespace

void mount(const std::filesystem::path& folder, std::shared_ptr<const FileContainer> container) {
  const std::unique_lock lock(mounts().mutex);
  mounts().by_folder[(folder / "").string()] = std::move(container);
}

std::shared_ptr<const FileContainer> container_of(const std::filesystem::path& path) {
  const std::shared_lock lock(mounts().mutex);
  for (const auto& [folder, container] : mounts().by_folder)
    if (std::string_view(path.native()).starts_with(folder) && container->size(path))
      return container;
  return nullptr;
}

std::optional<std::uint64_t> file_bytes(const std::filesystem::path& path) {
  if (const auto container = container_of(path)) return container->size(path);
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(path, error);
  return error ? std::nullopt : std::optional<std::uint64_t>(size);
}

}  // namespace redrive
