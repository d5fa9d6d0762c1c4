// SPDX-License-Identifier: Apache-2.0
// NCCL, the library that reduces arrays over several GPUs. It is loaded at run time where it is
// needed, so that builds and runs on one GPU do not depend on it.
#pragma once

#include <cstddef>
#include <optional>
#include <string>

namespace redrive::kernels {

/// The functions in use, as NCCL's manual declares them (2.10 and later), with void pointers for
/// communicators and CUDA streams.
struct Nccl {
  static constexpr int kSuccess = 0, kInProgress = 7;  // ncclResult_t
  static constexpr int kFloat32 = 7, kAvg = 4;         // ncclDataType_t, ncclRedOp_t

  int version = 0;  ///< 22803 is 2.28.3
  int (*ncclGetVersion)(int* version) = nullptr;
  const char* (*ncclGetErrorString)(int result) = nullptr;
  int (*ncclCommInitAll)(void** comms, int devices, const int* list) = nullptr;
  int (*ncclCommAbort)(void* comm) = nullptr;  ///< frees it without waiting for other ranks
  int (*ncclCommGetAsyncError)(void* comm, int* result) = nullptr;
  int (*ncclGroupStart)() = nullptr;
  int (*ncclGroupEnd)() = nullptr;
  int (*ncclAllReduce)(const void* send, void* receive, std::size_t count, int type, int operation,
                       void* comm, void* stream) = nullptr;
};

/// Returns why NCCL cannot be used (not found, too old), or nothing if it can.
std::optional<std::string> nccl_obstacle();
/// Returns the loaded library. There must be no obstacle.
const Nccl& nccl();
std::string nccl_version();  ///< "2.28.3"; there must be no obstacle

}  // namespace redrive::kernels
