// SPDX-License-Identifier: Apache-2.0
// A batch for the network whose results and tolerances are computed in double.
//
// All samples of a batch of any size are at one of sixteen points: 4 rays x 4 depths, in an order
// that differs from ray to ray. So the oracle costs sixteen evaluations, and biases can be chosen
// so that no ReLU is near its kink at any point (kinks are avoided, tolerances are not loosened).
// Each neuron's bias is in the middle of the widest gap between the central ones of its sixteen
// pre-activations. The neuron is then open at some points and closed at others.
//
// Rounding model (Higham and Mary, "A new approach to probabilistic rounding error analysis", 2019:
// roundings are independent, of mean zero): a rounding to unit roundoff u has relative standard
// deviation at most u / sqrt(3). With r = u / sqrt(3) of the operands (bf16: u = 2^-8, fp32: 2^-24)
// and s = 2^-24 / sqrt(3) of the fp32 sums, a layer z = W x + b with n inputs has the variance
//   v_z = sum W^2 v_x   (error of the input)
//     + 2 r^2 sum W^2 x^2   (W and x are rounded)
//     + s^2 (n + 1) (sum W^2 x^2 + b^2),
// because each of its n partial sums is about as large as the root of sum W^2 x^2. The backward
// pass follows the same recursion with W^T, and a weight's gradient sum_s d x has the variance
// sum_s (d^2 v_x + x^2 v_d + 2 r^2 d^2 x^2) + s^2 N sum d^2 x^2. Tolerance: kDeviations standard
// deviations. Each test asserts that it is far below the error of a misplaced sample.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <numeric>
#include <vector>

#include "redrive/base/rng.h"
#include "redrive/kernels/backend.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/kernels/nerf/ref/nerf_network.h"

namespace redrive::kernels::conformance {

constexpr double kDeviations = 8;
constexpr double kFp32Roundoff = 0x1p-24, kBf16Roundoff = 0x1p-8;
/// Doubles angles over five octaves from sin and cos with errors of 2e-7: 16 x 2e-7, rounded up.
constexpr double kEncodingError = 4e-6;

inline double uniform(std::uint64_t stream, std::uint64_t i) {  // [-1, 1)
  return 2.0 * random_unit(random_key(31, kStreamTest, stream), i) - 1;
}

struct Point {
  double position[3], direction[3];
  double position_error[3];  ///< standard deviation of a backend's unit position
};

/// Rounding of a backend's or network's arithmetic.
struct Rounding {
  double operand;  ///< unit roundoff of weights and activations
};

class NerfCase {
 public:
  static constexpr int kRayKinds = 4, kDepths = 4, kPoints = kRayKinds * kDepths;

  explicit NerfCase(const NerfConfig& config)
      : config(config), parameters(nerf_parameter_count(config)) {
    // Points of a lattice of rays and depths fill [-1, 1]^3 of the unit cube, at generic angles.
    const float directions[kRayKinds][3] = {
        {0.6f, 0, 0.8f}, {-0.48f, 0.6f, 0.64f}, {0.36f, -0.8f, 0.48f}, {0, -0.28f, 0.96f}};
    for (int kind = 0; kind < kRayKinds; ++kind)
      for (int k = 0; k < 3; ++k) {
        direction_of[kind][k] = directions[kind][k];
        origin_of[kind][k] = static_cast<float>(3 * uniform(1, 3 * kind + k));
      }
    for (int i = 0; i < kDepths; ++i)
      depth_of[i] = static_cast<float>(1 + 2 * i + 0.7 * uniform(2, i));
    for (int kind = 0; kind < kRayKinds; ++kind)
      for (int i = 0; i < kDepths; ++i) points.push_back(point(kind, depth_of[i]));
    choose_parameters();
  }

  NerfConfig config;
  UnitFromWorld unit_from_world{{0.375f, -0.5f, 3.0f}, 0.1f};
  std::vector<float> parameters;
  std::vector<Point> points;
  float origin_of[kRayKinds][3], direction_of[kRayKinds][3], depth_of[kDepths];

  NerfField field() const { return {config, unit_from_world, parameters}; }
  std::vector<double> exact_parameters() const { return {parameters.begin(), parameters.end()}; }

 private:
  Point point(int kind, float t) const {
    Point p;
    for (int k = 0; k < 3; ++k) {
      const double o = origin_of[kind][k], d = direction_of[kind][k], c = unit_from_world.center[k],
                   s = unit_from_world.scale;
      const double x = o + t * d;
      p.direction[k] = d;
      p.position[k] = (x - c) * s;
      // in float, the product, the sum, the difference and the scaling round, in any grouping of
      // these terms
      p.position_error[k] = s * kFp32Roundoff / std::sqrt(3.0) *
                            std::sqrt(t * d * t * d + x * x + 2 * (x - c) * (x - c) + c * c);
    }
    return p;
  }

  /// Chooses weights U(-a, a) with a = 3 / sqrt(inputs): variance 3 / inputs, which keeps the
  /// spread of centred pre-activations from layer to layer (the variance of a normal variable's
  /// ReLU is 0.34 of its own). Layer by layer, since pre-activations depend on the layers before.
  void choose_parameters() {
    for (int layer = 0; layer < kNerfLayers; ++layer) {
      std::vector<std::vector<double>> inputs;
      const std::vector<double> p = exact_parameters();
      for (const Point& at : points) {
        ref::NerfActivations<double> a;
        double raw[4];
        ref::nerf_sample_forward(config, p.data(), at.position, at.direction, &a, raw);
        inputs.push_back(a.input[layer]);
      }
      const bool gated = ref::nerf_layer_has_relu(layer) ||
                         layer == kNerfDensity;  // the density's ReLU is in compositing
      for (int o = 0; o < nerf_layer(config, layer).outputs; ++o)
        choose_neuron(layer, o, inputs, gated);
    }
  }

  /// Draws the neuron's weights until the gap is a fifth of the range of its pre-activations.
  void choose_neuron(int layer, int o, const std::vector<std::vector<double>>& inputs, bool gated) {
    const NerfLayerShape shape = nerf_layer(config, layer);
    float* row = &parameters[shape.weight + std::size_t(o) * shape.inputs];
    for (std::uint64_t draw = 0;; ++draw) {
      const std::uint64_t stream = 1000 + 100 * draw + layer;
      for (int i = 0; i < shape.inputs; ++i)
        row[i] = static_cast<float>(3 / std::sqrt(shape.inputs) *
                                    uniform(stream, std::uint64_t(o) * shape.inputs + i));
      parameters[shape.bias + o] = static_cast<float>(0.5 * uniform(stream, ~std::uint64_t(o)));
      if (!gated) return;

      std::vector<double> z;
      for (const std::vector<double>& input : inputs)
        z.push_back(std::inner_product(input.begin(), input.end(), row, 0.0));
      std::sort(z.begin(), z.end());
      int widest = 3;
      for (int k = 3; k < kPoints - 4; ++k)
        if (z[k + 1] - z[k] > z[widest + 1] - z[widest]) widest = k;
      parameters[shape.bias + o] = static_cast<float>(-0.5 * (z[widest] + z[widest + 1]));
      if (z[widest + 1] - z[widest] > 0.2 * (z.back() - z.front())) return;
    }
  }
};

/// A batch and the point of each of its samples.
struct NerfBatch {
  int n_rays, per_ray;
  std::vector<float> origin, direction, t, dt;
  std::vector<int> point;  ///< [n_rays * per_ray] index into NerfCase::points

  NerfBatch(const NerfCase& nerf, int n_rays, int per_ray) : n_rays(n_rays), per_ray(per_ray) {
    std::vector<int> kind(n_rays);
    for (int ray = 0; ray < n_rays; ++ray) kind[ray] = static_cast<int>(2 * (1 + uniform(4, ray)));
    for (int k = 0; k < 3; ++k)
      for (int ray = 0; ray < n_rays; ++ray) {
        origin.push_back(nerf.origin_of[kind[ray]][k]);
        direction.push_back(nerf.direction_of[kind[ray]][k]);
      }
    for (int ray = 0; ray < n_rays; ++ray) {
      const double shift = 0.5 * (1 + uniform(5, ray));
      for (int s = 0; s < per_ray; ++s) {
        const int depth = std::min(NerfCase::kDepths - 1,
                                   static_cast<int>(NerfCase::kDepths * (s + shift) / per_ray));
        point.push_back(kind[ray] * NerfCase::kDepths + depth);
        t.push_back(nerf.depth_of[depth]);
        // An optical length of four metres per ray, independent of t; every other ray ends in an
        // infinite interval.
        dt.push_back(static_cast<float>((1 + 0.5 * uniform(6, point.size())) * 4 / per_ray));
      }
      if (ray % 2 == 0) dt.back() = INFINITY;
    }
  }
  int samples() const { return n_rays * per_ray; }
  Rays rays() const { return {n_rays, origin, direction}; }
  Samples sampling() const { return {per_ray, t, dt}; }
};

/// Values with variances, element by element.
struct Uncertain {
  std::vector<double> value, variance;
};

/// Values and standard deviations: [4] per point, [n_parameters].
struct Expected {
  std::vector<std::array<double, 4>> raw, raw_deviation;
  std::vector<Uncertain> d_position;  ///< per point, [3]: one sample of factor 1
  std::vector<double> gradient, gradient_deviation;
  double smallest_margin =
      INFINITY;  ///< minimum over ReLUs and points of |pre-activation| / its standard deviation
};

class NerfOracle {
 public:
  NerfOracle(const NerfCase& nerf, Rounding rounding)
      : nerf_(nerf),
        parameters_(nerf.exact_parameters()),
        r2_(rounding.operand * rounding.operand / 3),
        s2_(kFp32Roundoff * kFp32Roundoff / 3) {}

  /// Runs the forward pass at every point and, unless batch is null, the gradient of the whole
  /// batch. d_raw of a sample is its factor times its point's vector: factor[s] * vector[point[s]].
  Expected compute(const NerfBatch* batch, const std::vector<double>& factor,
                   const std::vector<std::array<double, 4>>& vector) {
    Expected out;
    out.gradient.assign(parameters_.size(), 0);
    out.gradient_deviation.assign(parameters_.size(), 0);  // variances until the end
    for (std::size_t p = 0; p < nerf_.points.size(); ++p) {
      forward(nerf_.points[p], &out);
      if (!batch) continue;
      // Errors of equal points are equal and add up like the factors. Rounding errors of a sum of N
      // terms grow with the root of N.
      double sum = 0, squares = 0;
      for (int s = 0; s < batch->samples(); ++s)
        if (batch->point[s] == static_cast<int>(p)) {
          sum += factor[s];
          squares += factor[s] * factor[s];
        }
      double d_raw[4];
      for (int k = 0; k < 4; ++k) d_raw[k] = sum * vector[p][k];
      ref::nerf_sample_adjoint(nerf_.config, parameters_.data(), a_, d_raw, out.gradient.data());
      backward_variance(vector[p], sum * sum, squares * batch->samples(), &out);
    }
    for (double& v : out.gradient_deviation) v = std::sqrt(v);
    return out;
  }

 private:
  void forward(const Point& at, Expected* out) {
    double raw[4];
    ref::nerf_sample_forward(nerf_.config, parameters_.data(), at.position, at.direction, &a_, raw);
    const std::vector<double> of_position =
        encoding_variance(at.position_error, nerf_.config.position_octaves);
    const std::vector<double> of_direction =
        encoding_variance(nullptr, nerf_.config.direction_octaves);
    for (int layer = 0; layer < kNerfLayers; ++layer) {
      std::vector<double>& v = input_variance_[layer];
      if (layer == 0)
        v = of_position;
      else if (layer == kNerfDensity || layer == kNerfFeature)
        v = output_variance_[kNerfHidden - 1];
      else
        v = output_variance_[layer - 1];
      if (layer == kNerfSkip) v.insert(v.end(), of_position.begin(), of_position.end());
      if (layer == kNerfColour) v.insert(v.end(), of_direction.begin(), of_direction.end());
      layer_variance(layer, out);
    }
    std::array<double, 4> value, deviation;
    for (int k = 0; k < 4; ++k) {
      value[k] = raw[k];
      deviation[k] =
          std::sqrt(k < 3 ? output_variance_[kNerfRgb][k] : output_variance_[kNerfDensity][0]);
    }
    out->raw.push_back(value);
    out->raw_deviation.push_back(deviation);
  }

  static std::vector<double> encoding_variance(const double* position_error, int octaves) {
    std::vector<double> v(encoded_size(octaves));
    for (int d = 0; d < 3; ++d) {
      const double error = position_error ? position_error[d] : 0;
      v[d] = error * error;
      for (int l = 0; l < octaves; ++l) {
        const double angle_error = std::ldexp(std::numbers::pi, l) * error;
        v[3 + 2 * (d * octaves + l)] = v[3 + 2 * (d * octaves + l) + 1] =
            angle_error * angle_error + kEncodingError * kEncodingError / 3;
      }
    }
    return v;
  }

  void layer_variance(int layer, Expected* out) {
    const NerfLayerShape shape = nerf_layer(nerf_.config, layer);
    output_variance_[layer].assign(shape.outputs, 0);
    for (int o = 0; o < shape.outputs; ++o) {
      const double* row = &parameters_[shape.weight + std::size_t(o) * shape.inputs];
      const double bias = parameters_[shape.bias + o];
      double incoming = 0, squares = 0, z = bias;
      for (int i = 0; i < shape.inputs; ++i) {
        incoming += row[i] * row[i] * input_variance_[layer][i];
        squares += row[i] * row[i] * a_.input[layer][i] * a_.input[layer][i];
        z += row[i] * a_.input[layer][i];
      }
      const double variance =
          incoming + 2 * r2_ * squares + s2_ * (shape.inputs + 1) * (squares + bias * bias);
      const bool gated = ref::nerf_layer_has_relu(layer) || layer == kNerfDensity;
      if (gated)
        out->smallest_margin = std::min(out->smallest_margin, std::abs(z) / std::sqrt(variance));
      output_variance_[layer][o] = ref::nerf_layer_has_relu(layer) && z <= 0 ? 0 : variance;
    }
  }

  /// Adds the variances of the gradient of one sample with d_raw = vector: `coherent` = (sum of
  /// factors)^2 times the variances of its own error, `repeated` = N * sum of factor^2 times the
  /// variances of the sums.
  void backward_variance(const std::array<double, 4>& vector, double coherent, double repeated,
                         Expected* out) {
    const auto adjoint = [&](int layer, Uncertain d) {
      return layer_adjoint(layer, d, coherent, repeated, out);
    };
    Uncertain d = adjoint(kNerfRgb, {{vector[0], vector[1], vector[2]}, {0, 0, 0}});
    d = adjoint(kNerfColour, d);
    d = adjoint(kNerfFeature, d);
    const Uncertain of_density = adjoint(kNerfDensity, {{vector[3]}, {0}});
    for (int i = 0; i < nerf_.config.width; ++i) {
      d.value[i] += of_density.value[i];
      d.variance[i] += of_density.variance[i];
    }
    const std::size_t encoded = encoded_size(nerf_.config.position_octaves);
    Uncertain d_gamma{std::vector<double>(encoded), std::vector<double>(encoded)};
    for (int layer = kNerfHidden - 1; layer >= 0; --layer) {
      d = adjoint(layer, d);
      if (layer != kNerfSkip && layer != 0) continue;
      for (std::size_t i = 0; i < encoded; ++i) {
        d_gamma.value[i] += d.value[d.value.size() - encoded + i];
        d_gamma.variance[i] += d.variance[d.variance.size() - encoded + i];
      }
    }
    out->d_position.push_back(encoding_adjoint(d_gamma));
  }

  /// positional_encoding_adjoint with variances. Its operands may be rounded, and its 2 n terms are
  /// added one by one.
  Uncertain encoding_adjoint(const Uncertain& d) const {
    const std::vector<double>&x = a_.input[0], &v_x = input_variance_[0];
    const int octaves = nerf_.config.position_octaves;
    Uncertain out{std::vector<double>(3), std::vector<double>(3)};
    positional_encoding_adjoint(x.data(), octaves, d.value.data(), out.value.data());
    for (int k = 0; k < 3; ++k) {
      out.variance[k] = d.variance[k] + s2_ * (2 * octaves + 1) * d.value[k] * d.value[k];
      for (int l = 0; l < octaves; ++l)
        for (const int half : {0, 1}) {
          const int from = 3 + 2 * (k * octaves + l), at = from + half, other = from + 1 - half;
          const double frequency = std::ldexp(std::numbers::pi, l), d2 = d.value[at] * d.value[at];
          out.variance[k] +=
              frequency * frequency *
              (x[other] * x[other] * (d.variance[at] + (r2_ + s2_ * (2 * octaves + 4)) * d2) +
               d2 * v_x[other]);
        }
    }
    return out;
  }

  Uncertain layer_adjoint(int layer, const Uncertain& d, double coherent, double repeated,
                          Expected* out) {
    const NerfLayerShape shape = nerf_layer(nerf_.config, layer);
    const std::vector<double>& x = a_.input[layer];
    const std::vector<double>& v_x = input_variance_[layer];
    Uncertain d_input{std::vector<double>(shape.inputs), std::vector<double>(shape.inputs)};
    for (int o = 0; o < shape.outputs; ++o) {
      if (ref::nerf_layer_has_relu(layer) && a_.output[layer][o] <= 0) continue;
      const double value = d.value[o], square = value * value,
                   rounded = d.variance[o] + r2_ * square;
      out->gradient_deviation[shape.bias + o] += coherent * rounded + s2_ * repeated * square;
      const std::size_t row = shape.weight + std::size_t(o) * shape.inputs;
      for (int i = 0; i < shape.inputs; ++i) {
        const double w = parameters_[row + i], x2 = x[i] * x[i];
        out->gradient_deviation[row + i] +=
            coherent * (square * (v_x[i] + r2_ * x2) + x2 * rounded) + s2_ * repeated * square * x2;
        d_input.value[i] += w * value;
        d_input.variance[i] +=
            w * w * (rounded + r2_ * square + s2_ * (shape.outputs + 1) * square);
      }
    }
    return d_input;
  }

  const NerfCase& nerf_;
  std::vector<double> parameters_;
  double r2_, s2_;
  ref::NerfActivations<double> a_;
  std::array<std::vector<double>, kNerfLayers> input_variance_, output_variance_;
};

}  // namespace redrive::kernels::conformance
