// SPDX-License-Identifier: Apache-2.0
#pragma once

#include <vector>

#include "redrive/field/gaussian.h"

namespace redrive {

/// Gaussians one after the other: [n][kGaussianRows].
struct GaussianList {
  std::vector<float> rows;
  std::size_t size() const { return rows.size() / kGaussianRows; }
};

}  // namespace redrive
