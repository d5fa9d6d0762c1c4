// SPDX-License-Identifier: Apache-2.0
// The stages of nerf_stages.h whose implementation is a loop over functors (functors/): one body
// for the host (host_stage.h) and for devices (device/stage.h).
#pragma once

#include "redrive/kernels/check_nerf_sizes.h"
#include "redrive/kernels/functors/nerf_sampling_functors.h"
#include "redrive/kernels/stage_spans.h"

namespace redrive::kernels {

/// Executor::stage() returns a HostStage or a Stage<Device>.
template <class Executor>
class CommonNerfStages : public NerfStages {
 public:
  CommonNerfStages(Backend& backend, const Executor& executor)
      : NerfStages(backend), executor_(executor) {}

  void sample_stratified(int n_rays, const StratifiedSampling& how, std::span<float> t,
                         std::span<float> dt) override {
    check_stratified(n_rays, how, t.size(), dt.size());
    auto stage = executor_.stage();
    stage.for_each(n_rays, StratifiedRays{how, stage.out(t), stage.out(dt)});
    stage.finish();
  }

  void sample_hierarchical(const Samples& coarse, std::span<const float> weights, int extra,
                           bool jitter, std::uint64_t key, std::span<float> t,
                           std::span<float> dt) override {
    const int n_rays = check_hierarchical(coarse, weights.size(), extra, t.size(), dt.size());
    auto stage = executor_.stage();
    stage.for_each(n_rays, HierarchicalRays{stage_input(stage, coarse), stage.in(weights), extra,
                                            jitter, key, stage.out(t), stage.out(dt)});
    stage.finish();
  }

 private:
  const Executor executor_;
};

}  // namespace redrive::kernels
