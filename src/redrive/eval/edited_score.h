// SPDX-License-Identifier: Apache-2.0
// Scores a run's edits of moving objects against images of the edited scene, which generators of
// recordings can make (tools/street, samples/street_traffic/edited).
//
// A folder of ground truth holds edit.json (edit/traffic_edit.h) and, by camera and frame,
// <CAM>_<frame id>.jpg or .png with <CAM>_<frame id>_changed.png, which has the size of the image
// and is white where the edit changed it, shadows included, and black elsewhere.
#pragma once

#include <filesystem>
#include <map>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "redrive/eval/evaluate.h"

namespace redrive {

struct EditedScore {
  Score inside;  ///< score of the changed pixels
  /// Score of the changed pixels whose surface some training image saw (eval/coverage.h): the
  /// others are guesses. Without images if there is none.
  Score seen;
  Score outside;  ///< score of the pixels that did not change
};

/// Returns scores by edit: `folder` is one, or its subfolders that hold an edit.json are. Renders
/// the images of the run's cameras and frames with edited objects at the run's poses, held-out
/// views registered as in evaluate(). options.max_images limits the images of each edit. InputError
/// without an edit or an image of the run, and as edit_actors and load_view.
std::map<std::string, EditedScore> score_edited(const Run& run, kernels::Backend& backend,
                                                const std::filesystem::path& folder,
                                                const EvalOptions& options = {});

/// Returns {"edited": {NAME: {"inside": SCORE, "seen": SCORE, "outside": SCORE}}}, SCORE as in
/// evaluation_to_json.
nlohmann::json edited_to_json(const std::map<std::string, EditedScore>& scores);

}  // namespace redrive
