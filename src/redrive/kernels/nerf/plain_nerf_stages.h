// SPDX-License-Identifier: Apache-2.0
// The sampling of --method nerf, which ref and cpu share: loops over the scalar functions in float.
#pragma once

#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/kernels/ray_loop.h"

namespace redrive::kernels {

class PlainNerfStages : public NerfStages {
 public:
  PlainNerfStages(Backend& backend, ThreadPool* pool) : NerfStages(backend), loop_(pool) {}

  void sample_stratified(int n_rays, const StratifiedSampling& how, std::span<float> t,
                         std::span<float> dt) override;
  void sample_hierarchical(const Samples& coarse, std::span<const float> weights, int extra,
                           bool jitter, std::uint64_t key, std::span<float> t,
                           std::span<float> dt) override;

 private:
  const RayLoop loop_;
};

}  // namespace redrive::kernels
