// SPDX-License-Identifier: Apache-2.0
// --method nerf: the original (Mildenhall et al. 2020), with hierarchical sampling by a second
// network if wanted.
#pragma once

#include "redrive/field/nerf_field.h"
#include "redrive/field/unit_from_world.h"
#include "redrive/kernels/nerf_stages.h"
#include "redrive/model/model.h"

namespace redrive {

struct NerfModel final : Model {
  NerfConfig config;
  int samples = 96, fine_samples = 0;  ///< per ray
  float near_m = 1, far_m = 10;
  UnitFromWorld unit_from_world;

  int networks() const { return fine_samples > 0 ? 2 : 1; }
  std::span<const float> network(int index) const;  ///< of `parameters`: 0 coarse, 1 fine
  kernels::NerfField field(int index) const { return {config, unit_from_world, network(index)}; }

  const char* method() const override { return "nerf"; }
  std::string describe() const override;
  int samples_per_ray() const override { return samples + fine_samples; }
  void visit_numbers(NumberVisitor& visit) override;
  void check(const std::filesystem::path& file) const override;
  std::size_t size() const override { return networks() * nerf_parameter_count(config); }
  std::vector<ModelTensor> tensors() const override;
  void initialize(std::uint64_t seed) override;
  AdamStep adam(double learning_rate, std::int64_t step) const override {
    return adam_step(learning_rate, step);
  }
  StepOutput gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed,
                       std::int64_t step, std::span<float> gradients,
                       Workspace* workspace) const override;
  double loss(const LossTerms& sums) const override { return sums.coarse + sums.rgb_mse; }
  void render(kernels::Backend& backend, const RayBatch& batch, const kernels::CompositeOut& out,
              Workspace* workspace) const override;
};

}  // namespace redrive
