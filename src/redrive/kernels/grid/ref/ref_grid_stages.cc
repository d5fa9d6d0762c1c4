// SPDX-License-Identifier: Apache-2.0
// Plain loops over the scalar functions, in double between the spans (ref_backend.cc).
#include "redrive/kernels/grid/ref/ref_grid_stages.h"

#include <array>
#include <vector>

#include "redrive/kernels/grid/check_grid_sizes.h"
#include "redrive/kernels/grid/check_ray_sizes.h"
#include "redrive/kernels/grid/plain_grid_stages.h"
#include "redrive/optim/proposal_loss.h"
#include "redrive/optim/range_loss.h"
#include "redrive/optim/sparsity_loss.h"
#include "redrive/volume/ray_weights.h"

namespace redrive::kernels {
namespace {

std::vector<double> as_double(std::span<const float> values) {
  return {values.begin(), values.end()};
}

void add_to(std::span<float> sums, const std::vector<double>& addend) {
  for (std::size_t i = 0; i < sums.size(); ++i) sums[i] = static_cast<float>(sums[i] + addend[i]);
}

std::array<double, 3> position_of(const UnitPoints& points, std::size_t i) {
  return {points.coordinate(0, i), points.coordinate(1, i), points.coordinate(2, i)};
}

/// Features of point `i` in [levels, n, features], and their offsets.
class FeaturesOf {
 public:
  FeaturesOf(const HashGridConfig& config, std::size_t n, std::size_t i)
      : config_(config), n_(n), i_(i) {}

  std::vector<double> get(std::span<const float> features) const {
    std::vector<double> out(config_.outputs());
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = features[at(k)];
    return out;
  }
  void set(const std::vector<double>& values, std::span<float> features) const {
    for (std::size_t k = 0; k < values.size(); ++k) features[at(k)] = static_cast<float>(values[k]);
  }

 private:
  std::size_t at(std::size_t k) const {
    return (k / config_.features_per_level * n_ + i_) * config_.features_per_level +
           k % config_.features_per_level;
  }
  const HashGridConfig& config_;
  std::size_t n_, i_;
};

class RefGridStages final : public PlainGridStages {
 public:
  RefGridStages() : PlainGridStages(nullptr) {}

  void contract_backward(const Contraction& contraction, const Rays& rays,
                         const Intervals& intervals, std::span<const float> d_position,
                         std::span<float> d_origin, std::span<float> d_direction) override {
    contract_backward_in<double>(contraction, rays, intervals, d_position, d_origin, d_direction);
  }

  void encode(const HashGrid& grid, const UnitPoints& points, std::span<float> features) override {
    check_encode(grid, points, features.size());
    const auto levels = hash_grid_levels(grid.config);
    std::vector<double> out(grid.config.outputs());
    for (std::size_t i = 0; i < points.n; ++i) {
      hash_grid_encode<float, double, double>(grid.config, levels, grid.table.data(),
                                              position_of(points, i).data(), points.footprint[i],
                                              out.data());
      FeaturesOf(grid.config, points.n, i).set(out, features);
    }
  }

  void encode_backward(const HashGrid& grid, const UnitPoints& points,
                       std::span<const float> d_features, std::span<float> d_table,
                       std::span<float> d_position) override {
    check_encode_backward(grid, points, d_features.size(), d_table.size(), d_position.size());
    const auto levels = hash_grid_levels(grid.config);
    const std::vector<double> table = as_double(grid.table);
    std::vector<double> sums(table.size());
    for (std::size_t i = 0; i < points.n; ++i) {
      const std::vector<double> d = FeaturesOf(grid.config, points.n, i).get(d_features);
      double d_point[3]{};
      hash_grid_adjoint<double>(grid.config, levels, table.data(), position_of(points, i).data(),
                                points.footprint[i], d.data(), sums.data(), d_point);
      for (int k = 0; !d_position.empty() && k < 3; ++k)
        d_position[k * points.n + i] = static_cast<float>(d_point[k]);
    }
    add_to(d_table, sums);
  }

  void network_forward(const GridNetwork& network, int n_rays, int per_ray,
                       std::span<const float> features, std::span<const float> harmonics,
                       std::span<float> raw) override {
    check_network(network, n_rays, per_ray, features.size(), harmonics.size(), raw.size());
    const std::size_t n = interval_count(n_rays, per_ray);
    const std::vector<double> weights = as_double(network.weights);
    for (std::size_t i = 0; i < n; ++i) {
      GridActivations<double> a;
      double out[4];
      forward_sample(network, weights, n, i, i / per_ray, features, harmonics, &a, out);
      for (int k = 0; k < 4; ++k) raw[k * n + i] = static_cast<float>(out[k]);
    }
  }

  void network_backward(const GridNetwork& network, int n_rays, int per_ray,
                        std::span<const float> features, std::span<const float> harmonics,
                        std::span<const float> d_raw, std::span<float> d_weights,
                        std::span<float> d_features) override {
    check_network_backward(network, n_rays, per_ray, features.size(), harmonics.size(),
                           d_raw.size(), d_weights.size(), d_features.size());
    const std::size_t n = interval_count(n_rays, per_ray);
    const std::vector<double> weights = as_double(network.weights);
    std::vector<double> sums(weights.size());
    for (std::size_t i = 0; i < n; ++i) {
      GridActivations<double> a;
      double raw[4], d[4];
      forward_sample(network, weights, n, i, i / per_ray, features, harmonics, &a, raw);
      for (int k = 0; k < 4; ++k) d[k] = d_raw[k * n + i];
      std::vector<double> d_of_sample(network.config.grid.outputs());
      grid_network_adjoint(network.config, weights.data(), a, d, sums.data(), d_of_sample.data());
      FeaturesOf(network.config.grid, n, i).set(d_of_sample, d_features);
    }
    add_to(d_weights, sums);
  }

  void proposal_density(const HashGrid& grid, float density_scale, const UnitPoints& points,
                        std::span<float> density) override {
    check_proposal_density(grid, points, density.size());
    const auto levels = hash_grid_levels(grid.config);
    std::vector<double> features(grid.config.outputs());
    for (std::size_t i = 0; i < points.n; ++i) {
      hash_grid_encode<float, double, double>(grid.config, levels, grid.table.data(),
                                              position_of(points, i).data(), points.footprint[i],
                                              features.data());
      double sum = 0;
      for (const double feature : features) sum += feature;
      density[i] =
          static_cast<float>(density_scale * std::exp(std::min<double>(sum, kMaxLogDensity)));
    }
  }

  void proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                 std::span<const float> density, std::span<const float> d_density,
                                 std::span<float> d_table) override {
    check_proposal_density_backward(grid, points, density.size(), d_density.size(), d_table.size());
    const auto levels = hash_grid_levels(grid.config);
    const std::vector<double> table = as_double(grid.table);
    std::vector<double> sums(table.size());
    for (std::size_t i = 0; i < points.n; ++i) {
      const std::vector<double> d(grid.config.outputs(),
                                  static_cast<double>(density[i]) * d_density[i]);
      hash_grid_adjoint<double>(grid.config, levels, table.data(), position_of(points, i).data(),
                                points.footprint[i], d.data(), sums.data(), nullptr);
    }
    add_to(d_table, sums);
  }

  void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
               std::span<float> weights) override {
    check_weights(n_rays, intervals, density.size(), weights.size());
    std::vector<double> out(intervals.per_ray);
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = interval_count(ray, intervals.per_ray);
      const std::vector<double> of_ray = as_double(density.subspan(first, intervals.per_ray));
      ray_weights(&intervals.edges[first + ray], of_ray.data(), intervals.per_ray, out.data());
      std::copy(out.begin(), out.end(), &weights[first]);
    }
  }

  void weights_backward(int n_rays, const Intervals& intervals, std::span<const float> density,
                        std::span<const float> weights, std::span<const float> d_weights,
                        std::span<float> d_density) override {
    check_weights_backward(n_rays, intervals, density.size(), weights.size(), d_weights.size(),
                           d_density.size());
    const std::size_t n = intervals.per_ray;
    std::vector<double> out(n);
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = interval_count(ray, intervals.per_ray);
      ray_weights_adjoint(&intervals.edges[first + ray],
                          as_double(density.subspan(first, n)).data(), intervals.per_ray,
                          as_double(weights.subspan(first, n)).data(),
                          as_double(d_weights.subspan(first, n)).data(), out.data());
      std::copy(out.begin(), out.end(), &d_density[first]);
    }
  }

  void proposal_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                     const Intervals& proposal, std::span<const float> proposal_weights,
                     double opacity_weight, std::span<float> d_proposal, double* loss) override {
    check_proposal(n_rays, intervals, weights.size(), proposal, proposal_weights.size(),
                   d_proposal.size());
    double sum = 0;
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = interval_count(ray, intervals.per_ray),
                        p = interval_count(ray, proposal.per_ray);
      std::vector<double> d(proposal.per_ray);
      sum += redrive::proposal_loss<double>(
          &intervals.edges[first + ray],
          as_double(weights.subspan(first, intervals.per_ray)).data(), intervals.per_ray,
          &proposal.edges[p + ray], as_double(proposal_weights.subspan(p, proposal.per_ray)).data(),
          proposal.per_ray, opacity_weight, 1.0 / n_rays, d.data());
      std::copy(d.begin(), d.end(), &d_proposal[p]);
    }
    *loss = sum / n_rays;
  }

  void range_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                  std::span<const float> range_m, float spread_m, float factor,
                  std::span<float> d_weights, double* loss) override {
    check_range(n_rays, intervals, weights.size(), range_m.size(), spread_m, d_weights.size());
    const std::size_t n = intervals.per_ray;
    std::vector<double> d(n);
    double sum = 0;
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = interval_count(ray, intervals.per_ray);
      sum += redrive::range_loss<double>(&intervals.edges[first + ray],
                                         as_double(weights.subspan(first, n)).data(),
                                         intervals.per_ray, range_m[ray], spread_m,
                                         static_cast<double>(factor) / n_rays, d.data());
      std::copy(d.begin(), d.end(), &d_weights[first]);
    }
    *loss = factor * (sum / n_rays);
  }

  void sparsity_loss(int n_rays, const Intervals& intervals, std::span<const float> density,
                     float factor, std::span<float> d_density, double* loss) override {
    check_sparsity(n_rays, intervals, density.size(), d_density.size());
    const std::size_t n = intervals.per_ray;
    double sum = 0;
    for (int ray = 0; ray < n_rays; ++ray) {
      const std::size_t first = interval_count(ray, intervals.per_ray);
      std::vector<double> d = as_double(d_density.subspan(first, n));
      sum += redrive::sparsity_loss<double>(
          &intervals.edges[first + ray], as_double(density.subspan(first, n)).data(),
          intervals.per_ray, static_cast<double>(factor) / n_rays, d.data());
      std::copy(d.begin(), d.end(), &d_density[first]);
    }
    *loss = factor * (sum / n_rays);
  }

 private:
  static void forward_sample(const GridNetwork& network, const std::vector<double>& weights,
                             std::size_t n, std::size_t sample, std::size_t ray,
                             std::span<const float> features, std::span<const float> harmonics,
                             GridActivations<double>* activations, double raw[4]) {
    grid_network_forward<double>(network.config, weights.data(),
                                 FeaturesOf(network.config.grid, n, sample).get(features).data(),
                                 as_double(harmonics.subspan(ray * kHarmonics, kHarmonics)).data(),
                                 network.density_scale, activations, raw);
  }
};

}  // namespace

std::unique_ptr<GridStages> make_ref_grid_stages() { return std::make_unique<RefGridStages>(); }

}  // namespace redrive::kernels
