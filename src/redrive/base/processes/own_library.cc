// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/processes/own_library.h"

#include <dlfcn.h>

#include <filesystem>

namespace redrive {

void* load_own_library(const char* name, int flags, std::string* why) {
  std::error_code error;
  const std::filesystem::path folder =
      std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  for (const std::filesystem::path& file :
       {folder / name, folder / REDRIVE_LIBRARY_FOLDER / name}) {
    if (!std::filesystem::exists(file, error)) continue;
    void* const library = dlopen(file.c_str(), flags);
    if (!library) *why = dlerror();
    return library;
  }
  return nullptr;
}

}  // namespace redrive
