// SPDX-License-Identifier: Apache-2.0
// Scores moving objects apart from the world behind them.
#pragma once

#include <cstdint>
#include <map>
#include <string>

#include "redrive/eval/score_mean.h"
#include "redrive/perception/masks.h"

namespace redrive {

/// Images with fewer pixels of an object, or of all of them, do not count.
constexpr std::int64_t kLeastObjectPixels = 100;

/// Adds up scores of images. Pixels of moving objects are pixels whose rays meet a box, grown by
/// kBoxMargin_m, even where the model does not draw it.
class MovingScores {
 public:
  MovingScores(const Run& run, kernels::Backend& backend);

  /// `ground_truth`: not masked yet; of_camera: the camera's mask.
  void add(const Scene& scene, const View& view, const Mask& of_camera,
           const RenderedImage& rendered, const Image8& ground_truth);
  /// Returns nothing where no image shows a moving object.
  std::optional<MovingEvaluation> mean() const;

 private:
  kernels::Backend& backend_;
  MovingObjects objects_;
  ScoreMean inside_, outside_;
  int images_ = 0;
  std::map<std::size_t, ScoreMean> of_object_;  ///< key: index in objects_
};

}  // namespace redrive
