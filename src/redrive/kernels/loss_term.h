// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <span>

#include "redrive/base/host_device.h"

namespace redrive::kernels {

/// A term of a loss: factor * sum / over. The sum is one number in the memory of the stage, or none
/// for 0.
struct LossTerm {
  std::span<const double> sum;
  double over = 1, factor = 1;

  REDRIVE_HD double value() const { return sum.empty() ? 0 : factor * (sum[0] / over); }
};

}  // namespace redrive::kernels
