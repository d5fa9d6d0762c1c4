// SPDX-License-Identifier: Apache-2.0
// Shows a run while it trains, in the same process: between two steps the trainer's thread makes
// images of the model.
#pragma once

#include <atomic>
#include <chrono>
#include <memory>

#include "redrive/train/trainer.h"
#include "redrive/view/preparation.h"
#include "redrive/view/viewer.h"

namespace redrive::view {

class LiveView : public StepObserver {
 public:
  /// `run` is the argument of train(), with its model; backend and `stop` must outlive it.
  LiveView(Run* run, kernels::Backend& backend, const std::atomic<bool>& stop);

  Viewer& viewer() { return *viewer_; }  ///< receives the events of the server
  /// `preparation`: has the server's pages until the first step; null: the viewer has them.
  void use(Server& server, Preparation* preparation = nullptr);

  /// Makes images for at most kShare of the time, or for as long as a page pauses training.
  void between_steps(Run& run) override;

  /// Shows the run that train() has left, until `stop`.
  void serve(Run& run);

  static constexpr double kShare = 0.3;

 private:
  using Clock = std::chrono::steady_clock;
  class Loan;
  void refresh(const Run& run);
  void correct_actors();

  void take_over();

  kernels::Backend& backend_;
  const std::atomic<bool>& stop_;
  std::shared_ptr<Run> shown_;  ///< has the model while images are made
  std::unique_ptr<Viewer> viewer_;
  Preparation* preparation_ = nullptr;  ///< null: the viewer has the pages
  const Trainee* model_ = nullptr;      ///< model of the last images
  Clock::time_point returned_, refresh_at_;
  double credit_s_ = 0;  ///< time for images
};

}  // namespace redrive::view
