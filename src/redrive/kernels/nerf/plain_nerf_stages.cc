// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/nerf/plain_nerf_stages.h"

#include "redrive/kernels/nerf/check_nerf_sizes.h"
#include "redrive/volume/hierarchical_sampling.h"

namespace redrive::kernels {

void PlainNerfStages::sample_stratified(int n_rays, const StratifiedSampling& how,
                                        std::span<float> t, std::span<float> dt) {
  check_stratified(n_rays, how, t.size(), dt.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    const std::size_t first = ray * how.per_ray;
    stratified_ray(how.per_ray, how.near_m, how.far_m, how.jitter, how.key, first, &t[first],
                   &dt[first]);
  });
}

void PlainNerfStages::sample_hierarchical(const Samples& coarse, std::span<const float> weights,
                                          int extra, bool jitter, std::uint64_t key,
                                          std::span<float> t, std::span<float> dt) {
  const int n_rays = check_hierarchical(coarse, weights.size(), extra, t.size(), dt.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    const std::size_t from = ray * coarse.per_ray, to = ray * (coarse.per_ray + extra);
    hierarchical_ray(&coarse.t[from], &weights[from], coarse.per_ray, extra, jitter, key,
                     ray * extra, &t[to], &dt[to]);
  });
}

}  // namespace redrive::kernels
