// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "redrive/base/host_device.h"

namespace redrive::kernels {

/// A sum that stands where a stage runs (one number, or none: 0), as a term of a loss: factor * sum
/// / over.
struct LossTerm {
  std::span<const double> sum;
  double over = 1, factor = 1;

  REDRIVE_HD double value() const { return sum.empty() ? 0 : factor * (sum[0] / over); }
};

}  // namespace redrive::kernels
