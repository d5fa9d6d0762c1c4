// SPDX-License-Identifier: Apache-2.0
// Writes the figures of a run as PNG, and one self-contained HTML page.
#pragma once

#include "redrive/eval/evaluate.h"
#include "redrive/train/run.h"

namespace redrive {

struct FigureOptions {
  const Run* compared = nullptr;  ///< another run of the same recording; null: none
  EvalOptions eval;               ///< which images are scored
};

/// Writes below figures/:
/// - loss.png and psnr.png (training history) and, where training refined poses, poses_moved.png
///   and poses_turned.png (corrections of the frames over time), each with its gnuplot script;
/// - per camera CAM, for a training image drawn by the run's seed: CAM_original.png,
///   CAM_reproduced.png, CAM_perturbed.png (camera shifted by 0.5 m along x of the body),
///   CAM_perturbed_camera_axes.png (along x of the camera), CAM_depth.png;
/// - per novel set NAME with ground truth: NAME_truth.png, NAME_render.png, NAME_difference.png,
///   NAME_coverage.png;
/// - headline_recorded.png and headline_rendered.png: the scored image whose PSNR is the median;
/// - headline_beside.png, CAM_beside.png and NAME_beside.png by options.compared;
/// then report.html, which begins with the score, and has all of them, and the options. Returns the
/// scores. IoError where gnuplot is missing.
Evaluation write_figures(const Run& run, kernels::Backend& backend,
                         const FigureOptions& options = {});

}  // namespace redrive
