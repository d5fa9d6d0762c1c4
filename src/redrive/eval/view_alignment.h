// SPDX-License-Identifier: Apache-2.0
// Test-time pose optimisation: where training refines poses, the poses of held-out images are only
// interpolated, so each is aligned to the frozen field before it is scored. Otherwise the score
// would measure the pose instead of the field. (Lin et al., "BARF", 2021, section 4.2.)
#pragma once

#include <span>

#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// Sizes of the pose corrections, RMS over the images.
struct ViewAlignment {
  int views = 0;
  double translation_m = 0, rotation_deg = 0;
};

/// Maximum rays of an optimisation step.
constexpr int kMaxAlignedRays = 16384;

/// Optimises the poses of scene->views[i] for each i of `views` (at least one), six parameters
/// each, by the photometric loss. `scene` is the run's. Throws InputError as load_view.
ViewAlignment align_views(const Run& run, kernels::Backend& backend,
                          std::span<const std::size_t> views, const Exclusions& left_out,
                          Scene* scene);

}  // namespace redrive
