// SPDX-License-Identifier: Apache-2.0
#pragma once

#include "redrive/model/hyperparameters.h"

namespace redrive {

/// How poses are refined while a model trains (train/pose_refiner.h).
struct PoseRefinement final : Configurable {
  int steps_per_update = 4;    ///< an update costs its step a third more
  double start = 0.02;         ///< of the run's progress: before, there is little to align to
  double first_rate_m = 1e-3;  ///< of Adam, of translations, at the start
  double last_rate = 0.01;     ///< what is left of it at the end
  double decay = 0.3;          ///< pull towards the initial poses: a correction of 1 m, per rate

  void visit_hyperparameters(HyperparameterVisitor& visit) override {
    visit({"pose_refinement.steps_per_update", "one step of so many updates poses", 1, 1e6},
          steps_per_update);
    visit({"pose_refinement.start", "progress of the run at which poses are refined from", 0, 1},
          start);
    visit({"pose_refinement.first_rate_m", "learning rate of translations at the start, m", 0, 1},
          first_rate_m);
    visit(Hyperparameter{"pose_refinement.last_rate", "factor of that rate at the end", 0, 1}
              .exclusive(),
          last_rate);
    visit({"pose_refinement.decay", "pull towards the initial poses", 0, 1000}, decay);
  }
};

}  // namespace redrive
