// SPDX-License-Identifier: Apache-2.0
// Losses of grid_stages.h as functors that return one ray's loss in float and write or add its
// derivatives; see functors/interval_functors.h.
#pragma once

#include "redrive/kernels/grid_stages.h"
#include "redrive/optim/proposal_loss.h"
#include "redrive/optim/range_loss.h"
#include "redrive/optim/sparsity_loss.h"

namespace redrive::kernels {

struct ProposalLoss {
  int n_rays;
  Intervals intervals;
  std::span<const float> weights;
  Intervals proposal;
  std::span<const float> proposal_weights;
  double opacity_weight;
  std::span<float> d_proposal;

  REDRIVE_HD double operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray, p = ray * proposal.per_ray;
    for (int j = 0; j < proposal.per_ray; ++j) d_proposal[p + j] = 0;
    return proposal_loss(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                         &proposal.edges[p + ray], &proposal_weights[p], proposal.per_ray,
                         opacity_weight, 1.0f / static_cast<float>(n_rays), &d_proposal[p]);
  }
};

struct RangeLoss {
  int n_rays;
  Intervals intervals;
  std::span<const float> weights, range_m;
  float spread_m, factor;
  std::span<float> d_weights;

  REDRIVE_HD double operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    return range_loss(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                      range_m[ray], spread_m, factor / static_cast<float>(n_rays),
                      &d_weights[first]);
  }
};

struct SparsityLoss {
  int n_rays;
  Intervals intervals;
  std::span<const float> density;
  float factor;
  std::span<float> d_density;

  REDRIVE_HD double operator()(std::size_t ray) const {
    const std::size_t first = ray * intervals.per_ray;
    return sparsity_loss(&intervals.edges[first + ray], &density[first], intervals.per_ray,
                         factor / static_cast<float>(n_rays), &d_density[first]);
  }
};

}  // namespace redrive::kernels
