// SPDX-License-Identifier: Apache-2.0
// A batch for the networks of --method grid whose results and tolerances are computed in double,
// with the method and the rounding model of nerf_case.h. Each sample is one of sixteen points: four
// rays (a direction's harmonics) x four depths (features). These networks have no biases to keep
// ReLUs away from their kinks. So a neuron's weights are drawn until none of its pre-activations is
// near 0.
#pragma once

#include <array>
#include <cmath>
#include <map>
#include <vector>

#include "nerf_case.h"

#include "redrive/kernels/grid/grid_stages.h"

namespace redrive::kernels::conformance {

/// Largest relative error of the exponential in simd/vector.h.
constexpr double kExponentialError = 4e-7;

struct GridCase {
  static constexpr int kRayKinds = 4, kDepths = 4, kPoints = kRayKinds * kDepths;

  GridFieldConfig config;
  float density_scale = 0.125f;
  std::vector<float> weights;
  std::vector<float> features[kPoints], harmonics[kRayKinds];

  GridCase(const GridFieldConfig& config, std::uint64_t seed)
      : config(config), weights(grid_network_size(config)) {
    grid_network_initialize(config, seed, weights);
    for (int p = 0; p < kPoints; ++p)
      for (int i = 0; i < config.grid.outputs(); ++i)
        features[p].push_back(static_cast<float>(uniform(200 + seed, 100 * p + i)));
    const float directions[kRayKinds][3] = {
        {0.6f, 0, 0.8f}, {-0.48f, 0.6f, 0.64f}, {0.36f, -0.8f, 0.48f}, {0, -0.28f, 0.96f}};
    for (int kind = 0; kind < kRayKinds; ++kind) {
      harmonics[kind].resize(kHarmonics);
      spherical_harmonics(directions[kind], harmonics[kind].data());
    }
  }
  GridNetwork network() const { return {config, density_scale, weights}; }
};

/// Samples of a case: features [levels, n, features], harmonics [n_rays, 16], and d_raw [4, n] =
/// the sample's factor times its point's vector.
struct GridBatch {
  int n_rays, per_ray;
  std::vector<int> point;
  std::vector<double> factor;
  std::vector<std::array<double, 4>> vector;
  std::vector<float> features, harmonics, d_raw;

  GridBatch(const GridCase& grid, int n_rays, int per_ray) : n_rays(n_rays), per_ray(per_ray) {
    for (int ray = 0; ray < n_rays; ++ray) {
      const int kind = static_cast<int>(GridCase::kRayKinds * 0.5 * (1 + uniform(210, ray)));
      harmonics.insert(harmonics.end(), grid.harmonics[kind].begin(), grid.harmonics[kind].end());
      const double shift = 0.5 * (1 + uniform(211, ray));
      for (int s = 0; s < per_ray; ++s) {
        const int depth =
            static_cast<int>(GridCase::kDepths * (s + shift) / per_ray) % GridCase::kDepths;
        point.push_back(kind * GridCase::kDepths + depth);
      }
    }
    const std::size_t n = samples();
    features.resize(n * grid.config.grid.outputs());
    for (std::size_t i = 0; i < n; ++i)
      for (int k = 0; k < grid.config.grid.outputs(); ++k)
        features[feature_at(grid, i, k)] = grid.features[point[i]][k];
    vector.resize(GridCase::kPoints);
    for (int p = 0; p < GridCase::kPoints; ++p)
      for (int k = 0; k < 4; ++k)
        vector[p][k] = static_cast<float>(0x1p-10 * uniform(212, 4 * p + k));
    const double factors[] = {0.5,  1,  2,
                              -0.5, -1, -2};  // powers of two: the products are exact in float
    for (std::size_t i = 0; i < n; ++i)
      factor.push_back(factors[static_cast<int>(3 * (1 + uniform(213, i)))]);
    for (int k = 0; k < 4; ++k)
      for (std::size_t i = 0; i < n; ++i)
        d_raw.push_back(static_cast<float>(factor[i] * vector[point[i]][k]));
  }
  std::size_t samples() const { return point.size(); }
  /// Returns the offset of feature k of sample i.
  std::size_t feature_at(const GridCase& grid, std::size_t i, int k) const {
    const int features_per_level = grid.config.grid.features_per_level;
    return (k / features_per_level * samples() + i) * features_per_level + k % features_per_level;
  }
};

/// Values and standard deviations for each point, and for the weight gradient of the whole batch.
struct GridExpected {
  std::array<double, 4> raw[GridCase::kPoints], raw_deviation[GridCase::kPoints];
  Uncertain d_features[GridCase::kPoints];  ///< for factor 1
  std::vector<double> gradient, gradient_deviation;
  /// Smallest |pre-activation| / standard deviation over all points, for each neuron of the hidden
  /// layers.
  std::map<int, std::vector<double>> margin;
};

class GridOracle {
 public:
  GridOracle(const GridCase& grid, double operand_roundoff)
      : grid_(grid),
        weights_(grid.weights.begin(), grid.weights.end()),
        r2_(operand_roundoff > kFp32Roundoff ? operand_roundoff * operand_roundoff / 3 : 0),
        s2_(kFp32Roundoff * kFp32Roundoff / 3) {}

  GridExpected compute(const GridBatch& batch) {
    expected_ = GridExpected();
    expected_.gradient.assign(weights_.size(), 0);
    expected_.gradient_deviation.assign(weights_.size(), 0);  // variances until the end
    for (int p = 0; p < GridCase::kPoints; ++p) {
      // Errors of equal points are equal and add up like the factors. Rounding errors of a sum of N
      // terms grow with the root of N.
      sum_ = squares_ = 0;
      for (std::size_t i = 0; i < batch.samples(); ++i)
        if (batch.point[i] == p) {
          sum_ += batch.factor[i];
          squares_ += batch.factor[i] * batch.factor[i] * static_cast<double>(batch.samples());
        }
      point(p, batch.vector[p]);
    }
    for (double& v : expected_.gradient_deviation) v = std::sqrt(v);
    return expected_;
  }

 private:
  static Uncertain exact(const std::vector<float>& values) {
    return {{values.begin(), values.end()}, std::vector<double>(values.size())};
  }

  void point(int p, const std::array<double, 4>& d_raw) {
    const int last = grid_.config.colour_layers - 1;
    const Uncertain features = exact(grid_.features[p]);
    const Uncertain hidden = gate(kGridDensity0, product(kGridDensity0, features)),
                    geometry = product(kGridDensity1, hidden);
    Uncertain both = geometry, colour[2];
    const Uncertain harmonics = exact(grid_.harmonics[p / GridCase::kDepths]);
    both.value.insert(both.value.end(), harmonics.value.begin(), harmonics.value.end());
    both.variance.insert(both.variance.end(), harmonics.variance.begin(), harmonics.variance.end());
    colour[0] = gate(kGridColour0, product(kGridColour0, both));
    if (last == 1) colour[1] = gate(kGridColour1, product(kGridColour1, colour[0]));
    const Uncertain rgb = product(kGridColourOut, colour[last]);
    const double density = grid_.density_scale * std::exp(geometry.value[0]),
                 v_density = density * density *
                             (geometry.variance[0] + kExponentialError * kExponentialError);
    for (int k = 0; k < 3; ++k) {
      expected_.raw[p][k] = rgb.value[k];
      expected_.raw_deviation[p][k] = std::sqrt(rgb.variance[k]);
    }
    expected_.raw[p][3] = density;
    expected_.raw_deviation[p][3] = std::sqrt(v_density);

    Uncertain d =
        adjoint(kGridColourOut, colour[last], {{d_raw[0], d_raw[1], d_raw[2]}, {0, 0, 0}});
    if (last == 1) d = adjoint(kGridColour1, colour[0], pass(colour[1], d));
    d = adjoint(kGridColour0, both, pass(colour[0], d));
    d.value.resize(kGeometryFeatures);
    d.variance.resize(kGeometryFeatures);
    d.value[0] += d_raw[3] * density;
    d.variance[0] += d_raw[3] * d_raw[3] * v_density;
    d = adjoint(kGridDensity1, hidden, d);
    expected_.d_features[p] = adjoint(kGridDensity0, features, pass(hidden, d));
  }

  double weight(const GridLayerShape& shape, int o, int i) const {
    return weights_[shape.offset + static_cast<std::size_t>(o) * shape.inputs + i];
  }

  Uncertain product(int layer, const Uncertain& x) const {
    const GridLayerShape shape = grid_layer(grid_.config, layer);
    Uncertain z{std::vector<double>(shape.outputs), std::vector<double>(shape.outputs)};
    for (int o = 0; o < shape.outputs; ++o) {
      double squares = 0;
      for (int i = 0; i < shape.inputs; ++i) {
        const double w = weight(shape, o, i);
        z.value[o] += w * x.value[i];
        z.variance[o] += w * w * x.variance[i];
        squares += w * w * x.value[i] * x.value[i];
      }
      z.variance[o] += (2 * r2_ + s2_ * (shape.inputs + 1)) * squares;
    }
    return z;
  }

  /// Applies the ReLU, which sets values and errors to 0 where it is closed.
  Uncertain gate(int layer, Uncertain z) {
    std::vector<double>& margin = expected_.margin[layer];
    margin.resize(z.value.size(), INFINITY);
    for (std::size_t i = 0; i < z.value.size(); ++i) {
      margin[i] = std::min(margin[i], std::abs(z.value[i]) / std::sqrt(z.variance[i]));
      if (z.value[i] <= 0) z.value[i] = z.variance[i] = 0;
    }
    return z;
  }
  /// Returns the derivative with respect to the input of the ReLU that returned `x`.
  static Uncertain pass(const Uncertain& x, Uncertain d) {
    for (std::size_t i = 0; i < d.value.size(); ++i)
      if (x.value[i] <= 0) d.value[i] = d.variance[i] = 0;
    return d;
  }

  /// Adds the derivatives with respect to the layer's weights at this point to the gradient;
  /// returns d loss / d x.
  Uncertain adjoint(int layer, const Uncertain& x, const Uncertain& d) {
    const GridLayerShape shape = grid_layer(grid_.config, layer);
    Uncertain d_x{std::vector<double>(shape.inputs), std::vector<double>(shape.inputs)};
    for (int o = 0; o < shape.outputs; ++o) {
      const double square = d.value[o] * d.value[o], rounded = d.variance[o] + r2_ * square;
      for (int i = 0; i < shape.inputs; ++i) {
        const double w = weight(shape, o, i), x2 = x.value[i] * x.value[i];
        const std::size_t at = shape.offset + static_cast<std::size_t>(o) * shape.inputs + i;
        expected_.gradient[at] += sum_ * d.value[o] * x.value[i];
        expected_.gradient_deviation[at] +=
            sum_ * sum_ * (square * (x.variance[i] + r2_ * x2) + x2 * rounded) +
            s2_ * squares_ * square * x2;
        d_x.value[i] += w * d.value[o];
        d_x.variance[i] += w * w * (rounded + r2_ * square + s2_ * (shape.outputs + 1) * square);
      }
    }
    return d_x;
  }

  const GridCase& grid_;
  std::vector<double> weights_;
  double r2_, s2_, sum_ = 0, squares_ = 0;
  GridExpected expected_;
};

/// Returns weights for which no rounding of bf16, and so none of fp32, moves a pre-activation
/// across the kink of its ReLU. Layer by layer, neurons nearer to it are drawn again.
inline GridCase grid_case(const GridFieldConfig& config) {
  GridCase grid(config, 1);
  std::vector<float> drawn(grid.weights.size());
  for (std::uint64_t seed = 2;; ++seed) {
    const GridExpected expected = GridOracle(grid, kBf16Roundoff).compute(GridBatch(grid, 1, 1));
    grid_network_initialize(config, seed, drawn);
    bool near = false;
    for (const auto& [layer, margin] :
         expected.margin) {  // in order: later layers depend on earlier ones
      const GridLayerShape shape = grid_layer(config, layer);
      for (std::size_t o = 0; o < margin.size(); ++o) {
        if (margin[o] > kDeviations) continue;
        near = true;
        const std::size_t first = shape.offset + o * shape.inputs;
        std::copy_n(&drawn[first], shape.inputs, &grid.weights[first]);
      }
      if (near) break;
    }
    if (!near) return grid;
  }
}

}  // namespace redrive::kernels::conformance
