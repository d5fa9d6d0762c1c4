// SPDX-License-Identifier: Apache-2.0
// --method nerf: NeRF (Mildenhall et al. 2020), optionally with hierarchical sampling by a second
// network.
#pragma once

#include "redrive/field/nerf_field.h"
#include "redrive/field/unit_from_world.h"
#include "redrive/kernels/nerf/nerf_stages.h"
#include "redrive/methods/march/ray_model.h"
#include "redrive/model/method.h"

namespace redrive {

struct NerfModel final : RayModel {
  NerfConfig config;
  int samples = 96, fine_samples = 0;  ///< per ray
  float near_m = 1, far_m = 10;
  UnitFromWorld unit_from_world;

  int networks() const { return fine_samples > 0 ? 2 : 1; }
  std::span<const float> network(int index) const;  ///< part of `parameters`: 0 coarse, 1 fine
  kernels::NerfField field(int index) const { return {config, unit_from_world, network(index)}; }

  std::vector<std::int64_t> milestones;  ///< steps; empty: fractions of all steps

  const char* method() const override { return "nerf"; }
  std::string describe() const override;
  void visit_hyperparameters(HyperparameterVisitor& visit) override;
  void check(const HyperparameterFailure& fail) const override;
  void configure(const Scene& scene) override;
  int samples_per_ray() const override { return samples + fine_samples; }
  std::size_t size() const override { return networks() * nerf_parameter_count(config); }
  std::vector<ModelTensor> tensors() const override;
  void initialize(std::uint64_t seed) override;
  std::vector<LossTerm> loss_terms(const StepSums& sums) const override;
  double learning_rate(const Schedule& at) const override;
  std::string describe_schedule(std::int64_t total_steps) const override;
  std::vector<AdamGroup> adam_groups(double learning_rate, std::int64_t step) const override {
    return {{0, size(), adam_step(learning_rate, step)}};
  }
  std::uint64_t step_bytes() const override;
  RayGradientsOutput gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed,
                               std::int64_t step, std::span<float> gradients,
                               Workspace* workspace) const override;
  void render_rays(kernels::Backend& backend, const RayBatch& batch,
                   const kernels::CompositeOut& out, Workspace* workspace) const override;

 private:
  /// Returns `milestones`, or the default: 1/2, 3/4 and 7/8 of all steps, none for fewer than 8
  /// steps. The schedule does not depend on --max-seconds, which ends each run at another step.
  std::vector<std::int64_t> milestones_of(std::int64_t total_steps) const;
};

Method nerf_method();
bench::MethodBenchmarks nerf_benchmarks();  ///< nerf_benchmark.cc

}  // namespace redrive
