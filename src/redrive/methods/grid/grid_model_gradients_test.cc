// SPDX-License-Identifier: Apache-2.0
// Gradients of the whole model, compared to finite differences of its losses and between backends.
#include <cmath>
#include <functional>

#include <gtest/gtest.h>

#include "redrive/methods/grid/grid_model.h"
#include "redrive/methods/grid/tiny_grid_model_testing.h"

namespace redrive {
namespace {

/// Returns (loss(parameters + h direction) - loss(parameters - h direction)) / 2h, with a direction
/// in one tensor.
double difference(GridModel& model, const ModelTensor& tensor, const std::vector<float>& direction,
                  float h, const std::function<double()>& loss) {
  float* const parameters = &model.parameters[tensor.offset];
  const std::vector<float> before(parameters, parameters + direction.size());
  double at[2];
  for (const int side : {0, 1}) {
    for (std::size_t i = 0; i < direction.size(); ++i)
      parameters[i] = before[i] + (side ? h : -h) * direction[i];
    at[side] = loss();
  }
  std::ranges::copy(before, parameters);
  return (at[1] - at[0]) / (2.0 * h);
}

/// Compares the gradient of one tensor to differences of the loss along its own signs and along
/// random ones. Crossing a ReLU's kink adds an error, so h is small where there are ReLUs. Rounding
/// of the loss adds half an ulp of its colours: 2^-25 / h.
void expect_derivative(GridModel& model, const ModelTensor& tensor,
                       const std::vector<float>& gradients, const std::function<double()>& loss,
                       double factor = 1) {
  const bool rectified = tensor.name != "sky" && tensor.name != "appearance" &&
                         tensor.name != "proposal" && tensor.name != "colour.out.weight";
  const float h = rectified ? 0x1p-14f : 0x1p-8f;
  double sum = 0, squares = 0, along = 0;
  std::vector<float> steepest, random;
  for (std::size_t i = 0; i < size_of(tensor); ++i) {
    const float g = static_cast<float>(factor * gradients[tensor.offset + i]);
    sum += std::abs(g);
    squares += double(g) * g;
    steepest.push_back(g > 0 ? 1.0f : -1.0f);
    random.push_back(uniform(7, i) > 0 ? 1.0f : -1.0f);
    along += g * random.back();
  }
  EXPECT_GT(sum, 1e-3) << "nothing tested";
  EXPECT_NEAR(difference(model, tensor, steepest, h, loss), sum, 0.01 * sum + 0x1p-25 / h)
      << tensor.name;
  EXPECT_NEAR(difference(model, tensor, random, h, loss), along,
              0.02 * std::sqrt(squares) + 0x1p-25 / h)
      << tensor.name;
}

TEST(GridModelGradients, OfFieldAndSkyMatchTheColourLoss) {
  const auto backend = kernels::make_ref_backend();
  for (const auto& [colour_layers, weighted] : {std::pair{1, false}, {2, false}, {1, true}}) {
    GridModel model;
    make_tiny(model, colour_layers);
    RayBatch batch = tiny_batch(8);
    if (weighted)
      for (int ray = 0; ray < 8; ++ray)
        batch.weight.push_back(static_cast<float>(1 + 0.75 * uniform(10, ray)));
    std::vector<float> gradients(model.size()), ignored(model.size());
    losses_of(model, batch, &gradients, *backend);
    for (const ModelTensor& tensor : model.tensors())
      if (tensor.name != "proposal")
        expect_derivative(model, tensor, gradients,
                          [&] { return losses_of(model, batch, &ignored, *backend).colours; });
  }
}

/// Derivatives of rays where only the positions of samples move with them: proposals are constant,
/// so that distances stay, and colours do not depend on the direction.
TEST(GridModelGradients, OfRaysMatchTheColourLoss) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  for (const ModelTensor& tensor : model.tensors()) {
    float* const values = &model.parameters[tensor.offset];
    if (tensor.name == "proposal") std::fill_n(values, size_of(tensor), 0.0f);
    if (tensor.name == "colour.0.weight")
      for (std::int64_t row = 0; row < tensor.shape[0]; ++row)
        std::fill_n(values + row * tensor.shape[1] + kGeometryFeatures, kHarmonics, 0.0f);
  }
  RayBatch batch = tiny_batch(8);
  batch.refines = true;
  std::vector<float> gradients(model.size());
  const TinyLosses losses = losses_of(model, batch, &gradients, *backend);
  ASSERT_EQ(losses.d_origin.size(), 24u);
  ASSERT_EQ(losses.d_direction.size(), 24u);
  const auto colours = [&](const RayBatch& moved) {
    std::vector<float> ignored(model.size());
    return losses_of(model, moved, &ignored, *backend).colours;
  };
  for (const bool turns : {false, true}) {
    const std::vector<float>& d = turns ? losses.d_direction : losses.d_origin;
    double along = 0, squares = 0;
    RayBatch moved[2] = {batch, batch};
    constexpr float h = 0x1p-11f;
    for (std::size_t i = 0; i < d.size(); ++i) {
      const float sign = uniform(8, i) > 0 ? 1.0f : -1.0f;
      for (const int side : {0, 1}) {
        std::vector<float>& values = turns ? moved[side].direction : moved[side].origin;
        values[i] += side ? h * sign : -h * sign;
      }
      along += sign * d[i];
      squares += double(d[i]) * d[i];
    }
    const double difference = (colours(moved[1]) - colours(moved[0])) / (2 * h);
    EXPECT_NEAR(difference, along, 0.03 * std::sqrt(squares) + 0x1p-25 / h)
        << (turns ? "turned" : "moved");
    EXPECT_GT(std::sqrt(squares), 30 * 0x1p-25 / h) << "nothing tested";
  }
  batch.refines = false;
  EXPECT_TRUE(losses_of(model, batch, &gradients, *backend).d_origin.empty());
}

TEST(GridModelGradients, OfRangesMatchTheLidarLoss) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  model.proposal_samples = {8, 1};  // as below
  RayBatch batch = tiny_batch(8);
  for (int ray = 0; ray < batch.n; ++ray)
    batch.range_m.push_back(1 + 2.1f * static_cast<float>(ray));
  batch.target.clear();
  batch.exposure.clear();
  Workspace workspace;
  constexpr std::int64_t kLate = 10'000;  // at the final spread
  for (const std::int64_t step : {std::int64_t{0}, kLate}) {
    std::vector<float> gradients(model.size()), ignored(model.size());
    const auto loss = [&](std::span<float> of) {
      model.range_gradients(*backend, batch, kTinySeed, step, of, &workspace);
      return workspace.sums().terms[GridModel::kLidarLoss] / model.range_weight;
    };
    EXPECT_GT(loss(gradients), 0.1);
    double of_colour = 0;
    for (const ModelTensor& tensor : model.tensors()) {
      if (tensor.name == "grid" || tensor.name.starts_with("density"))
        expect_derivative(
            model, tensor, gradients, [&] { return loss(ignored); }, 1 / model.range_weight);
      if (tensor.name.starts_with("colour") || tensor.name == "sky" || tensor.name == "appearance")
        for (std::size_t i = 0; i < size_of(tensor); ++i)
          of_colour += std::abs(gradients[tensor.offset + i]);
    }
    EXPECT_EQ(of_colour, 0);
  }
}

TEST(GridModelGradients, OfTheSparsityLossMatchIt) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(8);
  const auto added = [&](const auto& of) {  // added by the sparsity loss
    model.sparsity_weight = 0.5f;
    const auto with = of();
    model.sparsity_weight = 0;
    return std::pair(with, of());
  };
  const auto gradients_now = [&] {
    std::vector<float> gradients(model.size());
    losses_of(model, batch, &gradients, *backend);
    return gradients;
  };
  auto [gradients, without] = added(gradients_now);
  for (std::size_t i = 0; i < gradients.size(); ++i) gradients[i] -= without[i];
  const auto loss = [&] {
    std::vector<float> ignored(model.size());
    const auto [with, alone] =
        added([&] { return losses_of(model, batch, &ignored, *backend).loss; });
    return with - alone;
  };
  double of_others = 0;
  for (const ModelTensor& tensor : model.tensors()) {
    if (tensor.name == "grid" || tensor.name.starts_with("density"))
      expect_derivative(model, tensor, gradients, loss);
    else
      for (std::size_t i = 0; i < size_of(tensor); ++i)
        of_others += std::abs(gradients[tensor.offset + i]);
  }
  EXPECT_EQ(of_others, 0);
}

TEST(GridModelGradients, OnABackgroundMatchTheColourLoss) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny_on_background(model);
  RayBatch batch = tiny_batch(8);
  for (int i = 0; i < 24; ++i)
    batch.background.push_back(static_cast<float>(0.5 + 0.5 * uniform(9, i)));
  std::vector<float> gradients(model.size()), ignored(model.size());
  losses_of(model, batch, &gradients, *backend);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name != "proposal")
      expect_derivative(model, tensor, gradients,
                        [&] { return losses_of(model, batch, &ignored, *backend).colours; });
}

TEST(GridModelGradients, OfProposalsMatchTheProposalLoss) {
  // One interval in the second iteration, so that the field's samples do not depend on the
  // proposals.
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  model.proposal_samples = {8, 1};
  const RayBatch batch = tiny_batch(8);
  std::vector<float> gradients(model.size()), ignored(model.size());
  const TinyLosses losses = losses_of(model, batch, &gradients, *backend);
  EXPECT_GT(losses.loss, losses.colours);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name == "proposal")
      expect_derivative(model, tensor, gradients,
                        [&] { return losses_of(model, batch, &ignored, *backend).loss; });
}

TEST(GridModelGradients, WithEmptyRaysMatchTheColourLoss) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  const RayBatch batch = make_half_empty(model, 256);
  std::vector<float> gradients(model.size()), ignored(model.size());
  losses_of(model, batch, &gradients, *backend);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name != "proposal")
      expect_derivative(model, tensor, gradients,
                        [&] { return losses_of(model, batch, &ignored, *backend).colours; });
}

TEST(GridModelGradients, AreTheSameOnEveryBackend) {
  // Stages differ by a few hundred consecutive roundings of 2^-24; a misplaced sample or ray
  // differs by order 1. Where networks round to bf16, a dozen roundings of 2^-8, two per product,
  // dominate.
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(50);
  std::vector<float> expected(model.size());
  const TinyLosses losses = losses_of(model, batch, &expected, *kernels::make_ref_backend());
  std::vector<std::unique_ptr<kernels::Backend>> backends;
  for (const Isa isa : all_isas())
    if (!isa_obstacle(isa)) backends.push_back(kernels::make_cpu_backend(isa, 2));
  for (const auto& backend : backends) {
    const std::string name = kernels::describe(*backend);
    const double tolerance = backend->isa() == Isa::kAvx512Bf16 ? 12 * 0x1p-8 : 1e-4;
    std::vector<float> gradients(model.size());
    const TinyLosses got = losses_of(model, batch, &gradients, *backend);
    EXPECT_NEAR(got.loss, losses.loss, tolerance * losses.loss) << name;
    EXPECT_NEAR(got.opacity, losses.opacity, tolerance) << name;
    for (const ModelTensor& tensor : model.tensors()) {
      double square = 0, difference = 0;
      for (std::size_t i = tensor.offset; i < tensor.offset + size_of(tensor); ++i) {
        square += double(expected[i]) * expected[i];
        difference += std::pow(double(gradients[i]) - expected[i], 2);
      }
      EXPECT_GT(square, 0) << tensor.name;
      EXPECT_LE(std::sqrt(difference), tolerance * std::sqrt(square))
          << name << ", " << tensor.name;
    }
  }
}

}  // namespace
}  // namespace redrive
