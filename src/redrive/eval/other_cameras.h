// SPDX-License-Identifier: Apache-2.0
// Scores a run by cameras of its recording that it did not train on, such as the right one of a
// stereo pair after training on the left one: real images from a path that was not driven.
//
// Such a camera is mounted to the nearest camera of the run as the recording's calibration has it:
// corrections of that camera's extrinsics and time offset are applied to it, too. Where training
// refined poses, each image's pose is aligned to the frozen field (eval/view_alignment.h). The
// sensor's own sensitivity is one gain for each colour channel, the least-squares one over all
// scored images.
#pragma once

#include <array>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "redrive/eval/evaluate.h"

namespace redrive {

struct OtherCameraScore {
  Score score;
  std::array<double, 3> gains{1, 1, 1};         ///< r, g, b: applied before scoring
  std::optional<ViewAlignment> view_alignment;  ///< where training refined poses
  std::optional<MovingEvaluation> moving;       ///< empty where no image shows a moving object
};

/// Returns scores by camera name. Takes options.max_images images of each camera, evenly spaced,
/// kTrainingImagesPerCamera by default; their rendered images stay in memory. Throws UsageError for
/// a camera that was trained on, or that the recording lacks; InputError as load_view.
std::map<std::string, OtherCameraScore> score_other_cameras(const Run& run,
                                                            kernels::Backend& backend,
                                                            const std::vector<std::string>& names,
                                                            const EvalOptions& options = {});

/// Returns {"other_cameras": {CAM: SCORE and "gains": [3], "view_alignment" and "moving" as in
/// evaluation_to_json}}.
nlohmann::json other_cameras_to_json(const std::map<std::string, OtherCameraScore>& scores);

}  // namespace redrive
