// SPDX-License-Identifier: Apache-2.0
// The beginning of a run's report: its score, an image beside its rendering, the command that made
// it, and what is missing with the command that makes it.
#pragma once

#include <string>
#include <utility>
#include <vector>

#include "redrive/report/report_images.h"

namespace redrive {

/// A run with its scores and the scores of each image.
struct ScoredRun {
  const Run* run;
  Evaluation evaluation;
  std::vector<std::pair<View, Score>> images;  ///< views at the poses that were scored
};
ScoredRun score_run(const Run& run, kernels::Backend& backend, EvalOptions options);

/// Returns the image whose PSNR is the median, the lower one of two; null without a score.
const View* median_view(const ScoredRun& scored);

/// Returns "PSNR 23.03 dB, SSIM 0.718, FLIP 0.167 on 8 held-out images" in plain text.
std::string score_text(const Evaluation& evaluation);

/// Returns the name of a recording's folder.
std::string recording_name(const Run& run);

/// Returns the images of median_view for the headline; none without a score.
ImageRow headline_images(const ScoredRun& own, const ScoredRun* compared,
                         kernels::Backend& backend);
/// Returns the headline as HTML. `images`: headline_images as HTML.
std::string headline(const ScoredRun& own, const ScoredRun* compared,
                     const kernels::Backend& backend, const std::string& images);

}  // namespace redrive
