// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/data_parallel_group.h"

#include "redrive/base/error.h"

namespace redrive {

DataParallelGroup::DataParallelGroup(const std::vector<kernels::Backend*>& backends,
                                     kernels::AllReduce* reduction, TrainState* state)
    : pool_(static_cast<int>(backends.size())), reduction_(reduction) {
  REDRIVE_CHECK(reduction || backends.size() == 1);
  for (kernels::Backend* backend : backends) {
    members_.push_back(
        std::make_unique<Rank>(Rank{*backend, {size(), static_cast<int>(backends.size())}}));
    Rank& member = *members_.back();
    member.state = size() == 1 ? state : &member.copy;
  }
}

void DataParallelGroup::begin() {
  if (size() == 1) return;
  for (const auto& member : members_) member->copy = {};  // room for the others
  const std::string all = checkpoint_bytes(*first().state);
  for (const auto& member : members_)
    if (member->state == &member->copy)
      member->copy = parse_checkpoint(all, "copy for another GPU");
}

void DataParallelGroup::each(const std::function<void(Rank&)>& work) {
  pool_.run(size(), [&](int rank) {
    const std::string which = size() > 1 ? "GPU " + std::to_string(rank) + ": " : "";
    try {
      work(*members_[rank]);
    } catch (const DeviceError& error) {
      throw DeviceError(which + error.what());
    } catch (const DeviceMemoryError& error) {
      throw DeviceMemoryError(which + error.what());
    }
  });
}

StepResult DataParallelGroup::step(const std::function<void(Rank&)>& gather, double learning_rate) {
  const bool several = size() > 1;
  each([&](Rank& member) {
    gather(member);
    member.result =
        step_gradients(member.backend, member.batch, *member.state, &member.buffers, &member.lidar);
    if (!several || member.batch.cell.empty()) return;
    kernels::download(member.backend, member.batch.cell);
    member.backend.download(member.result.squares);
  });

  StepResult all;
  cells_.clear();
  squares_.clear();
  std::vector<std::span<float>> gradients;
  for (const auto& member : members_) {
    const StepResult& one = member->result;
    all.loss += one.loss / size();
    all.rgb_mse += one.rgb_mse / size();
    all.opacity += one.opacity / size();
    all.range += one.range / size();
    all.colours += one.colours / size();
    all.finite &= one.finite;
    all.active_rays += one.active_rays;
    all.rays += one.rays;
    all.error_map_rays += one.error_map_rays;
    gradients.push_back(member->buffers.gradients);
    if (!several || member->batch.cell.empty()) continue;
    cells_.insert(cells_.end(), member->batch.cell.begin(), member->batch.cell.end());
    squares_.insert(squares_.end(), one.squares.begin(), one.squares.end());
  }
  if (several) reduction_->mean(gradients);
  all.squares = several ? squares_ : first().result.squares;
  const std::span<const std::uint32_t> cells = several ? cells_ : first().batch.cell;
  each([&](Rank& member) {
    apply_step(member.backend, all, cells, learning_rate, member.state, &member.buffers);
  });
  return all;
}

std::vector<ViewGradient> DataParallelGroup::view_gradients(const Scene& scene) const {
  std::vector<ViewGradient> mean(scene.views.size());
  for (const auto& member : members_) {
    const std::vector<ViewGradient> one =
        redrive::view_gradients(scene, member->batch, member->result);
    for (std::size_t v = 0; v < mean.size(); ++v) {
      mean[v].d_translation += one[v].d_translation / size();
      mean[v].d_rotation += one[v].d_rotation / size();
    }
  }
  return mean;
}

}  // namespace redrive
