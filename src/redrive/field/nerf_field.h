// SPDX-License-Identifier: Apache-2.0
// The field of the original NeRF (Mildenhall et al., ECCV 2020, section 5.1 and figure 7 of the
// supplement):
//   gamma(x) -> 5 x [width, ReLU] -> skip: concatenated with gamma(x) -> 3 x [width, ReLU]
//   -> density (1, linear) and feature (width, linear);
//   [feature, gamma(d)] -> [width/2, ReLU] -> rgb (3, linear)
// volume/composite.h applies the density's ReLU and the colours' sigmoid. gamma:
// field/positional_encoding.h. All parameters are one flat float buffer; this header has its
// layout.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace redrive {

struct NerfConfig {
  int width = 256;            ///< hidden units; a multiple of 32, 32..512
  int position_octaves = 10;  ///< L of gamma(x); 1..10
  int direction_octaves = 4;  ///< L of gamma(d); 1..4

  bool operator==(const NerfConfig&) const = default;
};

constexpr int kNerfHidden = 8;  ///< hidden layers of the trunk
constexpr int kNerfSkip = 5;    ///< the layer (from 0) whose input is [h, gamma(x)]

constexpr int encoded_size(int octaves) { return 3 + 6 * octaves; }

/// One tensor of the flat buffer: weights row-major [rows, columns] = [outputs, inputs], biases
/// [rows, 1].
struct NerfTensor {
  std::string
      name;  ///< "trunk.0.weight" ... "trunk.7.bias", "density.*", "feature.*", "colour.*", "rgb.*"
  int rows = 0, columns = 0;
  std::size_t offset = 0;
};

/// Indices of the layers: 0..7 trunk, then these.
enum NerfLayer {
  kNerfDensity = 8,
  kNerfFeature = 9,
  kNerfColour = 10,
  kNerfRgb = 11,
  kNerfLayers = 12
};

/// Offsets of a layer's weight [outputs, inputs] and bias [outputs]. Inputs of kNerfSkip: h, then
/// gamma(x); of kNerfColour: feature, then gamma(d). gamma is coordinate-major: x, y, z, then sin0
/// cos0 sin1 cos1 ... of x, then of y, then of z.
struct NerfLayerShape {
  int outputs = 0, inputs = 0;
  std::size_t weight = 0, bias = 0;  ///< offsets into the flat buffer
};

NerfLayerShape nerf_layer(const NerfConfig& config, int layer);
std::size_t nerf_parameter_count(const NerfConfig& config);
std::vector<NerfTensor> nerf_tensors(const NerfConfig& config);

/// Returns the multiply-adds of one sample, forward: 593,408 at width 256 (1.19 MFLOP).
double nerf_macs_per_sample(const NerfConfig& config);

/// Fills weights with U(-a, a), a = sqrt(6 / (inputs + outputs)) (Glorot and Bengio 2010, as the
/// paper's code), biases with 0. A function of the seed.
void nerf_initialize(const NerfConfig& config, std::uint64_t seed, std::span<float> parameters);

}  // namespace redrive
