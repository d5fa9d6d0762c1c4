// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/distributed/data_parallel.h"

#include <span>
#include <type_traits>
#include <vector>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// Accumulates one rank's result into the result of all `ranks`.
void accumulate(const StepResult& one, int ranks, StepResult* all) {
  all->pixels += one.pixels;
  all->epoch_pixels += one.epoch_pixels;
  all->active_rays += one.active_rays;
  all->opacity += one.opacity / ranks;
  all->rgb_mse += one.rgb_mse / ranks;
  all->loss += one.loss / ranks;
  all->finite &= one.finite;
  if (all->loss_terms.empty()) {
    all->loss_terms = one.loss_terms;
    for (LossTerm& term : all->loss_terms) term.value = 0;
    all->colour_variance = one.colour_variance;
    all->stage = one.stage;
    all->views.resize(one.views.size());
  }
  for (std::size_t i = 0; i < all->loss_terms.size(); ++i)
    all->loss_terms[i].value += one.loss_terms[i].value / ranks;
  for (std::size_t v = 0; v < all->views.size(); ++v) {
    all->views[v].d_translation += one.views[v].d_translation / ranks;
    all->views[v].d_rotation += one.views[v].d_rotation / ranks;
  }
}

/// Calls `visit` for each number of a result except the updates of an error map. Names and sizes
/// stay.
template <class Result, class Visit>
void visit_result(Result& result, const Visit& visit) {
  visit(result.pixels);
  visit(result.epoch_pixels);
  visit(result.active_rays);
  visit(result.opacity);
  visit(result.rgb_mse);
  visit(result.loss);
  visit(result.finite);
  visit(result.colour_variance);
  visit(result.stage);
  for (auto& term : result.loss_terms) visit(term.value);
  for (auto& view : result.views)
    for (int k = 0; k < 3; ++k) {
      visit(view.d_translation[k]);
      visit(view.d_rotation[k]);
    }
}

/// Returns the results of all processes as one, and averages their gradients.
StepResult mean_over(ProcessGroup& processes, const StepResult& own, std::span<float> gradients) {
  REDRIVE_CHECK(own.cells.empty());
  const int size = processes.size();
  std::vector<double> numbers;
  visit_result(own, [&](const auto& number) { numbers.push_back(double(number)); });
  std::vector<double> of_all(numbers.size() * static_cast<std::size_t>(size));
  processes.all_gather(numbers, of_all);
  StepResult all;
  StepResult one = own;
  const double* next = of_all.data();
  for (int rank = 0; rank < size; ++rank) {
    visit_result(one, [&](auto& number) {
      number = static_cast<std::remove_reference_t<decltype(number)>>(*next++);
    });
    accumulate(one, size, &all);
  }
  processes.mean(gradients);
  return all;
}

}  // namespace

StepResult train_step(const Rank& rank, const TrainingSet& data, const StepRequest& request,
                      double learning_rate, TrainState* state, StepBuffers* buffers) {
  if (!rank.processes || rank.processes->size() == 1)
    return train_step(rank.backend, data, request, learning_rate, state, buffers);
  StepRequest own = request;
  own.rank = rank.processes->rank();
  own.world_size = rank.processes->size();
  const StepResult result = step_gradients(rank.backend, data, own, *state, buffers);
  const StepResult all = mean_over(*rank.processes, result, buffers->gradients);
  apply_step(rank.backend, request, all, learning_rate, state, buffers);
  return all;
}

}  // namespace redrive
