// SPDX-License-Identifier: Apache-2.0
// The report's figures from a run, as PNG, and one self-contained HTML page (images inside, no network).
#pragma once

#include "redrive/eval/evaluate.h"
#include "redrive/train/run.h"

namespace redrive {

/// figures/loss.png (training-loss history), and per camera CAM of a randomly chosen (seeded) training image:
/// figures/CAM_original.png, CAM_reproduced.png, CAM_perturbed.png (extrinsic translated by 0.5 m along x, body axes),
/// CAM_perturbed_camera_axes.png, CAM_depth.png; then report.html with all of them, the options and the scores.
void write_figures(const Run& run, kernels::Backend& backend);

}  // namespace redrive
