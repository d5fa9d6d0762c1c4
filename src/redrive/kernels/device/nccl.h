// SPDX-License-Identifier: Apache-2.0
// NCCL, which adds up the numbers of several GPUs: looked for where it is needed, so that neither
// builds nor runs on one GPU ask for it.
#pragma once

#include <cstddef>
#include <optional>
#include <string>

namespace redrive::kernels {

/// What is used of it, as its manual declares it (2.10 and later), with pointers for its
/// communicators and CUDA's streams.
struct Nccl {
  static constexpr int kSuccess = 0, kInProgress = 7;  // ncclResult_t
  static constexpr int kFloat32 = 7, kAvg = 4;         // ncclDataType_t, ncclRedOp_t

  int version = 0;  ///< 22803: 2.28.3
  int (*ncclGetVersion)(int* version) = nullptr;
  const char* (*ncclGetErrorString)(int result) = nullptr;
  int (*ncclCommInitAll)(void** comms, int devices, const int* list) = nullptr;
  int (*ncclCommAbort)(void* comm) = nullptr;  ///< lets go of it, waiting for nobody
  int (*ncclCommGetAsyncError)(void* comm, int* result) = nullptr;
  int (*ncclGroupStart)() = nullptr;
  int (*ncclGroupEnd)() = nullptr;
  int (*ncclAllReduce)(const void* send, void* receive, std::size_t count, int type, int operation,
                       void* comm, void* stream) = nullptr;
};

/// Why it cannot be used here: not found, too old. Nothing if it can.
std::optional<std::string> nccl_obstacle();
/// There must be no obstacle.
const Nccl& nccl();
std::string nccl_version();  ///< "2.28.3", likewise

}  // namespace redrive::kernels
