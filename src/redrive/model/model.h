// SPDX-License-Identifier: Apache-2.0
// What a method is: how rays become colours, with which parameters, and what a picture's error says
// of them. One file a method (nerf_model.h, grid_model.h); all beyond this header treats them
// alike.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/buffer.h"
#include "redrive/kernels/backend.h"
#include "redrive/model/workspace.h"
#include "redrive/optim/adam.h"
#include "redrive/rays/ray_table.h"

namespace redrive {

/// What the rays of a batch missed.
struct StepOutput {
  int active_rays = 0;  ///< grid: rays that met enough for the field to be asked
  /// grid: [n], squared error of each ray's colour, mean of its channels; where the backend
  /// computes, in the workspace until the next gradients()
  std::span<const float> squares;
  /// [3, n], derivatives of the loss, but for the proposals' part, where RayBatch::refines; empty
  /// otherwise. Distances of samples and what a colour changes with the direction it is seen from
  /// are taken as they are.
  std::vector<float> d_origin, d_direction;
};

/// A tensor in the flat buffer of parameters, as a checkpoint shows it.
struct ModelTensor {
  std::string name;
  std::vector<std::int64_t> shape;
  std::size_t offset = 0;
};

/// Is shown each number that a model is made of, under its name; may read or write it.
class NumberVisitor {
 public:
  virtual ~NumberVisitor() = default;
  virtual void operator()(const std::string& name, int& value) = 0;
  virtual void operator()(const std::string& name, float& value) = 0;
};

class Model {
 public:
  virtual ~Model() = default;

  virtual const char* method() const = 0;    ///< "nerf", "grid"
  virtual std::string describe() const = 0;  ///< for people: sizes and samples
  virtual int samples_per_ray() const = 0;   ///< that a batch keeps in memory
  virtual void visit_numbers(NumberVisitor& visit) = 0;
  /// InputError naming `file` and the number that is out of range; what follows needs numbers in
  /// range.
  virtual void check(const std::filesystem::path& file) const = 0;
  virtual std::size_t size() const = 0;                  ///< of `parameters`
  virtual std::vector<ModelTensor> tensors() const = 0;  ///< all of `parameters`, in order
  virtual void initialize(
      std::uint64_t seed) = 0;  ///< makes and fills `parameters`; deterministic in seed
  /// The part of gradients [size()] that is not finite whenever a finite loss left any of them not
  /// finite.
  virtual std::span<const float> sentinels(std::span<const float> gradients) const {
    return gradients;
  }
  virtual AdamStep adam(double learning_rate, std::int64_t step) const = 0;  ///< step from 1

  /// Returns what the batch's rays missed, leaves losses in workspace->sums() and adds their
  /// derivatives to gradients [size()]. Random numbers are those of (seed, step), from those of
  /// batch.first_ray on.
  virtual StepOutput gradients(kernels::Backend& backend, const RayBatch& batch, std::uint64_t seed,
                               std::int64_t step, std::span<float> gradients,
                               Workspace* workspace) const = 0;
  /// The same of rays that end at batch.range_m: LossTerms::range. Nothing in a method that does
  /// not use LiDAR.
  virtual void range_gradients(kernels::Backend&, const RayBatch&, std::uint64_t, std::int64_t,
                               std::span<float>, Workspace*) const {}
  /// What is optimised, but for the LiDAR's part.
  virtual double loss(const LossTerms& sums) const = 0;
  /// rgb, depth (metres along the ray) and opacity of the batch's rays, without any chance;
  /// out.weights stay as they are.
  virtual void render(kernels::Backend& backend, const RayBatch& batch,
                      const kernels::CompositeOut& out, Workspace* workspace) const = 0;

  Buffer<float> parameters;
};

/// A model of a method by name, its numbers at their defaults, without parameters. Null for an
/// unknown name.
std::unique_ptr<Model> make_model(std::string_view method);

/// The batch's rays as kernels see them.
inline kernels::Rays rays_of(const RayBatch& batch) {
  const std::size_t n = batch.n;
  return {batch.n, std::span(batch.origin).first(3 * n), std::span(batch.direction).first(3 * n)};
}
/// The same where the backend reads them.
inline kernels::Rays upload_rays(const RayBatch& batch, Workspace* workspace) {
  const kernels::Rays rays = rays_of(batch);
  return {rays.n, workspace->put(rays.origin), workspace->put(rays.direction)};
}

}  // namespace redrive
