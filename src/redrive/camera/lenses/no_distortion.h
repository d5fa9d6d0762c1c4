// SPDX-License-Identifier: Apache-2.0
// The Radial of models whose plane is the image (camera/lenses/lens.h).
#pragma once

#include "redrive/camera/lenses/lens.h"

namespace redrive {

struct NoDistortion {
  template <class M, class Numbers>
  static REDRIVE_LANES RadialFactor<M> radial_factor(const Numbers&, typename M::Real) {
    return {M::constant(1), M::constant(0)};
  }
};

}  // namespace redrive
