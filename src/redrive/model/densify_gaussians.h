// SPDX-License-Identifier: Apache-2.0
// Changes the number of Gaussians during training: transparent ones are removed, and those in
// regions of large error are split. The Gaussians stay ordered along a Morton curve, so that what a
// camera sees lies together in memory.
#pragma once

#include <cstdint>

#include "redrive/model/initial_gaussians.h"
#include "redrive/model/model.h"

namespace redrive {

struct DensifyOptions {
  std::size_t target = 0;     ///< number of Gaussians afterwards, at most
  float min_opacity = 0.01f;  ///< less is removed
  float min_scale = 6e-4f;    ///< of the largest axis, of the distance: smaller ones are not split
};

/// Writes Gaussians in Morton order into blocks; unused lanes are transparent.
void write_blocks(const GaussianList& list, Buffer<float>* numbers);

/// Splits Gaussians along their longest axis into two, drawn without replacement with probabilities
/// proportional to their summed error (the row kDistanceRow of the first moment), and removes
/// transparent ones. Sets the summed errors to 0. Parents keep their second moments, children start
/// without first moments. `tail`: numbers behind the Gaussians' blocks in each buffer, which stay.
/// Deterministic in key. Returns the number of Gaussians.
std::size_t densify(const DensifyOptions& options, std::uint64_t key, std::size_t n,
                    std::size_t tail, Buffer<float>* numbers, AdamState* adam);

}  // namespace redrive
