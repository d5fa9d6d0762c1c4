// SPDX-License-Identifier: Apache-2.0
// What a run is worth: renders against images that were not trained on (held-out frames, else the training frames) and
// against the truth of novel views where the recording ships it.
#pragma once

#include <map>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "redrive/render/renderer.h"
#include "redrive/train/run.h"

namespace redrive {

struct Score {
  double psnr_db = 0, ssim = 0;  ///< means over images
  int images = 0;
};

struct Evaluation {
  bool held_out = true;                  ///< false: no frame was held out, training frames were scored
  Score overall;
  std::map<std::string, Score> cameras;
  std::map<std::string, Score> novel;    ///< by novel/<name>; empty where there is no truth
};

Evaluation evaluate(const Run& run, kernels::Backend& backend);
nlohmann::json evaluation_to_json(const Evaluation& evaluation);

}  // namespace redrive
