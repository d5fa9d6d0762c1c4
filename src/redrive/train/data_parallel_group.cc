// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/data_parallel_group.h"

#include <type_traits>

#include "redrive/base/error.h"

namespace redrive {
namespace {

/// Accumulates one rank's result into that of all `ranks`.
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
    all->views.resize(one.views.size());
  }
  for (std::size_t i = 0; i < all->loss_terms.size(); ++i)
    all->loss_terms[i].value += one.loss_terms[i].value / ranks;
  for (std::size_t v = 0; v < all->views.size(); ++v) {
    all->views[v].d_translation += one.views[v].d_translation / ranks;
    all->views[v].d_rotation += one.views[v].d_rotation / ranks;
  }
}

/// Calls `visit` for each number of a result but for the updates of an error map. Names and sizes
/// stay.
template <class Result, class Visit>
void visit_numbers(Result& result, const Visit& visit) {
  visit(result.pixels);
  visit(result.epoch_pixels);
  visit(result.active_rays);
  visit(result.opacity);
  visit(result.rgb_mse);
  visit(result.loss);
  visit(result.finite);
  visit(result.colour_variance);
  for (auto& term : result.loss_terms) visit(term.value);
  for (auto& view : result.views)
    for (int k = 0; k < 3; ++k) {
      visit(view.d_translation[k]);
      visit(view.d_rotation[k]);
    }
}

}  // namespace

DataParallelGroup::DataParallelGroup(const std::vector<kernels::Backend*>& backends,
                                     kernels::AllReduce* all_reduce, TrainState* state,
                                     ProcessGroup* processes)
    : pool_(static_cast<int>(backends.size())), all_reduce_(all_reduce), processes_(processes) {
  REDRIVE_CHECK(all_reduce || backends.size() == 1);
  REDRIVE_CHECK(!processes || backends.size() == 1);
  for (kernels::Backend* backend : backends) {
    const auto rank = static_cast<int>(ranks_.size());
    ranks_.push_back(std::make_unique<Rank>(Rank{*backend, processes ? processes->rank() : rank}));
    ranks_.back()->state = rank == 0 ? state : &ranks_.back()->copy;
  }
}

void DataParallelGroup::begin() {
  if (ranks_.size() == 1) return;
  for (const auto& rank : ranks_) rank->copy = {};  // frees memory for the new copies
  const std::string all = checkpoint_bytes(*first().state);
  for (const auto& rank : ranks_)
    if (rank->state == &rank->copy) rank->copy = parse_checkpoint(all, "copy for another GPU");
}

void DataParallelGroup::each(const std::function<void(Rank&)>& work) {
  const auto here = static_cast<int>(ranks_.size());
  pool_.run(here, [&](int rank) {
    const std::string which = here > 1 ? "GPU " + std::to_string(rank) + ": " : "";
    try {
      work(*ranks_[rank]);
    } catch (const DeviceError& error) {
      throw DeviceError(which + error.what());
    } catch (const DeviceMemoryError& error) {
      throw DeviceMemoryError(which + error.what());
    }
  });
}

StepResult DataParallelGroup::reduce_over_processes() {
  const StepResult& own = first().result;
  REDRIVE_CHECK(own.cells.empty());
  std::vector<double> numbers;
  visit_numbers(own, [&](const auto& number) { numbers.push_back(double(number)); });
  std::vector<double> of_all(numbers.size() * static_cast<std::size_t>(size()));
  processes_->all_gather(numbers, of_all);
  StepResult all;
  StepResult one = own;
  const double* next = of_all.data();
  for (int rank = 0; rank < size(); ++rank) {
    visit_numbers(one, [&](auto& number) {
      number = static_cast<std::remove_reference_t<decltype(number)>>(*next++);
    });
    accumulate(one, size(), &all);
  }
  processes_->mean(first().buffers.gradients);
  return all;
}

StepResult DataParallelGroup::step(const TrainingSet& data, const StepRequest& request,
                                   double learning_rate) {
  const bool several = ranks_.size() > 1;
  const StepUpdate update =
      size() > 1 ? StepUpdate() : update_in_step(learning_rate, first().state);
  each([&](Rank& rank) {
    StepRequest own = request;
    own.rank = rank.rank;
    own.world_size = size();
    own.error_map = &rank.state->cell_errors;
    if (!update.parameters.empty()) own.update = &update;
    rank.result = step_gradients(rank.backend, data, own, *rank.state, &rank.buffers);
    if (!several || rank.result.cells.empty()) return;
    rank.backend.download(kernels::as_floats(rank.result.cells));
    rank.backend.download(rank.result.squared_errors);
  });

  StepResult all;
  if (processes_) all = reduce_over_processes();
  cells_.clear();
  squared_errors_.clear();
  std::vector<std::span<float>> gradients;
  for (const auto& rank : ranks_) {
    const StepResult& one = rank->result;
    if (!processes_) accumulate(one, size(), &all);
    gradients.push_back(rank->buffers.gradients);
    if (!several) continue;
    cells_.insert(cells_.end(), one.cells.begin(), one.cells.end());
    if (!one.cells.empty())
      squared_errors_.insert(squared_errors_.end(), one.squared_errors.begin(),
                             one.squared_errors.end());
  }
  if (several) all_reduce_->mean(gradients);
  all.cells = several ? cells_ : first().result.cells;
  all.squared_errors = several ? squared_errors_ : first().result.squared_errors;
  each([&](Rank& rank) {
    apply_step(rank.backend, request, all, learning_rate, rank.state, &rank.buffers);
  });
  return all;
}

}  // namespace redrive
