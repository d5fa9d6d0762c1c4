// SPDX-License-Identifier: Apache-2.0
// Marks the scalar functions that run on a GPU as well (kernels/cuda), where they are the ones that
// run here: one formula, one place.
#pragma once

#ifdef __CUDACC__
#define REDRIVE_HD __host__ __device__
#else
#define REDRIVE_HD
#endif
