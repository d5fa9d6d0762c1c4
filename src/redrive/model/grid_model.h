// SPDX-License-Identifier: Apache-2.0
// --method grid: a hash-grid field for unbounded scenes, sampled where a proposal field found something, before a sky that depends on
// direction alone.
#pragma once

#include <array>

#include "redrive/field/contraction.h"
#include "redrive/field/grid_field.h"
#include "redrive/model/model.h"
#include "redrive/sampling/proposal.h"

namespace redrive {

struct GridModel final : Model {
  GridFieldConfig field{{8, 4, 16, 4096, 18}, 32, 1};
  HashGridConfig proposal{5, 1, 16, 512, 17};
  HashGridConfig sky{4, 4, 8, 256, 15};  ///< over directions; three features are colours, the sum of the levels counts
  Contraction contraction;
  RaySpacing spacing{0.5f, 1000.0f, 20.0f};
  std::array<int, 2> proposal_samples{64, 32};  ///< per ray, first and second round
  int samples = 24;                             ///< per ray, of the field

  const char* method() const override { return "grid"; }
  std::string describe() const override;
  int samples_per_ray() const override { return proposal_samples[0] + proposal_samples[1] + samples; }
  void visit_numbers(NumberVisitor& visit) override;
  void check(const std::filesystem::path& file) const override;
  std::size_t size() const override { return offset(kParts); }
  std::vector<ModelTensor> tensors() const override;
  void initialize(std::uint64_t seed) override;
  /// The networks': whatever reaches the field's grid comes through them, the other grids' adjoints have no overflow.
  std::span<const float> sentinels(std::span<const float> gradients) const override {
    return gradients.subspan(offset(kNetwork), part_size(kNetwork));
  }
  /// Mueller et al. 2022, section 4.
  AdamStep adam(double learning_rate, std::int64_t step) const override;
  StepLosses gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed, std::int64_t step,
                       std::span<float> gradients, Workspace* workspace) const override;
  void render(kernels::Backend& backend, const RayBatch& batch, const kernels::CompositeOut& out,
              Workspace* workspace) const override;

  enum Part { kFieldGrid, kNetwork, kProposalGrid, kSkyGrid, kParts };
  kernels::HashGrid grid(Part which) const;  ///< of `parameters`, any but kNetwork
  kernels::GridNetwork network() const { return {field, density_scale(), part(kNetwork)}; }

 private:
  struct Round;
  struct Pass;

  /// Intervals of rays with their points in the unit cube.
  Round place(kernels::Backend& backend, const RayBatch& batch, int per_ray, std::span<const float> edges,
              Workspace* workspace) const;
  /// Harmonics and background.
  void look_at_sky(kernels::Backend& backend, const RayBatch& batch, Pass* pass, Workspace* workspace) const;
  Pass forward(kernels::Backend& backend, const RayBatch& batch, bool jitter, std::uint64_t seed, std::int64_t step,
               const kernels::CompositeOut& out, Workspace* workspace) const;
  void backward_field(kernels::Backend& backend, int n, const Pass& pass, const kernels::CompositeOut& out,
                      const kernels::CompositeAdjoint& adjoint, std::span<float> gradients, Workspace* workspace) const;
  /// Returns the proposals' loss.
  double backward_proposals(kernels::Backend& backend, int n, const Pass& pass, std::span<const float> weights,
                            std::span<float> gradients, Workspace* workspace) const;
  std::size_t part_size(int part) const;
  std::size_t offset(int part) const;  ///< of its first number in `parameters`
  std::span<const float> part(Part part) const { return parameters.span().subspan(offset(part), part_size(part)); }
  std::span<float> part_of(std::span<float> all, Part part) const { return all.subspan(offset(part), part_size(part)); }
  /// At the start one mean free path is e times the near region's half side.
  float density_scale() const { return 0.36787944f / contraction.half_m; }
};

}  // namespace redrive
