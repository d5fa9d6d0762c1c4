// SPDX-License-Identifier: Apache-2.0
// --method grid: a hash-grid field for unbounded scenes with proposal sampling, in front of a sky
// that depends on direction alone. Images with a constant background have no sky.
// Hyperparameters: grid_model_config.cc; parameters: grid_model_parts.cc.
#pragma once

#include <array>
#include <vector>

#include "redrive/field/appearance.h"
#include "redrive/field/contraction.h"
#include "redrive/field/grid_field.h"
#include "redrive/kernels/grid/grid_stages.h"
#include "redrive/methods/march/ray_model.h"
#include "redrive/model/method.h"
#include "redrive/volume/ray_intervals.h"

namespace redrive {

struct GridModel final : RayModel {
  GridModel();

  GridFieldConfig field{{8, 4, 16, 4096, 18}, 32, 1};
  HashGridConfig proposal{5, 1, 16, 512, 17};
  HashGridConfig sky{4, 4, 8, 256,
                     15};  ///< over directions; three features are colours, summed over the levels
  /// threshold for colours in [0, 1], optim/photometric_loss.h; 2 and more: squared error
  float huber_delta = 0.2f;
  AppearanceConfig appearance;  ///< exposure of each camera over time
  float background =
      0;  ///< grey behind rays where sky.n_levels is 0 and the batch has no background
  Contraction contraction;
  RaySpacing spacing{0.5f, 1000.0f, 20.0f};
  std::array<int, 2> proposal_samples{64, 32};  ///< per ray, first and second iteration
  int samples = 24;                             ///< per ray, at which the field is evaluated
  float histogram_padding = 0.1f;               ///< volume/ray_intervals.h
  float sparsity_weight = 0;                    ///< optim/sparsity_loss.h
  double proposal_opacity_weight = 0.1;         ///< optim/proposal_loss.h
  float range_weight = 0.03f;                   ///< weight of the LiDAR loss, optim/range_loss.h
  /// Standard deviation of a return in the LiDAR loss: at first wide enough to find surfaces, at
  /// the end the uncertainty of a return's range and time.
  float first_range_spread_m = 1, last_range_spread_m = 0.1f;
  float range_spread_half_life = 300;  ///< steps
  int rays_per_proposal_ray = 4;       ///< the proposals train on one ray of this many
  /// Rays below this proposal opacity count as empty: at most two and a half steps of 255.
  float min_active_opacity = 0.01f;
  float keep_probability =
      1 / 16.0f;                ///< for an empty ray in training, so that new surfaces can appear
  double max_batch_factor = 2;  ///< maximum rays of a step, as a multiple of batch_rays
  float initial_density = 0.36787944f;  ///< 1 / contraction.half_m: a mean free path of e half_m
  int warm_up_steps = 100;
  float beta2 = 0.99f, epsilon = 1e-15f;  ///< Adam's: Mueller et al. 2022, section 4
  double active_fraction = 1;             ///< moving average of the fraction of active rays
  float min_proposal_footprint =
      0;  ///< for a proposal sample's volume, in lengths of its interval (GridStages::contract)

  const char* method() const override { return "grid"; }
  std::string describe() const override;
  int samples_per_ray() const override {
    return proposal_samples[0] + proposal_samples[1] + samples;
  }
  void visit_hyperparameters(HyperparameterVisitor& visit) override;
  void visit_state(HyperparameterVisitor& visit) override;
  void check(const HyperparameterFailure& fail) const override;
  void configure(const Scene& scene) override;
  int rays_per_step() const override;
  int max_rays_per_step() const override { return static_cast<int>(batch_rays * max_batch_factor); }
  std::size_t size() const override { return offset(kParts); }
  std::vector<ModelTensor> tensors() const override;
  void initialize(std::uint64_t seed) override;
  /// Returns the gradients of the networks: the gradients of the field's grid are computed through
  /// them, and the other grids' cannot overflow.
  std::span<const float> sentinels(std::span<const float> gradients) const override {
    return gradients.subspan(offset(kNetwork), part_size(kNetwork));
  }
  std::vector<LossTerm> loss_terms(const StepSums& sums) const override;
  double learning_rate(const Schedule& at) const override;
  std::string describe_schedule(std::int64_t total_steps) const override;
  std::vector<AdamGroup> adam_groups(double learning_rate, std::int64_t step) const override;
  void finish_step(kernels::Backend& backend, const StepRequest& request, const StepOutput& output,
                   std::int64_t step, const StepBuffers& buffers, AdamState* adam) override;
  RayGradientsOutput gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed,
                               std::int64_t step, std::span<float> gradients,
                               Workspace* workspace) const override;
  void range_gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed,
                       std::int64_t step, std::span<float> gradients,
                       Workspace* workspace) const override;
  void render_rays(kernels::Backend& backend, const RayBatch& batch,
                   const kernels::CompositeOut& out, Workspace* workspace) const override;

  /// Index in StepSums::terms; the proposals have one for each iteration.
  enum LossSlot { kColourLoss, kSparsityLoss, kLidarLoss, kProposalLoss };
  enum Part { kFieldGrid, kNetwork, kProposalGrid, kSkyGrid, kAppearance, kParts };
  kernels::HashGrid grid(
      Part which) const;  ///< part of `parameters`: kFieldGrid, kProposalGrid or kSkyGrid
  kernels::GridNetwork network() const { return {field, density_scale(), part(kNetwork)}; }

 private:
  struct StepKeys;
  struct RayBundle;
  struct IntervalSamples;
  struct ForwardPass;

  /// Returns the intervals of rays with their positions in the unit cube.
  IntervalSamples contract_intervals(kernels::Backend& backend, const RayBundle& bundle,
                                     int per_ray, std::span<const float> edges, float min_footprint,
                                     Workspace* workspace) const;
  /// Evaluates the background of all rays: the sky, or the batch's colours.
  void evaluate_sky(kernels::Backend& backend, const RayBatch& batch, ForwardPass* pass,
                    Workspace* workspace) const;
  /// Runs both proposal iterations and draws the field's intervals from the second one's weights.
  /// keys null: without random numbers.
  ForwardPass sample_proposals(kernels::Backend& backend, const RayBatch& batch,
                               const StepKeys* keys, Workspace* workspace) const;
  /// Compacts the batch to the active rays, those on which the proposals have opacity.
  void compact_batch(kernels::Backend& backend, const StepKeys* keys, ForwardPass* pass,
                     Workspace* workspace) const;
  /// Evaluates the field at the samples of active rays.
  void sample(kernels::Backend& backend, ForwardPass* pass, Workspace* workspace) const;
  ForwardPass forward(kernels::Backend& backend, const RayBatch& batch, const StepKeys* keys,
                      const kernels::CompositeOut& out, Workspace* workspace) const;
  /// Backward pass of the field from d_raw of the active rays. d_position [3, their samples] in the
  /// unit cube, or empty: not wanted.
  void backward_field(kernels::Backend& backend, const ForwardPass& pass,
                      std::span<const float> d_raw, std::span<float> gradients,
                      std::span<float> d_position, Workspace* workspace) const;
  /// Computes d_origin and d_direction [3, all rays] from the samples' d_position.
  void backward_rays(kernels::Backend& backend, const ForwardPass& pass,
                     std::span<const float> d_position, std::span<float> d_origin,
                     std::span<float> d_direction, Workspace* workspace) const;
  /// losses [2]: one for each iteration.
  void backward_proposals(kernels::Backend& backend, const ForwardPass& pass,
                          std::span<const float> weights, std::span<float> gradients,
                          std::span<double> losses, Workspace* workspace) const;
  void configure_bounded();
  std::size_t part_size(int part) const;
  std::size_t offset(int part) const;  ///< offset of the part in `parameters`
  std::span<const float> part(Part part) const {
    return parameters.span().subspan(offset(part), part_size(part));
  }
  std::span<float> part_of(std::span<float> all, Part part) const {
    return all.subspan(offset(part), part_size(part));
  }
  /// Returns the density, 1/m, where the log density is 0, as it is at first.
  float density_scale() const { return initial_density / contraction.half_m; }
};

Method grid_method();
bench::MethodBenchmarks grid_benchmarks();  ///< grid_benchmark.cc

}  // namespace redrive
