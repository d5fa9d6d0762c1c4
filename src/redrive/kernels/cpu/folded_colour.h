// SPDX-License-Identifier: Apache-2.0
// The feature layer is linear and only the colour layer reads it, so the two are computed as one
// layer:
//   colour([Wf h + bf, gamma(d)]) = ReLU((Wc Wf) h + Wd gamma(d) + (bc + Wc bf)),  Wc and Wd the
//   two parts of colour.weight.
// The product costs width^3 / 2 multiply-adds a batch and saves width^2 a sample and pass: 11 % of
// all at width 256. Its gradient G (and g of the bias) gives those of the factors exactly:
//   dWf = Wc^T G,  dbf = Wc^T g,  dWc = G Wf^T + g bf^T.
#pragma once

#include <span>

#include "redrive/base/buffer.h"
#include "redrive/base/parallel.h"
#include "redrive/field/nerf_field.h"

namespace redrive::kernels {

class FoldedColour {
 public:
  explicit FoldedColour(const NerfConfig& config);

  /// Where the one layer stands in parameters() and gradients(): as kNerfColour, from offset 0.
  const NerfLayerShape& shape() const { return shape_; }
  std::span<const float> parameters() const { return parameters_; }
  std::span<float> gradients() { return gradients_; }

  /// Makes parameters() of the network's and keeps the factors for unfold. fp32; every sum in
  /// ascending order of the features, a multiplication and an addition each: (0 + Wc[0] Wf[0]) +
  /// Wc[1] Wf[1] ..., and (bc + Wc[0] bf[0]) + ...
  void fold(std::span<const float> parameters, ThreadPool& pool);
  /// Adds to the network's `gradients` what gradients() means for the feature and the colour layer;
  /// then gradients() is 0 again.
  void unfold(std::span<float> gradients, ThreadPool& pool);

 private:
  NerfConfig config_;
  NerfLayerShape shape_;
  Buffer<float> parameters_, gradients_;
  Buffer<float> feature_, feature_bias_;  ///< Wf [width, width], bf
  Buffer<float> colour_, d_colour_;       ///< Wc [width / 2, width], and room for its gradient
};

}  // namespace redrive::kernels
