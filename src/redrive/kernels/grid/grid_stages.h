// SPDX-License-Identifier: Apache-2.0
// The stages that only --method grid needs (Backend::grid): hash grids, proposal sampling, sky,
// exposure and their losses. Conventions as in backend.h. A ray is tiled by intervals with edges
// [n_rays, per_ray + 1], ascending, in metres from the origin; a sample is an interval's midpoint.
#pragma once

#include <cstdint>
#include <span>

#include "redrive/field/appearance.h"
#include "redrive/field/contraction.h"
#include "redrive/field/exposure.h"
#include "redrive/field/grid_field.h"
#include "redrive/kernels/rays.h"
#include "redrive/volume/ray_intervals.h"

namespace redrive::kernels {

/// Intervals of each ray of a batch.
struct Intervals {
  int per_ray = 0;
  std::span<const float> edges;  ///< [n_rays, per_ray + 1]
};

/// A hash grid with its feature table (field/hash_grid.h).
struct HashGrid {
  HashGridConfig config;
  std::span<const float> table;
};

/// Points in the unit cube: position [3, n]; footprint [n], the standard deviation of a sample's
/// volume, in units of the cube.
struct UnitPoints {
  std::size_t n = 0;
  std::span<const float> position, footprint;
  /// Distance between coordinates, if these are the first n of more points; 0: n.
  std::size_t stride = 0;

  float coordinate(int k, std::size_t i) const {
    return position[k * (stride > 0 ? stride : n) + i];
  }
  UnitPoints first(std::size_t count) const {
    return {count, position, footprint.first(count), stride > 0 ? stride : n};
  }
};

/// Density and colour network of a grid field (field/grid_field.h).
struct GridNetwork {
  GridFieldConfig config;
  float density_scale = 1;  ///< 1/m
  std::span<const float> weights;
};

/// Uniform sampling of a ray's first intervals (volume/ray_intervals.h, clip_to_scene and
/// uniform_edges).
struct UniformSampling {
  int per_ray = 0;
  RaySpacing spacing;
  Contraction contraction;
  bool jitter = true;
  std::uint64_t key = 0;
};

/// PDF sampling of further intervals (volume/ray_intervals.h, pdf_edges).
struct PdfSampling {
  int per_ray = 0;
  float padding = 0.01f;
  bool jitter = true;
  std::uint64_t key = 0;
};

/// Rays of at least min_opacity are active. Each other ray is active if random_unit(key, ray) <
/// keep_probability.
struct RayCompaction {
  float min_opacity = 0, keep_probability = 0;
  std::uint64_t key = 0;
};

/// Layout of an array with several numbers per ray: kRows [rays, numbers], kColumns [numbers,
/// rays].
enum class RayLayout { kRows, kColumns };

/// Gains of the cameras over time (field/appearance.h); without parameters there are none.
struct Appearance {
  AppearanceConfig config;
  std::span<const float> parameters;
};

/// Colours with exposure applied and recorded colours: rgb, gains, target [3, n].
struct ColourLossInput {
  Appearance appearance;
  std::span<const Exposure> exposure;  ///< [n]; empty: no gains were applied
  std::span<const float> rgb, gains;   ///< as apply_exposure left them
  std::span<const float> target;
  std::span<const float> weight;  ///< [n], of the rays in the loss; empty: all 1
  float huber_delta = 0;          ///< optim/photometric_loss.h
};

class GridStages {
 public:
  virtual ~GridStages() = default;

  // ---- ray compaction
  /// Finds the active rays by their weights [n_rays, per_ray]. Writes them ascending to the first
  /// of `active` [n_rays] and returns how many. Rays with NaN weights are active. Writes ray 0 if
  /// none is active, since stages take at least one.
  virtual int compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                           const RayCompaction& how, std::span<std::uint32_t> active) = 0;
  /// Copies the numbers of `rays` from an array of all rays, in the order of `rays`. A ray may be
  /// listed several times.
  virtual void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                           std::span<const float> from, std::span<float> to) = 0;
  /// Copies the numbers of `rays`, each listed once, into an array of all rays. The other rays get
  /// the numbers of `otherwise`, or 0 if that is empty.
  virtual void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                            std::span<const float> from, std::span<const float> otherwise,
                            std::span<float> to) = 0;

  // ---- volume/
  virtual void sample_uniform(const Rays& rays, const UniformSampling& how,
                              std::span<float> edges) = 0;
  /// Draws new intervals from the intervals of `from` and their weights [n_rays, from.per_ray].
  virtual void sample_pdf(int n_rays, const Intervals& from, std::span<const float> weights,
                          const PdfSampling& how, std::span<float> edges) = 0;

  /// Writes the midpoints and lengths of intervals: t, dt [n_rays, per_ray].
  virtual void midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                         std::span<float> dt) = 0;

  // ---- field/
  /// Maps the midpoints of all intervals into the unit cube. pixel_angle [n_rays]: side of a pixel
  /// in rad. A sample's volume is a box, pixel_angle t squared times the interval's length (as in
  /// NeuRAD); footprint = max(cbrt(volume), least_width * length) * the contraction's factor. The
  /// lower bound is for samples that stand for all of a long interval.
  virtual void contract(const Contraction& contraction, const Rays& rays,
                        std::span<const float> pixel_angle, const Intervals& intervals,
                        float least_width, std::span<float> position,
                        std::span<float> footprint) = 0;
  /// Writes d_origin and d_direction [3, n_rays] from d_position [3, n]; distances and footprints
  /// count as constants.
  virtual void contract_backward(const Contraction& contraction, const Rays& rays,
                                 const Intervals& intervals, std::span<const float> d_position,
                                 std::span<float> d_origin, std::span<float> d_direction) = 0;
  /// features [levels, n, features per level]: one level after the other, so that one table at a
  /// time is in the caches.
  virtual void encode(const HashGrid& grid, const UnitPoints& points,
                      std::span<float> features) = 0;
  /// Adds to d_table; writes d_position [3, n] unless it is empty.
  virtual void encode_backward(const HashGrid& grid, const UnitPoints& points,
                               std::span<const float> d_features, std::span<float> d_table,
                               std::span<float> d_position) = 0;
  /// raw [4, n] (grid_network_forward in field/grid_field.h) from features as encode writes them
  /// and harmonics [n_rays, 16], with n = n_rays * per_ray.
  virtual void network_forward(const GridNetwork& network, int n_rays, int per_ray,
                               std::span<const float> features, std::span<const float> harmonics,
                               std::span<float> raw) = 0;
  /// Adds to d_weights, writes d_features (as features). Recomputes the forward pass.
  virtual void network_backward(const GridNetwork& network, int n_rays, int per_ray,
                                std::span<const float> features, std::span<const float> harmonics,
                                std::span<const float> d_raw, std::span<float> d_weights,
                                std::span<float> d_features) = 0;
  /// Density [n] of a proposal field: density_scale exp(sum over the levels), with one feature per
  /// level.
  virtual void proposal_density(const HashGrid& grid, float density_scale, const UnitPoints& points,
                                std::span<float> density) = 0;
  /// Adds to d_table. density: as proposal_density wrote it.
  virtual void proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                         std::span<const float> density,
                                         std::span<const float> d_density,
                                         std::span<float> d_table) = 0;

  /// Spherical harmonics [n, 16] of the rays' directions (field/spherical_harmonics.h).
  virtual void harmonics(const Rays& rays, std::span<float> harmonics) = 0;
  /// Sky colours [3, n] of the rays' directions (field/sky.h) in a grid of at least three features
  /// per level; pixel_angle as in contract.
  virtual void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                   std::span<float> colour) = 0;
  /// Adds to d_table and, unless it is empty, to d_direction [3, n]. The sky's colour is the colour
  /// that `sky` wrote; opacity [n] and d_rgb [3, n] belong to the composed colours.
  virtual void sky_backward(const HashGrid& grid, const Rays& rays,
                            std::span<const float> pixel_angle, std::span<const float> colour,
                            std::span<const float> opacity, std::span<const float> d_rgb,
                            std::span<float> d_table, std::span<float> d_direction) = 0;
  /// Multiplies rgb [3, n] by the gains of exposure [n] and writes these to gains [3, n].
  virtual void apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                              std::span<float> gains, std::span<float> rgb) = 0;

  // ---- volume/
  /// Weights [n_rays, per_ray] from densities (volume/ray_weights.h).
  virtual void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
                       std::span<float> weights) = 0;
  virtual void weights_backward(int n_rays, const Intervals& intervals,
                                std::span<const float> density, std::span<const float> weights,
                                std::span<const float> d_weights, std::span<float> d_density) = 0;

  /// Median depth [n_rays] (volume/median_distance.h) from weights [n_rays, per_ray] and their
  /// sums.
  virtual void median_depth(int n_rays, const Intervals& intervals, std::span<const float> weights,
                            std::span<const float> opacity, std::span<float> depth) = 0;

  // ---- optim/
  /// Turns d_rgb of the squared error (Backend::photometric_loss) into d_rgb of the Huber loss,
  /// weighted by ray, with respect to the colours before exposure. Adds the derivatives with
  /// respect to the gains' parameters to d_appearance, including their regulariser's
  /// (gain_regulariser). loss: the Huber loss, a mean over rays and channels, plus the regulariser;
  /// squares [n]: squared error of each ray, mean over its channels.
  virtual void huber_loss(const ColourLossInput& colours, std::span<float> d_rgb,
                          std::span<float> squares, std::span<float> d_appearance,
                          double* loss) = 0;
  /// Proposal loss (optim/proposal_loss.h), mean over rays; writes d_proposal [n_rays,
  /// proposal.per_ray].
  virtual void proposal_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                             const Intervals& proposal, std::span<const float> proposal_weights,
                             double opacity_weight, std::span<float> d_proposal, double* loss) = 0;
  /// `factor` times the mean over rays of the range loss (optim/range_loss.h) for LiDAR returns at
  /// range_m [n_rays]; writes d_weights [n_rays, per_ray].
  virtual void range_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                          std::span<const float> range_m, float spread_m, float factor,
                          std::span<float> d_weights, double* loss) = 0;
  /// `factor` times the mean over rays of the sparsity loss (optim/sparsity_loss.h); adds to
  /// d_density [n_rays, per_ray].
  virtual void sparsity_loss(int n_rays, const Intervals& intervals, std::span<const float> density,
                             float factor, std::span<float> d_density, double* loss) = 0;
};

}  // namespace redrive::kernels
