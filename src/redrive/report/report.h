// SPDX-License-Identifier: Apache-2.0
// The report's figures from a run, as PNG, and one self-contained HTML page (images inside, no
// network).
#pragma once

#include <filesystem>
#include <functional>

#include "redrive/eval/evaluate.h"
#include "redrive/train/run.h"

namespace redrive {

struct FigureOptions {
  const Run* beside = nullptr;  ///< another run of the recording, to compare with; null: none
  EvalOptions eval;             ///< of the scores
  std::function<void(const std::filesystem::path&)>
      written;  ///< called with each file once it is there; may be empty
};

/// figures/loss.png and psnr.png (history of training) and, where it refined poses, poses_moved.png
/// and poses_turned.png (frames over time), with their gnuplot scripts beside them; per camera CAM
/// of a randomly chosen (seeded) training image: figures/CAM_original.png, CAM_reproduced.png,
/// CAM_perturbed.png (extrinsic translated by 0.5 m along x, body axes),
/// CAM_perturbed_camera_axes.png, CAM_depth.png (false colours); of each novel set NAME with truth:
/// NAME_truth.png, NAME_render.png, NAME_difference.png, NAME_coverage.png; of options.beside
/// CAM_beside.png and NAME_beside.png; then report.html with all of them, the options and the
/// scores. IoError where gnuplot is missing.
void write_figures(const Run& run, kernels::Backend& backend, const FigureOptions& options = {});

}  // namespace redrive
