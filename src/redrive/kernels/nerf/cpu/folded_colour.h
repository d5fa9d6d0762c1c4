// SPDX-License-Identifier: Apache-2.0
// Folds the linear feature layer into the colour layer, its only reader:
//   colour([Wf h + bf, gamma(d)]) = ReLU((Wc Wf) h + Wd gamma(d) + (bc + Wc bf)),
// Wc and Wd are the two parts of colour.weight. Folding costs width^3 / 2 multiply-adds per batch
// and saves width^2 per sample and pass: 11 % of all at width 256. The gradient G of the folded
// weight (g of the bias) gives the gradients of both layers exactly:
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

  /// Layout of the folded layer in parameters() and gradients(): as kNerfColour, from offset 0.
  const NerfLayerShape& shape() const { return shape_; }
  std::span<const float> parameters() const { return parameters_; }
  std::span<float> gradients() { return gradients_; }

  /// Computes parameters() from the network's and keeps both layers for unfold. In fp32, sums in
  /// ascending order of the features, one multiplication and one addition each: (0 + Wc[0] Wf[0]) +
  /// Wc[1] Wf[1] ..., and (bc + Wc[0] bf[0]) + ...
  void fold(std::span<const float> parameters, ThreadPool& pool);
  /// Adds gradients() to the feature and colour layers of the network's `gradients` by the formulas
  /// above, then clears gradients().
  void unfold(std::span<float> gradients, ThreadPool& pool);

 private:
  NerfConfig config_;
  NerfLayerShape shape_;
  Buffer<float> parameters_, gradients_;
  Buffer<float> feature_, feature_bias_;  ///< Wf [width, width], bf
  Buffer<float> colour_, d_colour_;       ///< Wc [width / 2, width], and its gradient
};

}  // namespace redrive::kernels
