// SPDX-License-Identifier: Apache-2.0
// The stages are tested one by one elsewhere: here, that they are put together rightly.
#include "redrive/model/grid_model.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <set>

#include <gtest/gtest.h>

#include "redrive/base/rng.h"
#include "redrive/field/activation.h"
#include "redrive/kernels/cuda/cuda_backend.h"
#include "redrive/model/tiny_grid_model.h"

namespace redrive {
namespace {

constexpr std::uint64_t kSeed = 9;
constexpr std::int64_t kStep = 3;

RayBatch tiny_batch(int n) {
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
    for (int k = 0; k < 3; ++k) batch.direction[k * n + ray] = static_cast<float>(d[k] / std::sqrt(square));
    batch.pixel_angle.push_back(0.02f);
    batch.exposure.push_back({ray % 3 - 1, 0.15f * static_cast<float>(ray)});
  }
  return batch;
}

/// Ray `which` of a batch alone.
RayBatch ray_of(const RayBatch& batch, int which) {
  RayBatch one;
  one.n = 1;
  for (int k = 0; k < 3; ++k) {
    one.origin.push_back(batch.origin[k * batch.n + which]);
    one.direction.push_back(batch.direction[k * batch.n + which]);
    one.target.push_back(batch.target[k * batch.n + which]);
  }
  one.pixel_angle = {batch.pixel_angle[which]};
  if (!batch.exposure.empty()) one.exposure = {batch.exposure[which]};
  return one;
}

struct Losses : StepLosses, StepSums {
  double loss = 0;
};
Losses losses_of(const GridModel& model, const RayBatch& batch, std::span<float> gradients, kernels::Backend& backend,
                 Workspace* workspace, std::uint64_t seed = kSeed, std::int64_t step = kStep) {
  Losses out;
  static_cast<StepLosses&>(out) = model.gradients(backend, batch, seed, step, gradients, workspace);
  static_cast<StepSums&>(out) = workspace->fetch_sums();
  out.loss = model.loss(out);
  return out;
}
Losses losses_of(const GridModel& model, const RayBatch& batch, std::vector<float>* gradients,
                 kernels::Backend& backend) {
  Workspace workspace;
  return losses_of(model, batch, *gradients, backend, &workspace);
}

struct Picture {
  std::vector<float> rgb, depth, opacity;

  Picture(const GridModel& model, const RayBatch& batch) : rgb(3 * batch.n), depth(batch.n), opacity(batch.n) {
    Workspace workspace;
    model.render(*kernels::make_ref_backend(), batch, {rgb, depth, opacity, {}}, &workspace);
  }
};

TEST(GridModel, RenderingNeedsNoChance) {
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(7);
  const Picture once(model, batch), again(model, batch);
  EXPECT_EQ(once.rgb, again.rgb);
  EXPECT_EQ(once.depth, again.depth);
  EXPECT_EQ(once.opacity, again.opacity);
  double spread = 0;
  for (int ray = 0; ray < batch.n; ++ray) {
    // Whatever is rendered beside it.
    const Picture alone(model, ray_of(batch, ray));
    EXPECT_EQ(alone.depth[0], once.depth[ray]);
    EXPECT_EQ(alone.opacity[0], once.opacity[ray]);
    for (int k = 0; k < 3; ++k) EXPECT_EQ(alone.rgb[k], once.rgb[k * batch.n + ray]);
    EXPECT_GE(once.depth[ray], 0.5f);
    EXPECT_LE(once.depth[ray], 20.01f);
    EXPECT_GT(once.opacity[ray], 0);
    EXPECT_LE(once.opacity[ray], 1);
    spread = std::max(spread, std::abs(double(once.rgb[ray]) - once.rgb[0]));
  }
  EXPECT_GT(spread, 0.01) << "all rays alike: nothing tested";
}

TEST(GridModel, NeighboursShareTheirFirstRound) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(8);
  // Two groups of rays 1e-3 rad apart, one ray by itself, and two more: each group about its first ray.
  batch.group = {0, 4, 5, 8};
  for (const auto& [first, last] : {std::pair(0, 4), std::pair(5, 8)})
    for (int ray = first + 1; ray < last; ++ray)
      for (int k = 0; k < 3; ++k) {
        batch.origin[k * batch.n + ray] = batch.origin[k * batch.n + first];
        batch.direction[k * batch.n + ray] =
            batch.direction[k * batch.n + first] + 1e-3f * static_cast<float>((ray + k) % 3 - 1);
      }
  RayBatch each = batch;
  each.group.clear();
  const Picture together(model, batch), apart(model, each);
  double most = 0;
  for (std::size_t i = 0; i < together.rgb.size(); ++i) {
    // The same field at samples that lie elsewhere within proposals of the same place.
    EXPECT_NEAR(together.rgb[i], apart.rgb[i], 0.02) << i;
    most = std::max(most, std::abs(double(together.rgb[i]) - apart.rgb[i]));
  }
  EXPECT_GT(most, 0) << "groups change nothing: nothing tested";
  for (int k = 0; k < 3; ++k)  // alone in its group, up to the rounding of its middle's direction
    EXPECT_NEAR(together.rgb[k * batch.n + 4], apart.rgb[k * batch.n + 4], 1e-4);
}

TEST(GridModel, HomogeneousMediumInFrontOfAGreySky) {
  // All parameters 0: density exp(-1) / half_m everywhere, all colours 1/2.
  GridModel model;
  make_tiny(model);
  std::ranges::fill(model.parameters.span(), 0.0f);
  model.proposal_samples = {64, 48};
  model.samples = 48;
  const RayBatch batch = tiny_batch(5);
  const Picture picture(model, batch);
  const double density = std::exp(-1) / 3, opacity = -std::expm1(-density * 19.5);
  for (int ray = 0; ray < batch.n; ++ray) {
    // The far end of the ray is good to 20 / 4 of its s's roundings: 2e-6 of its length; the sums round 48 times.
    EXPECT_NEAR(picture.opacity[ray], opacity, 1e-5);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(picture.rgb[k * batch.n + ray], 0.5, 1e-5);
    // Half of it lies before -ln(1 - opacity / 2) / density; intervals hold 1/48 of it each, in which it counts as even.
    EXPECT_NEAR(picture.depth[ray], 0.5 - std::log1p(-opacity / 2) / density, 0.01);
  }
}

/// A field that is empty, whatever it stands before.
void make_empty(GridModel& model) {
  std::ranges::fill(model.parameters.span(), 0.0f);
  const auto at = [&](const char* name) {
    for (const ModelTensor& tensor : model.tensors())
      if (tensor.name == name) return &model.parameters[tensor.offset];
    ADD_FAILURE() << name;
    return model.parameters.data();
  };
  // Features that are positive everywhere, and a weight that makes log densities of -1000 and less of them.
  std::fill_n(at("grid"), hash_grid_size(model.field.grid), 1.0f);
  at("density.0.weight")[0] = 1;
  at("density.1.weight")[0] = -1e5f;
}

/// Without a sky, on grey.
void make_tiny_on_background(GridModel& model) {
  make_tiny(model);
  model.sky.levels = 0;
  model.appearance = {};
  model.background = 0.75f;
  Buffer<float> parameters(model.size());
  std::ranges::copy(model.parameters.span().first(model.size()), parameters.data());
  model.parameters = std::move(parameters);
}

TEST(GridModel, SkyIsWhatStandsBehindAnEmptyField) {
  GridModel model;
  make_tiny(model);
  make_empty(model);
  float* const sky = &model.parameters[model.size() - hash_grid_size(model.sky) - model.appearance.size()];
  const float colour[4] = {0.5f, -1, 2, 1000};  // a level's; the fourth is no colour
  for (std::size_t i = 0; i < hash_grid_size(model.sky); ++i) sky[i] = colour[i % 4];
  const RayBatch batch = tiny_batch(5);
  const Picture picture(model, batch);
  for (int ray = 0; ray < batch.n; ++ray) {
    EXPECT_EQ(picture.opacity[ray], 0);
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(picture.rgb[k * batch.n + ray], sigmoid(2.0 * colour[k]), 1e-6);
  }
}

TEST(GridModel, BackgroundStandsBehindAnEmptyFieldInsteadOfASky) {
  GridModel model;
  make_tiny_on_background(model);
  EXPECT_EQ(model.tensors().back().name, "proposal");
  EXPECT_NO_THROW(model.check("c"));
  make_empty(model);
  RayBatch batch = tiny_batch(5);
  const Picture rendered(model, batch);
  batch.background = tiny_batch(5).target;
  const Picture of_batch(model, batch);
  for (int i = 0; i < 15; ++i) {
    EXPECT_EQ(rendered.rgb[i], 0.75f);
    EXPECT_EQ(of_batch.rgb[i], batch.background[i]);
  }
}

TEST(GridModel, BackgroundShowsAsFarAsTheFieldLetsIt) {
  GridModel model;
  make_tiny_on_background(model);
  RayBatch batch = tiny_batch(6);
  batch.background.assign(18, 0.0f);
  const Picture black(model, batch);
  batch.background = tiny_batch(6).target;
  const Picture coloured(model, batch);
  for (int i = 0; i < 18; ++i) {
    EXPECT_NEAR(coloured.rgb[i] - black.rgb[i], (1 - black.opacity[i % 6]) * batch.background[i], 1e-6);
    EXPECT_GT(black.opacity[i % 6], 0);
    EXPECT_LT(black.opacity[i % 6], 1);
  }
}

TEST(GridModel, RaysThatMissTheCubeShowTheirBackground) {
  GridModel model;
  make_tiny_on_background(model);
  model.contraction = {{1.5f, 0, 0}, 0.8f, false};
  const RayBatch batch = tiny_batch(40);
  const Picture picture(model, batch);
  int missed = 0;
  for (int ray = 0; ray < batch.n; ++ray) {
    float origin[3], direction[3];
    for (int k = 0; k < 3; ++k) {
      origin[k] = batch.origin[k * batch.n + ray];
      direction[k] = batch.direction[k * batch.n + ray];
    }
    const RaySpacing within = spacing_of_ray(model.spacing, model.contraction, origin, direction);
    const bool misses = within.near_m == within.far_m;
    missed += misses;
    EXPECT_EQ(picture.opacity[ray] == 0, misses);
    EXPECT_TRUE(std::isfinite(picture.depth[ray]));
    for (int k = 0; misses && k < 3; ++k) EXPECT_EQ(picture.rgb[k * batch.n + ray], 0.75f);
  }
  EXPECT_GT(missed, 5);
  EXPECT_LT(missed, 38);
  std::vector<float> gradients(model.size());
  EXPECT_TRUE(std::isfinite(losses_of(model, batch, &gradients, *kernels::make_ref_backend()).loss));
  for (const float g : gradients) ASSERT_TRUE(std::isfinite(g));
}

TEST(GridModel, GradientsAreAddedToWhatIsThere) {
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(8);
  const auto backend = kernels::make_ref_backend();
  std::vector<float> once(model.size()), on_top(model.size(), 1.0f);
  const Losses a = losses_of(model, batch, &once, *backend), b = losses_of(model, batch, &on_top, *backend);
  EXPECT_EQ(a.loss, b.loss);
  for (std::size_t i = 0; i < once.size(); ++i)
    ASSERT_NEAR(on_top[i], 1.0 + once[i], 4 * 0x1p-24 * (1 + std::abs(once[i]))) << i;
}

TEST(GridModel, LossOfATargetThatIsNoNumberIsNone) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(8);
  batch.target[5] = std::numeric_limits<float>::quiet_NaN();
  std::vector<float> gradients(model.size());
  EXPECT_TRUE(std::isnan(losses_of(model, batch, &gradients, *kernels::make_ref_backend()).loss));
}

TEST(GridModel, RaysAreWeightedAndTheirErrorsHandedOut) {
  GridModel model;
  make_tiny(model);
  RayBatch batch = tiny_batch(8);
  const auto backend = kernels::make_ref_backend();
  std::vector<float> ignored(model.size());
  Workspace workspace;
  const Losses plain = losses_of(model, batch, ignored, *backend, &workspace);
  const std::vector<float> squares(plain.squares.begin(), plain.squares.end());
  ASSERT_EQ(squares.size(), 8u);
  double mean = 0;
  for (const float square : squares) mean += square / 8.0;
  EXPECT_NEAR(plain.rgb_mse, mean, 1e-6 * mean);
  batch.weight.assign(8, 0);
  const double gains = losses_of(model, batch, &ignored, *backend).colours;  // what keeps them near 1
  double sum = 0;
  for (int ray = 0; ray < 8; ++ray) {
    batch.weight[ray] = 2;
    const Losses one = losses_of(model, batch, ignored, *backend, &workspace);
    EXPECT_TRUE(std::ranges::equal(one.squares, squares));
    EXPECT_EQ(one.rgb_mse, plain.rgb_mse);
    sum += one.colours - gains;
    batch.weight[ray] = 0;
  }
  EXPECT_NEAR(sum, 2 * (plain.colours - gains), 1e-6 * sum);
  batch.by_error = 5;
  EXPECT_NEAR(losses_of(model, batch, &ignored, *backend).rgb_mse, (squares[0] + squares[1] + squares[2]) / 3, 1e-6)
      << "of the even ones";
}

TEST(GridModel, SamplesFollowSeedAndStep) {
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(8);
  const auto backend = kernels::make_ref_backend();
  std::set<double> losses;
  Workspace workspace;
  for (const auto& [seed, step] : {std::pair{1, 0}, {1, 1}, {2, 0}, {1, 0}}) {
    std::vector<float> gradients(model.size());
    losses.insert(losses_of(model, batch, gradients, *backend, &workspace, seed, step).loss);
  }
  EXPECT_EQ(losses.size(), 3u);
}

std::size_t size_of(const ModelTensor& tensor) {
  std::size_t size = 1;
  for (const std::int64_t n : tensor.shape) size *= static_cast<std::size_t>(n);
  return size;
}

/// (loss(parameters + h direction) - loss(parameters - h direction)) / 2h, the direction in one tensor.
double difference(GridModel& model, const ModelTensor& tensor, const std::vector<float>& direction, float h,
                  const std::function<double()>& loss) {
  float* const parameters = &model.parameters[tensor.offset];
  const std::vector<float> before(parameters, parameters + direction.size());
  double at[2];
  for (const int side : {0, 1}) {
    for (std::size_t i = 0; i < direction.size(); ++i) parameters[i] = before[i] + (side ? h : -h) * direction[i];
    at[side] = loss();
  }
  std::ranges::copy(before, parameters);
  return (at[1] - at[0]) / (2.0 * h);
}

/// The gradient of one tensor against differences of the loss along its own signs and along random ones. A kink of a ReLU that h
/// crosses costs its share, so h is small where there are any. The loss is good to half an ulp of its colours: 2^-25 / h.
void expect_derivative(GridModel& model, const ModelTensor& tensor, const std::vector<float>& gradients,
                       const std::function<double()>& loss, double factor = 1) {
  const bool rectified = tensor.name != "sky" && tensor.name != "appearance" && tensor.name != "proposal" &&
                         tensor.name != "colour.out.weight";
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
  EXPECT_NEAR(difference(model, tensor, steepest, h, loss), sum, 0.01 * sum + 0x1p-25 / h) << tensor.name;
  EXPECT_NEAR(difference(model, tensor, random, h, loss), along, 0.02 * std::sqrt(squares) + 0x1p-25 / h)
      << tensor.name;
}

TEST(GridModelGradients, OfFieldAndSkyAreThoseOfTheColours) {
  const auto backend = kernels::make_ref_backend();
  for (const auto& [colour_layers, weighted] : {std::pair{1, false}, {2, false}, {1, true}}) {
    GridModel model;
    make_tiny(model, colour_layers);
    RayBatch batch = tiny_batch(8);
    if (weighted)
      for (int ray = 0; ray < 8; ++ray) batch.weight.push_back(static_cast<float>(1 + 0.75 * uniform(10, ray)));
    std::vector<float> gradients(model.size()), ignored(model.size());
    losses_of(model, batch, &gradients, *backend);
    for (const ModelTensor& tensor : model.tensors())
      if (tensor.name != "proposal")
        expect_derivative(model, tensor, gradients,
                          [&] { return losses_of(model, batch, &ignored, *backend).colours; });
  }
}

/// The rays' own derivatives, where nothing but their samples' places moves with them: proposals see the same everywhere, so that distances
/// stay, and colours do not change with the direction.
TEST(GridModelGradients, OfRaysAreThoseOfTheColours) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  for (const ModelTensor& tensor : model.tensors()) {
    float* const values = &model.parameters[tensor.offset];
    if (tensor.name == "proposal") std::fill_n(values, size_of(tensor), 0.0f);
    if (tensor.name == "colour.0.weight")
      for (std::int64_t row = 0; row < tensor.shape[0]; ++row)
        std::fill_n(values + row * tensor.shape[1] + kGeometry, kHarmonics, 0.0f);
  }
  RayBatch batch = tiny_batch(8);
  batch.refines = true;
  std::vector<float> gradients(model.size());
  const Losses losses = losses_of(model, batch, &gradients, *backend);
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
    EXPECT_NEAR(difference, along, 0.03 * std::sqrt(squares) + 0x1p-25 / h) << (turns ? "turned" : "moved");
    EXPECT_GT(std::sqrt(squares), 30 * 0x1p-25 / h) << "nothing tested";
  }
  batch.refines = false;
  EXPECT_TRUE(losses_of(model, batch, &gradients, *backend).d_origin.empty());
}

TEST(GridModelGradients, OfRangesAreThoseOfTheirLoss) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  model.proposal_samples = {8, 1};  // as below
  RayBatch batch = tiny_batch(8);
  for (int ray = 0; ray < batch.n; ++ray) batch.range_m.push_back(1 + 2.1f * static_cast<float>(ray));
  batch.target.clear();
  batch.exposure.clear();
  Workspace workspace;
  constexpr std::int64_t kLate = 10'000;  // the last spread
  for (const std::int64_t step : {std::int64_t{0}, kLate}) {
    std::vector<float> gradients(model.size()), ignored(model.size());
    const auto loss = [&](std::span<float> of) {
      model.range_gradients(*backend, batch, kSeed, step, of, &workspace);
      return workspace.sums().range / kRangeWeight;
    };
    EXPECT_GT(loss(gradients), 0.1);
    double of_colour = 0;
    for (const ModelTensor& tensor : model.tensors()) {
      if (tensor.name == "grid" || tensor.name.starts_with("density"))
        expect_derivative(
            model, tensor, gradients, [&] { return loss(ignored); }, 1 / kRangeWeight);
      if (tensor.name.starts_with("colour") || tensor.name == "sky" || tensor.name == "appearance")
        for (std::size_t i = 0; i < size_of(tensor); ++i) of_colour += std::abs(gradients[tensor.offset + i]);
    }
    EXPECT_EQ(of_colour, 0);
  }
}

TEST(GridModelGradients, OfEmptySpaceAreThoseOfItsLoss) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(8);
  const auto added = [&](const auto& of) {  // by the loss of empty space
    model.empty_space = 0.5f;
    const auto with = of();
    model.empty_space = 0;
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
    const auto [with, alone] = added([&] { return losses_of(model, batch, &ignored, *backend).loss; });
    return with - alone;
  };
  double of_others = 0;
  for (const ModelTensor& tensor : model.tensors()) {
    if (tensor.name == "grid" || tensor.name.starts_with("density"))
      expect_derivative(model, tensor, gradients, loss);
    else
      for (std::size_t i = 0; i < size_of(tensor); ++i) of_others += std::abs(gradients[tensor.offset + i]);
  }
  EXPECT_EQ(of_others, 0);
}

TEST(GridModelGradients, OnABackgroundAreThoseOfTheColours) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny_on_background(model);
  RayBatch batch = tiny_batch(8);
  for (int i = 0; i < 24; ++i) batch.background.push_back(static_cast<float>(0.5 + 0.5 * uniform(9, i)));
  std::vector<float> gradients(model.size()), ignored(model.size());
  losses_of(model, batch, &gradients, *backend);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name != "proposal")
      expect_derivative(model, tensor, gradients, [&] { return losses_of(model, batch, &ignored, *backend).colours; });
}

TEST(GridModelGradients, OfTheProposalsAreThoseOfTheirLoss) {
  // One interval in the second round: where the field is sampled does not depend on what the proposals found.
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny(model);
  model.proposal_samples = {8, 1};
  const RayBatch batch = tiny_batch(8);
  std::vector<float> gradients(model.size()), ignored(model.size());
  const Losses losses = losses_of(model, batch, &gradients, *backend);
  EXPECT_GT(losses.loss, losses.colours);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name == "proposal")
      expect_derivative(model, tensor, gradients, [&] { return losses_of(model, batch, &ignored, *backend).loss; });
}

/// What lies beyond x = 0.5 of the cube is empty to the proposals: rays into +x start there.
void empty_proposals_ahead(GridModel& model) {
  const auto levels = hash_grid_levels(model.proposal);
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name == "proposal")
      for (std::size_t i = 0; i < size_of(tensor); ++i) model.parameters[tensor.offset + i] = -20;
  for (const HashGridLevel& level : levels) {
    ASSERT_TRUE(level.dense);
    const auto side = static_cast<std::uint32_t>(level.cells) + 2;
    for (std::uint32_t z = 0; z < side; ++z)
      for (std::uint32_t y = 0; y < side; ++y)
        for (std::uint32_t x = 0; x < side / 2; ++x)
          model.parameters[model.size() - hash_grid_size(model.proposal) + level.offset +
                           hash_grid_row(level, x, y, z)] = 1;
  }
}

TEST(GridModel, EmptyRaysCostTheFieldNothing) {
  const auto backend = kernels::make_ref_backend();
  GridModel model;
  make_tiny_on_background(model);
  model.appearance = {};
  model.proposal = {2, 1, 3, 4, 9};
  model.initialize(4);
  for (std::size_t i = 0; i < hash_grid_size(model.field.grid); ++i)
    model.parameters[i] = static_cast<float>(uniform(1, i));
  empty_proposals_ahead(model);
  constexpr int kRays = 256;
  RayBatch batch = tiny_batch(kRays);
  batch.exposure.clear();
  for (int ray = 0; ray < kRays; ++ray) {  // every other one backwards, into what the proposals see
    batch.origin[ray] = 1.5f;
    const float sign = ray % 2 ? -1.0f : 1.0f;
    for (const int k : {0, 1, 2}) batch.direction[k * kRays + ray] = k == 0 ? sign : 0.0f;
  }
  std::vector<float> gradients(model.size());
  const Losses losses = losses_of(model, batch, &gradients, *backend);
  // Of 128 empty rays one in 16 is looked at all the same: 8 with a standard deviation of 2.7.
  EXPECT_GT(losses.field_rays, kRays / 2);
  EXPECT_LT(losses.field_rays, kRays / 2 + 8 + 5 * 3);

  const Picture picture(model, batch);
  for (int ray = 0; ray < kRays; ++ray) {
    const Picture alone(model, ray_of(batch, ray));  // a batch of one ray is never empty
    if (ray % 2) {
      EXPECT_GT(picture.opacity[ray], 0) << ray;
      EXPECT_EQ(picture.opacity[ray], alone.opacity[0]) << ray;
      EXPECT_EQ(picture.depth[ray], alone.depth[0]) << ray;
      for (int k = 0; k < 3; ++k) EXPECT_EQ(picture.rgb[k * kRays + ray], alone.rgb[k]) << ray;
    } else {
      EXPECT_EQ(picture.opacity[ray], 0) << ray;
      EXPECT_GT(alone.opacity[0], 0) << ray;
      EXPECT_FLOAT_EQ(picture.depth[ray], model.spacing.far_m) << ray;
      for (int k = 0; k < 3; ++k) EXPECT_EQ(picture.rgb[k * kRays + ray], model.background) << ray;
    }
  }
  for (const ModelTensor& tensor : model.tensors())
    if (tensor.name != "proposal")
      expect_derivative(model, tensor, gradients, [&] {
        std::vector<float> ignored(model.size());
        return losses_of(model, batch, &ignored, *backend).colours;
      });
}

TEST(GridModelGradients, AreTheSameOnEveryBackend) {
  // The stages differ by roundings, a few hundred of 2^-24 one after the other; a sample or ray out of place is of order 1. Where the
  // networks round to bf16, a dozen of 2^-8, two a product, count alone.
  GridModel model;
  make_tiny(model);
  const RayBatch batch = tiny_batch(50);
  std::vector<float> expected(model.size());
  const Losses losses = losses_of(model, batch, &expected, *kernels::make_ref_backend());
  std::vector<std::unique_ptr<kernels::Backend>> backends;
  backends.push_back(kernels::make_loop_backend());
  for (const Isa isa : all_isas())
    if (!isa_obstacle(isa)) backends.push_back(kernels::make_cpu_backend(isa, 2));
  for (const auto& backend : backends) {
    const std::string name = kernels::describe(*backend);
    const double tolerance = backend->isa() == Isa::kAvx512Bf16 ? 12 * 0x1p-8 : 1e-4;
    std::vector<float> gradients(model.size());
    const Losses got = losses_of(model, batch, &gradients, *backend);
    EXPECT_NEAR(got.loss, losses.loss, tolerance * losses.loss) << name;
    EXPECT_NEAR(got.opacity, losses.opacity, tolerance) << name;
    for (const ModelTensor& tensor : model.tensors()) {
      double square = 0, difference = 0;
      for (std::size_t i = tensor.offset; i < tensor.offset + size_of(tensor); ++i) {
        square += double(expected[i]) * expected[i];
        difference += std::pow(double(gradients[i]) - expected[i], 2);
      }
      EXPECT_GT(square, 0) << tensor.name;
      EXPECT_LE(std::sqrt(difference), tolerance * std::sqrt(square)) << name << ", " << tensor.name;
    }
  }
}

}  // namespace
}  // namespace redrive
