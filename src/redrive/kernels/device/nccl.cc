// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/device/nccl.h"

#include <dlfcn.h>

#include "redrive/base/error.h"

namespace redrive::kernels {
namespace {

constexpr int kMinVersion = 21000;  // the first with ncclAvg

std::string version_text(int version) {
  return std::to_string(version / 10000) + "." + std::to_string(version / 100 % 100) + "." +
         std::to_string(version % 100);
}

/// Loaded once and never unloaded.
struct NcclLibrary {
  Nccl functions;
  std::optional<std::string> obstacle;

  NcclLibrary() {
    void* const library = dlopen("libnccl.so.2", RTLD_NOW | RTLD_LOCAL);
    if (!library) {
      obstacle = dlerror();
      return;
    }
    const auto find = [&](const char* name, auto* function) {
      *function = reinterpret_cast<std::remove_pointer_t<decltype(function)>>(dlsym(library, name));
      if (!*function && !obstacle) obstacle = std::string("libnccl.so.2 has no ") + name;
    };
    find("ncclGetVersion", &functions.ncclGetVersion);
    find("ncclGetErrorString", &functions.ncclGetErrorString);
    find("ncclCommInitAll", &functions.ncclCommInitAll);
    find("ncclCommAbort", &functions.ncclCommAbort);
    find("ncclCommGetAsyncError", &functions.ncclCommGetAsyncError);
    find("ncclGroupStart", &functions.ncclGroupStart);
    find("ncclGroupEnd", &functions.ncclGroupEnd);
    find("ncclAllReduce", &functions.ncclAllReduce);
    if (obstacle) return;
    if (functions.ncclGetVersion(&functions.version) != Nccl::kSuccess)
      obstacle = "libnccl.so.2 does not report its version";
    else if (functions.version < kMinVersion)
      obstacle =
          "libnccl.so.2 is " + version_text(functions.version) + ", at least 2.10 is required";
  }
};

const NcclLibrary& nccl_library() {
  static const NcclLibrary library;
  return library;
}

}  // namespace

std::optional<std::string> nccl_obstacle() { return nccl_library().obstacle; }

const Nccl& nccl() {
  REDRIVE_CHECK(!nccl_obstacle());
  return nccl_library().functions;
}

std::string nccl_version() { return version_text(nccl().version); }

}  // namespace redrive::kernels
