// SPDX-License-Identifier: Apache-2.0
// The field of --method grid: a hash grid (field/hash_grid.h), a density MLP and a colour MLP
// (Mueller et al. 2022, section 5.4). MLPs without biases, on any scalar type, with their adjoint:
//   h = relu(D0 features), g = D1 h (16 numbers), density = density_scale exp(min(g_0, 15)),
//   c = relu(C0 [g, Y(direction)]), with two colour layers c = relu(C1 c), raw rgb = C c
// (the sigmoid is applied by volume/composite.h). Y: field/spherical_harmonics.h.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "redrive/field/activation.h"
#include "redrive/field/constants.h"
#include "redrive/field/hash_grid.h"
#include "redrive/field/spherical_harmonics.h"

namespace redrive {

constexpr int kMaxGridWidth = 128;

struct GridFieldConfig {
  HashGridConfig grid;
  int width = 32;         ///< hidden units of both MLPs, a multiple of 16 in 16..128
  int colour_layers = 1;  ///< hidden layers of the colour MLP, 1 or 2

  bool operator==(const GridFieldConfig&) const = default;
};

enum GridLayer {
  kGridDensity0,
  kGridDensity1,
  kGridColour0,
  kGridColour1,
  kGridColourOut,
  kGridLayers
};

/// A weight matrix [outputs, inputs], row-major, at `offset` of the flat buffer. Inputs of
/// kGridColour0: geometry features, then harmonics. kGridColour1 has no outputs if there is one
/// colour layer.
struct GridLayerShape {
  const char* name = "";
  int outputs = 0, inputs = 0;
  std::size_t offset = 0;
};
GridLayerShape grid_layer(const GridFieldConfig& config, int layer);
std::size_t grid_network_size(const GridFieldConfig& config);  ///< floats of all matrices
double grid_macs_per_sample(
    const GridFieldConfig& config);  ///< multiply-adds of both MLPs, forward

/// Fills the weights with U(-a, a), a = sqrt(6 / inputs) (He et al. 2015). A function of the seed.
void grid_network_initialize(const GridFieldConfig& config, std::uint64_t seed,
                             std::span<float> weights);

/// Activations of one sample, kept for the adjoint; sized for the widest network.
template <class T>
struct GridActivations {
  std::vector<T> features;
  T hidden[kMaxGridWidth], geometry[kGeometryFeatures], harmonics[kHarmonics],
      colour[2][kMaxGridWidth], density;
};

/// Writes raw[4]: r, g, b before the sigmoid, density in 1/m (>= 0; NaN stays NaN).
template <class T>
void grid_network_forward(const GridFieldConfig& config, const T* weights, const T* features,
                          const T harmonics[kHarmonics], T density_scale, GridActivations<T>* a,
                          T raw[4]) {
  using std::exp;
  const auto product = [&](int layer, int from, const T* x, int inputs, T* out) {
    const GridLayerShape shape = grid_layer(config, layer);
    for (int o = 0; o < shape.outputs; ++o)
      for (int i = 0; i < inputs; ++i)
        out[o] += weights[shape.offset + std::size_t(o) * shape.inputs + from + i] * x[i];
  };
  const auto rectify = [&](T* x) {
    for (int i = 0; i < config.width; ++i) x[i] = relu(x[i]);
  };
  a->features.assign(features, features + config.grid.outputs());
  std::copy_n(harmonics, kHarmonics, a->harmonics);
  std::fill_n(a->hidden, config.width, T(0));
  product(kGridDensity0, 0, features, config.grid.outputs(), a->hidden);
  rectify(a->hidden);
  std::fill_n(a->geometry, kGeometryFeatures, T(0));
  product(kGridDensity1, 0, a->hidden, config.width, a->geometry);
  const T log_density = a->geometry[0] > T(kMaxLogDensity) ? T(kMaxLogDensity) : a->geometry[0];
  a->density = density_scale * exp(log_density);
  std::fill_n(a->colour[0], config.width, T(0));
  product(kGridColour0, 0, a->geometry, kGeometryFeatures, a->colour[0]);
  product(kGridColour0, kGeometryFeatures, harmonics, kHarmonics, a->colour[0]);
  rectify(a->colour[0]);
  if (config.colour_layers == 2) {
    std::fill_n(a->colour[1], config.width, T(0));
    product(kGridColour1, 0, a->colour[0], config.width, a->colour[1]);
    rectify(a->colour[1]);
  }
  std::fill_n(raw, 3, T(0));
  product(kGridColourOut, 0, a->colour[config.colour_layers - 1], config.width, raw);
  raw[3] = a->density;
}

/// Adds to d_weights and to d_features [grid.outputs()] the vector-Jacobian product of d_raw[4].
template <class T>
void grid_network_adjoint(const GridFieldConfig& config, const T* weights,
                          const GridActivations<T>& a, const T d_raw[4], T* d_weights,
                          T* d_features) {
  const auto back = [&](int layer, int from, const T* d, const T* x, int inputs, T* d_x) {
    const GridLayerShape shape = grid_layer(config, layer);
    for (int o = 0; o < shape.outputs; ++o)
      for (int i = 0; i < inputs; ++i) {
        const std::size_t at = shape.offset + std::size_t(o) * shape.inputs + from + i;
        d_weights[at] += d[o] * x[i];
        if (d_x) d_x[i] += weights[at] * d[o];
      }
  };
  const auto rectify = [&](const T* x, T* d) {
    for (int i = 0; i < config.width; ++i)
      if (!(x[i] > T(0))) d[i] = T(0);
  };
  T d_colour[2][kMaxGridWidth]{}, d_geometry[kGeometryFeatures]{}, d_hidden[kMaxGridWidth]{};
  const int last = config.colour_layers - 1;
  back(kGridColourOut, 0, d_raw, a.colour[last], config.width, d_colour[last]);
  rectify(a.colour[last], d_colour[last]);
  if (last == 1) {
    back(kGridColour1, 0, d_colour[1], a.colour[0], config.width, d_colour[0]);
    rectify(a.colour[0], d_colour[0]);
  }
  back(kGridColour0, 0, d_colour[0], a.geometry, kGeometryFeatures, d_geometry);
  back(kGridColour0, kGeometryFeatures, d_colour[0], a.harmonics, kHarmonics,
       static_cast<T*>(nullptr));
  d_geometry[0] += d_raw[3] * a.density;
  back(kGridDensity1, 0, d_geometry, a.hidden, config.width, d_hidden);
  rectify(a.hidden, d_hidden);
  back(kGridDensity0, 0, d_hidden, a.features.data(), config.grid.outputs(), d_features);
}

}  // namespace redrive
