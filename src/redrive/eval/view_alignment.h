// SPDX-License-Identifier: Apache-2.0
// Where training refines poses, those of held-out pictures stay what lies between their
// neighbours': each is laid onto the frozen field before it is scored, or a score would tell of its
// pose instead of the field. (As Lin et al., "BARF", 2021, section 4.2 do.)
#pragma once

#include <span>

#include "redrive/kernels/backend.h"
#include "redrive/train/run.h"
#include "redrive/train/training_data.h"

namespace redrive {

/// By how much, RMS over the pictures.
struct ViewAlignment {
  int views = 0;
  double translation_m = 0, rotation_deg = 0;
};

/// A step of it has so many, at most.
constexpr int kMaxAlignedRays = 16384;

/// Moves scene->views[i] for each i of `views`, at least one, by the six numbers that make their
/// pictures most alike. `scene` is the run's. InputError as load_view.
ViewAlignment align_views(const Run& run, kernels::Backend& backend,
                          std::span<const std::size_t> views, const Exclusions& left_out,
                          Scene* scene);

}  // namespace redrive
