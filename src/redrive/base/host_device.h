// SPDX-License-Identifier: Apache-2.0
// Marks scalar functions that run on the host and on a GPU.
#pragma once

#ifdef __CUDACC__
#define REDRIVE_HD __host__ __device__
#else
#define REDRIVE_HD
#endif
