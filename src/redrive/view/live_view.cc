// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/live_view.h"

#include <algorithm>
#include <utility>

namespace redrive::view {
namespace {

constexpr std::chrono::seconds kRefresh{1};  // time between two images of a camera at rest
constexpr double kMostCredit_s = 0.2;        // time saved up while nobody asks

double seconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

}  // namespace

/// Lends the model in training to the run that is shown.
class LiveView::Loan {
 public:
  Loan(Run* from, Run* to) : from_(from), to_(to) {
    to->state.model = std::move(from->state.model);
    to->state.step = from->state.step;
  }
  ~Loan() { from_->state.model = std::move(to_->state.model); }
  Loan(const Loan&) = delete;
  Loan& operator=(const Loan&) = delete;

 private:
  Run *from_, *to_;
};

LiveView::LiveView(Run* run, kernels::Backend& backend, const std::atomic<bool>& stop)
    : backend_(backend), stop_(stop), shown_(std::make_shared<Run>()), returned_(Clock::now()) {
  shown_->paths = run->paths;
  shown_->options = run->options;
  shown_->recording = run->recording;
  shown_->scene = run->scene;
  const Loan loan(run, shown_.get());
  viewer_ = std::make_unique<Viewer>(shown_, backend);
  viewer_->set_training({true, run->state.step, run->state.seconds, false, run->options.max_steps});
}

void LiveView::use(Server& server, Preparation* preparation) {
  viewer_->use(server);
  preparation_ = preparation;
}

void LiveView::take_over() {
  if (preparation_) std::exchange(preparation_, nullptr)->hand_over(*viewer_);
}

/// Shows the latest training state; the model has been lent.
void LiveView::refresh(const Run& run) {
  refresh_at_ = Clock::now() + kRefresh;
  viewer_->set_training({true, run.state.step, run.state.seconds, false, run.options.max_steps});
  viewer_->show_again();
}

/// Shows moving objects where training has put them; the model has been lent.
void LiveView::correct_actors() { shown_->state.model->correct_actors(&shown_->scene.actors); }

void LiveView::between_steps(Run& run) {
  take_over();
  if (!viewer_->has_clients()) {
    refresh_at_ = {};  // the first page sees the run as it is
    return;
  }
  credit_s_ = std::min(credit_s_ + kShare / (1 - kShare) * seconds_since(returned_), kMostCredit_s);
  const bool refreshes = Clock::now() >= refresh_at_;
  if (refreshes && run.state.poses.refines()) shown_->scene = run.scene;
  if (refreshes || credit_s_ > 0 || viewer_->paused()) run.state.model->fetch(backend_);
  const Loan loan(&run, shown_.get());
  if (std::exchange(model_, shown_->state.model.get()) != shown_->state.model.get())
    viewer_->drop_jobs();  // jobs of the model before a roll-back
  if (refreshes) {
    correct_actors();
    refresh(run);
  }
  while (!stop_ && (credit_s_ > 0 || viewer_->paused())) {
    const Clock::time_point start = Clock::now();
    const bool worked = viewer_->work(viewer_->paused());
    if (!viewer_->paused()) {
      credit_s_ -= seconds_since(start);
      if (!worked) break;
    }
  }
  returned_ = Clock::now();
}

void LiveView::serve(Run& run) {
  take_over();
  if (run.state.poses.refines()) {
    shown_->scene = run.scene;
    shown_->scene.correct(run.state.poses.corrections);
  }
  const Loan loan(&run, shown_.get());
  correct_actors();
  viewer_->drop_jobs();
  viewer_->set_training({false, run.state.step, run.state.seconds});
  viewer_->show_again();
  while (!stop_) viewer_->work(true);
}

}  // namespace redrive::view
