// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/grid/plain_grid_stages.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/rng.h"
#include "redrive/kernels/grid/check_grid_sizes.h"
#include "redrive/kernels/grid/check_ray_sizes.h"
#include "redrive/optim/proposal_loss.h"
#include "redrive/optim/range_loss.h"
#include "redrive/optim/sparsity_loss.h"
#include "redrive/volume/median_distance.h"
#include "redrive/volume/ray_intervals.h"
#include "redrive/volume/ray_weights.h"

namespace redrive::kernels {
namespace {

/// Whether the field is evaluated on a ray (GridStages::compact_rays).
bool is_active(const RayCompaction& how, std::span<const float> weights, int per_ray,
               std::size_t ray) {
  float opacity = 0;
  for (int i = 0; i < per_ray; ++i) opacity += weights[ray * per_ray + i];
  // Negated, so that a ray whose weights are NaN is active and its loss shows it.
  return !(opacity < how.min_opacity) || random_unit(how.key, ray) < how.keep_probability;
}

/// Calls visit(offset in the gathered array, offset in the whole array, length) for each run of
/// numbers.
template <class Visit>
void for_each_run(std::span<const std::uint32_t> rays, RayLayout layout, std::size_t each,
                  std::size_t all, const Visit& visit) {
  const std::size_t few = rays.size(), n = all / each;
  if (layout == RayLayout::kRows) {
    for (std::size_t i = 0; i < few; ++i) visit(i * each, rays[i] * each, each);
  } else {
    for (std::size_t k = 0; k < each; ++k)
      for (std::size_t i = 0; i < few; ++i) visit(k * few + i, k * n + rays[i], std::size_t{1});
  }
}

}  // namespace

int PlainGridStages::compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                                  const RayCompaction& how, std::span<std::uint32_t> active) {
  check_compact_rays(n_rays, per_ray, weights.size(), active.size());
  int count = 0;
  for (int ray = 0; ray < n_rays; ++ray)
    if (is_active(how, weights, per_ray, ray)) active[count++] = static_cast<std::uint32_t>(ray);
  if (count > 0) return count;
  active[0] = 0;  // stages take at least one ray
  return 1;
}

void PlainGridStages::gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                                  std::span<const float> from, std::span<float> to) {
  const std::size_t each = check_gather_rays(rays.size(), to.size(), from.size());
  for_each_run(rays, layout, each, from.size(),
               [&](std::size_t here, std::size_t there, std::size_t numbers) {
                 std::copy_n(&from[there], numbers, &to[here]);
               });
}

void PlainGridStages::scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                                   std::span<const float> from, std::span<const float> otherwise,
                                   std::span<float> to) {
  const std::size_t each =
      check_scatter_rays(rays.size(), from.size(), otherwise.size(), to.size());
  if (otherwise.empty())
    std::ranges::fill(to, 0.0f);
  else
    std::ranges::copy(otherwise, to.begin());
  for_each_run(rays, layout, each, to.size(),
               [&](std::size_t here, std::size_t there, std::size_t numbers) {
                 std::copy_n(&from[here], numbers, &to[there]);
               });
}

void PlainGridStages::sample_uniform(const Rays& rays, const UniformSampling& how,
                                     std::span<float> edges) {
  check_sample_uniform(rays, how.per_ray, edges.size());
  loop_.for_each(rays.n, [&](std::size_t ray) {
    float origin[3], direction[3];
    for (int k = 0; k < 3; ++k) {
      origin[k] = rays.origin[k * rays.n + ray];
      direction[k] = rays.direction[k * rays.n + ray];
    }
    uniform_edges(clip_to_scene(how.spacing, how.contraction, origin, direction), how.per_ray,
                  how.jitter, how.key, ray, &edges[ray * (how.per_ray + 1)]);
  });
}

void PlainGridStages::sample_pdf(int n_rays, const Intervals& from, std::span<const float> weights,
                                 const PdfSampling& how, std::span<float> edges) {
  check_sample_pdf(n_rays, from, weights.size(), how.per_ray, edges.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    pdf_edges(&from.edges[ray * (from.per_ray + 1)], &weights[ray * from.per_ray], from.per_ray,
              how.per_ray, how.padding, how.jitter, how.key, ray, &edges[ray * (how.per_ray + 1)]);
  });
}

void PlainGridStages::midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                                std::span<float> dt) {
  check_midpoints(n_rays, intervals, t.size(), dt.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    const std::size_t first = ray * intervals.per_ray;
    const float* const edges = &intervals.edges[first + ray];
    for (int s = 0; s < intervals.per_ray; ++s) {
      t[first + s] = 0.5f * (edges[s] + edges[s + 1]);
      dt[first + s] = edges[s + 1] - edges[s];
    }
  });
}

/// Computes each sample in double.
void PlainGridStages::contract(const Contraction& contraction, const Rays& rays,
                               std::span<const float> pixel_angle, const Intervals& intervals,
                               float least_width, std::span<float> position,
                               std::span<float> footprint) {
  check_contract(rays, intervals, pixel_angle.size(), position.size(), footprint.size());
  const std::size_t n_rays = rays.n, n = footprint.size();
  loop_.for_each(n, [&](std::size_t i) {
    const std::size_t ray = i / intervals.per_ray, edge = i + ray;
    const double begin = intervals.edges[edge], end = intervals.edges[edge + 1],
                 t = 0.5 * (begin + end);
    double world[3], unit[3];
    for (int k = 0; k < 3; ++k)
      world[k] = rays.origin[k * n_rays + ray] + t * rays.direction[k * n_rays + ray];
    const double factor = redrive::contract(contraction, world, unit), side = pixel_angle[ray] * t;
    for (int k = 0; k < 3; ++k) position[k * n + i] = static_cast<float>(unit[k]);
    const double volume = side * side * (end - begin), least = least_width * (end - begin);
    footprint[i] = static_cast<float>(factor * std::fmax(std::cbrt(volume), least));
  });
}

template <class T>
void PlainGridStages::contract_backward_in(const Contraction& contraction, const Rays& rays,
                                           const Intervals& intervals,
                                           std::span<const float> d_position,
                                           std::span<float> d_origin,
                                           std::span<float> d_direction) {
  check_contract_backward(rays, intervals, d_position.size(), d_origin.size(), d_direction.size());
  const std::size_t n_rays = rays.n, n = n_rays * intervals.per_ray;
  loop_.for_each(n_rays, [&](std::size_t ray) {
    T origin[3]{}, direction[3]{};
    for (int s = 0; s < intervals.per_ray; ++s) {
      const std::size_t i = ray * intervals.per_ray + s, edge = i + ray;
      const T t = T(0.5) * (T(intervals.edges[edge]) + T(intervals.edges[edge + 1]));
      T world[3], d_unit[3], d_world[3];
      for (int k = 0; k < 3; ++k) {
        world[k] = T(rays.origin[k * n_rays + ray]) + t * T(rays.direction[k * n_rays + ray]);
        d_unit[k] = T(d_position[k * n + i]);
      }
      contract_adjoint(contraction, world, d_unit, d_world);
      for (int k = 0; k < 3; ++k) {
        origin[k] += d_world[k];
        direction[k] += t * d_world[k];
      }
    }
    for (int k = 0; k < 3; ++k) {
      d_origin[k * n_rays + ray] = static_cast<float>(origin[k]);
      d_direction[k * n_rays + ray] = static_cast<float>(direction[k]);
    }
  });
}
template void PlainGridStages::contract_backward_in<double>(const Contraction&, const Rays&,
                                                            const Intervals&,
                                                            std::span<const float>,
                                                            std::span<float>, std::span<float>);

void PlainGridStages::contract_backward(const Contraction& contraction, const Rays& rays,
                                        const Intervals& intervals,
                                        std::span<const float> d_position,
                                        std::span<float> d_origin, std::span<float> d_direction) {
  contract_backward_in<float>(contraction, rays, intervals, d_position, d_origin, d_direction);
}

void PlainGridStages::weights(int n_rays, const Intervals& intervals,
                              std::span<const float> density, std::span<float> weights) {
  check_weights(n_rays, intervals, density.size(), weights.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    const std::size_t first = ray * intervals.per_ray;
    ray_weights(&intervals.edges[first + ray], &density[first], intervals.per_ray, &weights[first]);
  });
}

void PlainGridStages::weights_backward(int n_rays, const Intervals& intervals,
                                       std::span<const float> density,
                                       std::span<const float> weights,
                                       std::span<const float> d_weights,
                                       std::span<float> d_density) {
  check_weights_backward(n_rays, intervals, density.size(), weights.size(), d_weights.size(),
                         d_density.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    const std::size_t first = ray * intervals.per_ray;
    ray_weights_adjoint(&intervals.edges[first + ray], &density[first], intervals.per_ray,
                        &weights[first], &d_weights[first], &d_density[first]);
  });
}

void PlainGridStages::median_depth(int n_rays, const Intervals& intervals,
                                   std::span<const float> weights, std::span<const float> opacity,
                                   std::span<float> depth) {
  check_median_depth(n_rays, intervals, weights.size(), opacity.size(), depth.size());
  loop_.for_each(n_rays, [&](std::size_t ray) {
    const std::size_t first = ray * intervals.per_ray;
    depth[ray] = median_distance(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                                 opacity[ray]);
  });
}

void PlainGridStages::proposal_loss(int n_rays, const Intervals& intervals,
                                    std::span<const float> weights, const Intervals& proposal,
                                    std::span<const float> proposal_weights, double opacity_weight,
                                    std::span<float> d_proposal, double* loss) {
  check_proposal(n_rays, intervals, weights.size(), proposal, proposal_weights.size(),
                 d_proposal.size());
  const double sum = loop_.sum(n_rays, [&](std::size_t ray) -> double {
    const std::size_t first = ray * intervals.per_ray, p = ray * proposal.per_ray;
    for (int j = 0; j < proposal.per_ray; ++j) d_proposal[p + j] = 0;
    return redrive::proposal_loss(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                                  &proposal.edges[p + ray], &proposal_weights[p], proposal.per_ray,
                                  opacity_weight, 1.0f / static_cast<float>(n_rays),
                                  &d_proposal[p]);
  });
  *loss = sum / n_rays;
}

void PlainGridStages::range_loss(int n_rays, const Intervals& intervals,
                                 std::span<const float> weights, std::span<const float> range_m,
                                 float spread_m, float factor, std::span<float> d_weights,
                                 double* loss) {
  check_range(n_rays, intervals, weights.size(), range_m.size(), spread_m, d_weights.size());
  const double sum = loop_.sum(n_rays, [&](std::size_t ray) -> double {
    const std::size_t first = ray * intervals.per_ray;
    return redrive::range_loss(&intervals.edges[first + ray], &weights[first], intervals.per_ray,
                               range_m[ray], spread_m, factor / static_cast<float>(n_rays),
                               &d_weights[first]);
  });
  *loss = factor * (sum / n_rays);
}

void PlainGridStages::sparsity_loss(int n_rays, const Intervals& intervals,
                                    std::span<const float> density, float factor,
                                    std::span<float> d_density, double* loss) {
  check_sparsity(n_rays, intervals, density.size(), d_density.size());
  const double sum = loop_.sum(n_rays, [&](std::size_t ray) -> double {
    const std::size_t first = ray * intervals.per_ray;
    return redrive::sparsity_loss(&intervals.edges[first + ray], &density[first], intervals.per_ray,
                                  factor / static_cast<float>(n_rays), &d_density[first]);
  });
  *loss = factor * (sum / n_rays);
}

}  // namespace redrive::kernels
