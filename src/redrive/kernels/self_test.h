// SPDX-License-Identifier: Apache-2.0
// Whether stages compute Gaussians right on this machine: asked of a device before it is used.
#pragma once

#include <string>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive::kernels {

/// Trains 203 Gaussians for one step and compares each stage with the reference, with tolerances of
/// tests/conformance. Returns the first stage that fails and how, "image: off by 0.2, 0.002
/// allowed", or "". After a device's failure the stages can only be destroyed.
std::string self_test(GaussianStages& stages);

}  // namespace redrive::kernels
