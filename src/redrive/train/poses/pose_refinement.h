// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "redrive/model/hyperparameters.h"

namespace redrive {

/// Bounds of pose corrections along each axis. Larger errors need redrive align, or are mistakes
/// that refinement must not hide.
struct PoseBounds {
  float translation_m = 0.5f, rotation_rad = 0.035f, time_offset_s = 0.05f;
};

/// Hyperparameters of pose refinement during training (train/poses/pose_refiner.h).
struct PoseRefinement final : Configurable {
  int steps_per_update = 4;    ///< a step with an update takes a third longer
  double start = 0.02;         ///< progress of the run; the field is too vague before
  double first_rate_m = 1e-3;  ///< learning rate of translations at the start
  double last_rate = 0.01;     ///< factor of that rate at the end
  double decay = 0.3;          ///< weight decay towards the initial poses
  PoseBounds bounds;

  void visit_hyperparameters(HyperparameterVisitor& visit) override {
    visit({"pose_refinement.steps_per_update", "steps per pose update", 1, 1e6}, steps_per_update);
    visit({"pose_refinement.start", "progress of the run at which refinement starts", 0, 1}, start);
    visit({"pose_refinement.first_rate_m", "learning rate of translations at the start, m", 0, 1},
          first_rate_m);
    visit(Hyperparameter{"pose_refinement.last_rate", "factor of that rate at the end", 0, 1}
              .exclusive(),
          last_rate);
    visit({"pose_refinement.decay", "weight decay towards the initial poses", 0, 1000}, decay);
    visit(
        {"pose_refinement.max_translation_m", "bound of a translation along each axis, m", 0, 100},
        bounds.translation_m);
    visit({"pose_refinement.max_rotation_rad", "bound of a rotation about each axis, rad", 0, 1},
          bounds.rotation_rad);
    visit({"pose_refinement.max_time_offset_s", "bound of a camera's time offset, s", 0, 1},
          bounds.time_offset_s);
  }
};

}  // namespace redrive
