// SPDX-License-Identifier: Apache-2.0
// A grid model for tests, small enough for plain loops, and batches for it.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/rng.h"
#include "redrive/methods/grid/grid_model.h"

namespace redrive {

/// Returns a random number in -1..1.
inline double uniform(std::uint64_t stream, std::uint64_t i) {
  return 2.0 * random_unit(random_key(61, kStreamTest, stream), i) - 1;
}

/// Returns a model with dense and hashed levels, a near region that the rays leave, and parameters
/// of order 1.
inline void make_tiny(GridModel& model, int colour_layers = 1) {
  model.field = {{2, 8, 3, 9, 8}, 16, colour_layers};
  model.proposal = {2, 1, 3, 8, 7};
  model.sky = {2, 4, 2, 6, 6};
  model.contraction = {{0.5f, 0, -0.25f}, 3, true};
  model.spacing = {0.5f, 20, 4};
  model.proposal_samples = {8, 6};
  model.samples = 5;
  model.appearance = {2, 3};
  model.initialize(4);
  // Keeps the networks' initial weights. Initial tables are too small to have an effect.
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.shape.size() != 2)
      for (std::int64_t i = 0; i < tensor.shape[0]; ++i)
        model.parameters[tensor.offset + i] = static_cast<float>(uniform(1, tensor.offset + i));
}

/// Returns a model without a sky, on a grey background.
inline void make_tiny_on_background(GridModel& model) {
  make_tiny(model);
  model.sky.n_levels = 0;
  model.appearance = {};
  model.background = 0.75f;
  Buffer<float> parameters(model.size());
  std::ranges::copy(model.parameters.span().first(model.size()), parameters.data());
  model.parameters = std::move(parameters);
}

/// Returns the first rule that a model's hyperparameters violate, "name = value: rule"; "" if none.
inline std::string error_message_of(Trainee& model) {
  const auto fail = [](const Hyperparameter& what, const std::string& value,
                       const std::string& rule) {
    throw InputError("model", what.name, value, rule);
  };
  try {
    check_ranges([&](HyperparameterVisitor& visit) { model.visit_hyperparameters(visit); }, fail);
    model.check(fail);
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

constexpr std::uint64_t kTinySeed = 9;
constexpr std::int64_t kTinyStep = 3;

inline RayBatch tiny_batch(int n) {
  RayBatch batch;
  batch.n = n;
  batch.direction.resize(3 * n);
  for (int i = 0; i < 3 * n; ++i) {
    batch.origin.push_back(static_cast<float>(0.5 * uniform(2, i)));
    batch.target.push_back(static_cast<float>(0.5 + 0.5 * uniform(3, i)));
  }
  for (int ray = 0; ray < n; ++ray) {
    double d[3], square = 0;
    for (int k = 0; k < 3; ++k) {
      d[k] = uniform(4, 3 * ray + k) + (k == 0 ? 1 : 0);
      square += d[k] * d[k];
    }
    for (int k = 0; k < 3; ++k)
      batch.direction[k * n + ray] = static_cast<float>(d[k] / std::sqrt(square));
    batch.pixel_angle.push_back(0.02f);
    batch.exposure.push_back({ray % 3 - 1, 0.15f * static_cast<float>(ray)});
  }
  return batch;
}

struct TinyLosses : RayGradientsOutput {
  double opacity = 0, rgb_mse = 0, colours = 0, sparsity = 0, loss = 0;
};
inline TinyLosses losses_of(const GridModel& model, const RayBatch& batch,
                            std::span<float> gradients, kernels::Backend& backend,
                            Workspace* workspace, std::uint64_t seed = kTinySeed,
                            std::int64_t step = kTinyStep) {
  TinyLosses out;
  static_cast<RayGradientsOutput&>(out) =
      model.gradients(backend, batch, seed, step, gradients, workspace);
  const StepSums& sums = workspace->sums();
  out.opacity = sums.opacity;
  out.rgb_mse = sums.rgb_mse;
  out.colours = sums.terms[GridModel::kColourLoss];
  out.sparsity = sums.terms[GridModel::kSparsityLoss];
  for (const LossTerm& term : model.loss_terms(sums))
    if (term.in_loss) out.loss += term.value;
  return out;
}
inline TinyLosses losses_of(const GridModel& model, const RayBatch& batch,
                            std::vector<float>* gradients, kernels::Backend& backend) {
  Workspace workspace;
  return losses_of(model, batch, *gradients, backend, &workspace);
}

inline std::size_t size_of(const ModelTensor& tensor) {
  std::size_t size = 1;
  for (const std::int64_t n : tensor.shape) size *= static_cast<std::size_t>(n);
  return size;
}

/// Makes the proposals empty beyond x = 0.5 of the cube, where rays into +x start.
inline void empty_proposals_ahead(GridModel& model) {
  const auto levels = hash_grid_levels(model.proposal);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name == "proposal")
      for (std::size_t i = 0; i < size_of(tensor); ++i) model.parameters[tensor.offset + i] = -20;
  for (const HashGridLevel& level : levels) {
    REDRIVE_CHECK(level.dense);
    const auto side = static_cast<std::uint32_t>(level.resolution) + 2;
    for (std::uint32_t z = 0; z < side; ++z)
      for (std::uint32_t y = 0; y < side; ++y)
        for (std::uint32_t x = 0; x < side / 2; ++x)
          model.parameters[model.size() - hash_grid_size(model.proposal) + level.offset +
                           hash_grid_row(level, x, y, z)] = 1;
  }
}

/// A model on a background with new random tables, and a batch in which every other ray passes only
/// through space that is empty to the proposals.
inline RayBatch make_half_empty(GridModel& model, int n) {
  make_tiny_on_background(model);
  model.proposal = {2, 1, 3, 4, 9};
  model.initialize(4);
  for (std::size_t i = 0; i < hash_grid_size(model.field.grid); ++i)
    model.parameters[i] = static_cast<float>(uniform(1, i));
  empty_proposals_ahead(model);
  RayBatch batch = tiny_batch(n);
  batch.exposure.clear();
  for (int ray = 0; ray < n; ++ray) {  // every other one backwards, into occupied space
    batch.origin[ray] = 1.5f;
    const float sign = ray % 2 ? -1.0f : 1.0f;
    for (const int k : {0, 1, 2}) batch.direction[k * n + ray] = k == 0 ? sign : 0.0f;
  }
  return batch;
}

}  // namespace redrive
