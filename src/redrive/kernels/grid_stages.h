// SPDX-License-Identifier: Apache-2.0
// The seam's second half: the stages of --method grid (Backend::grid). As kernels.h: spans and
// sizes, sizes are checked, non-finite results are the caller's to look for. A ray is tiled by
// intervals, edges [n_rays, per_ray + 1] ascending, metres; a sample is an interval's middle.
#pragma once

#include <cstdint>
#include <span>

#include "redrive/base/host_device.h"
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

/// A hash grid with its numbers (field/hash_grid.h).
struct HashGrid {
  HashGridConfig config;
  std::span<const float> table;
};

/// Points of the unit cube: position [3, n]; footprint [n], standard deviation of a sample's volume
/// there.
struct UnitPoints {
  std::size_t n = 0;
  std::span<const float> position, footprint;
  std::size_t stride =
      0;  ///< from coordinate to coordinate, where these are the first n of more points; 0: n

  REDRIVE_HD float coordinate(int k, std::size_t i) const {
    return position[k * (stride > 0 ? stride : n) + i];
  }
  UnitPoints first(std::size_t count) const {
    return {count, position, footprint.first(count), stride > 0 ? stride : n};
  }
};

/// Both networks of a grid field (field/grid_field.h).
struct GridNetwork {
  GridFieldConfig config;
  float density_scale = 1;  ///< 1/m
  std::span<const float> weights;
};

/// How the first intervals of rays are laid: volume/ray_intervals.h clip_to_scene,
/// volume/ray_intervals.h uniform_edges.
struct UniformSampling {
  int per_ray = 0;
  RaySpacing spacing;
  Contraction contraction;
  bool jitter = true;
  std::uint64_t key = 0;
};

/// How further intervals are drawn: volume/ray_intervals.h pdf_edges.
struct PdfSampling {
  int per_ray = 0;
  float padding = 0.01f;
  bool jitter = true;
  std::uint64_t key = 0;
};

/// Which rays the field is asked about: those that weigh at least so much, and of the others a
/// share, by random_unit(key, ray).
struct RayCompaction {
  float min_opacity = 0, keep_probability = 0;
  std::uint64_t key = 0;
};

/// How the numbers that each ray has lie: [rays, numbers] or [numbers, rays].
enum class RayLayout { kRows, kColumns };

/// Gains of cameras over time (field/appearance.h); without parameters there are none.
struct Appearance {
  AppearanceConfig config;
  std::span<const float> parameters;
};

/// Colours as the cameras show them against what they recorded: rgb, gains, target [3, n].
struct ColourLossInput {
  Appearance appearance;
  std::span<const Exposure> exposure;  ///< [n]; empty: as the field shows them, without gains
  std::span<const float> rgb, gains;   ///< as `expose` left them
  std::span<const float> target;
  std::span<const float> weight;  ///< [n], what rays count; empty: all 1
  float huber_delta = 0;          ///< optim/photometric_loss.h
};

class GridStages {
 public:
  virtual ~GridStages() = default;

  // ---- rays
  /// Rays by how, or whose weights [n_rays, per_ray] are no numbers, ascending in the first of
  /// `live` [n_rays]; returns how many. Ray 0 where there is none: stages are for at least one.
  virtual int compact_rays(int n_rays, int per_ray, std::span<const float> weights,
                           const RayCompaction& how, std::span<std::uint32_t> live) = 0;
  /// What each of `rays` has in `from`, in their order. Rays may be there several times.
  virtual void gather_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                           std::span<const float> from, std::span<float> to) = 0;
  /// The other way, each ray once: what all others have in `to` is that of `elsewhere`, or 0 where
  /// that is empty.
  virtual void scatter_rays(std::span<const std::uint32_t> rays, RayLayout layout,
                            std::span<const float> from, std::span<const float> elsewhere,
                            std::span<float> to) = 0;

  // ---- volume/
  virtual void sample_uniform(const Rays& rays, const UniformSampling& how,
                              std::span<float> edges) = 0;
  /// New intervals from those of `from` and their weights [n_rays, from.per_ray].
  virtual void sample_pdf(int n_rays, const Intervals& from, std::span<const float> weights,
                          const PdfSampling& how, std::span<float> edges) = 0;

  /// Where samples are and how long their intervals: t, dt [n_rays, per_ray].
  virtual void midpoints(int n_rays, const Intervals& intervals, std::span<float> t,
                         std::span<float> dt) = 0;

  // ---- field/
  /// Middles of all intervals in the unit cube. pixel_angle [n_rays]: side of a pixel, rad. A
  /// sample's volume is a box of pixel_angle t squared times its length (NeuRAD), or a cube of
  /// least_width of its length where that is more, for those whose middle has to stand for all of a
  /// long interval; footprint = cbrt(volume) * contract's factor.
  virtual void contract(const Contraction& contraction, const Rays& rays,
                        std::span<const float> pixel_angle, const Intervals& intervals,
                        float least_width, std::span<float> position,
                        std::span<float> footprint) = 0;
  /// contract's adjoint, distances and footprints taken as they are: d_position [3, n] -> d_origin
  /// and d_direction [3, n_rays], written.
  virtual void contract_backward(const Contraction& contraction, const Rays& rays,
                                 const Intervals& intervals, std::span<const float> d_position,
                                 std::span<float> d_origin, std::span<float> d_direction) = 0;
  /// features [levels, n, features]: level by level, because each level's table is walked through
  /// at once.
  virtual void encode(const HashGrid& grid, const UnitPoints& points,
                      std::span<float> features) = 0;
  /// Adds to d_table; writes d_position [3, n] unless it is empty.
  virtual void encode_backward(const HashGrid& grid, const UnitPoints& points,
                               std::span<const float> d_features, std::span<float> d_table,
                               std::span<float> d_position) = 0;
  /// features as from encode, harmonics [n_rays, 16], n = n_rays * per_ray -> raw [4, n] as the
  /// scalar function says.
  virtual void network_forward(const GridNetwork& network, int n_rays, int per_ray,
                               std::span<const float> features, std::span<const float> harmonics,
                               std::span<float> raw) = 0;
  /// Adds to d_weights, writes d_features (as features). Recomputes the forward pass.
  virtual void network_backward(const GridNetwork& network, int n_rays, int per_ray,
                                std::span<const float> features, std::span<const float> harmonics,
                                std::span<const float> d_raw, std::span<float> d_weights,
                                std::span<float> d_features) = 0;
  /// A proposal field: density_scale exp(sum of the levels), grid.config.features = 1. density [n].
  virtual void proposal_density(const HashGrid& grid, float density_scale, const UnitPoints& points,
                                std::span<float> density) = 0;
  /// Adds to d_table, from density as proposal_density gave it.
  virtual void proposal_density_backward(const HashGrid& grid, const UnitPoints& points,
                                         std::span<const float> density,
                                         std::span<const float> d_density,
                                         std::span<float> d_table) = 0;

  /// field/spherical_harmonics.h of the rays' directions: harmonics [n, 16].
  virtual void harmonics(const Rays& rays, std::span<float> harmonics) = 0;
  /// field/sky.h: colours [3, n] of the rays' directions in a grid of which three features and more
  /// are a level's. pixel_angle as above.
  virtual void sky(const HashGrid& grid, const Rays& rays, std::span<const float> pixel_angle,
                   std::span<float> colour) = 0;
  /// From what the colours as `sky` gave them are worth behind rays of opacity [n] and d_rgb [3,
  /// n]: adds to d_table and, unless that is empty, to d_direction [3, n].
  virtual void sky_backward(const HashGrid& grid, const Rays& rays,
                            std::span<const float> pixel_angle, std::span<const float> colour,
                            std::span<const float> opacity, std::span<const float> d_rgb,
                            std::span<float> d_table, std::span<float> d_direction) = 0;
  /// rgb [3, n] times the gains of exposure [n], which are left in gains [3, n].
  virtual void apply_exposure(const Appearance& appearance, std::span<const Exposure> exposure,
                              std::span<float> gains, std::span<float> rgb) = 0;

  // ---- volume/
  /// volume/ray_weights.h: density, weights [n_rays, per_ray].
  virtual void weights(int n_rays, const Intervals& intervals, std::span<const float> density,
                       std::span<float> weights) = 0;
  virtual void weights_backward(int n_rays, const Intervals& intervals,
                                std::span<const float> density, std::span<const float> weights,
                                std::span<const float> d_weights, std::span<float> d_density) = 0;

  /// volume/median_distance.h: depth [n_rays], from weights [n_rays, per_ray] and their sums.
  virtual void median_depth(int n_rays, const Intervals& intervals, std::span<const float> weights,
                            std::span<const float> opacity, std::span<float> depth) = 0;

  // ---- optim/
  /// Makes of the squared error's d_rgb (Backend::photometric_loss) that of Huber's loss, weighted
  /// by ray, and takes it back through the exposure, whose derivatives, with those of the loss on
  /// gains (gain_regulariser), are added to d_appearance. loss: of both, the colours' as a mean
  /// over rays and channels; squares [n]: each ray's squared error, mean of its channels.
  virtual void huber_loss(const ColourLossInput& colours, std::span<float> d_rgb,
                          std::span<float> squares, std::span<float> d_appearance,
                          double* loss) = 0;
  /// optim/proposal_loss.h proposal_loss, mean over rays; writes d_proposal [n_rays,
  /// proposal.per_ray].
  virtual void proposal_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                             const Intervals& proposal, std::span<const float> proposal_weights,
                             std::span<float> d_proposal, double* loss) = 0;
  /// optim/range_loss.h range_loss of returns at range_m [n_rays], `factor` times its mean over
  /// rays; writes d_weights [n_rays, per_ray].
  virtual void range_loss(int n_rays, const Intervals& intervals, std::span<const float> weights,
                          std::span<const float> range_m, float spread_m, float factor,
                          std::span<float> d_weights, double* loss) = 0;
  /// optim/sparsity_loss.h sparsity_loss, `factor` times its mean over rays; adds to d_density
  /// [n_rays, per_ray].
  virtual void sparsity_loss(int n_rays, const Intervals& intervals, std::span<const float> density,
                             float factor, std::span<float> d_density, double* loss) = 0;
};

}  // namespace redrive::kernels
