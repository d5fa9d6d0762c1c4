// SPDX-License-Identifier: Apache-2.0
// A page that shows a run's Gaussians with the browser's GPU, and needs nothing else.
#pragma once

#include <string>

#include "redrive/train/run.h"

namespace redrive::view {

/// Returns an HTML file: the renderer (page/scene.ts with its packages, bundled), the Gaussians
/// (model/gaussian_spz.h) with the colour behind them, and the drive of the run's first
/// camera, whose first pose and vertical field of view it starts with. Colours are the field's,
/// without exposure. sh_degree: 0 or 1. Throws UsageError where the run has no Gaussians, and
/// where the build has no pages (view/page.h).
std::string scene_page(const Run& run, int sh_degree);

}  // namespace redrive::view
