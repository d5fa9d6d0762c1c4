// SPDX-License-Identifier: Apache-2.0
// Rays of pixels: an exact direction for every pixel of a camera, computed once, so that a batch is
// a gather and a rotation; and the sampler of training pixels.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "redrive/base/parallel.h"
#include "redrive/camera/camera.h"
#include "redrive/image/image.h"
#include "redrive/rays/error_map_layout.h"
#include "redrive/rays/gather_pixels.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Unit directions in camera axes of all pixels in the valid region of the camera model.
struct RayTable {
  int width = 0, height = 0;
  std::vector<std::uint32_t> pixel;  ///< y * width + x, ascending
  std::vector<float> direction;      ///< [pixel.size(), 3]
  float pixel_angle = 0;  ///< angle of a pixel's side, rad: square root of the mean solid angle
  Camera camera;          ///< camera of these pixels
};
RayTable make_ray_table(const Camera& camera, ThreadPool& pool);
/// In the calling thread.
RayTable make_ray_table(const Camera& camera);

/// A batch of rays in world metres, structure of arrays [3, n] (kernels::Rays), and the target
/// colours [3, n] in [0, 1]: a ray of opacity o renders its colour + (1 - o) background. background
/// is empty for Background::kNone.
struct RayBatch {
  int n = 0;
  int error_map_rays =
      0;  ///< the last rays, drawn by the error map; the others are uniform over pixels
  std::uint64_t first_ray =
      0;  ///< rays of the same step on lower ranks (train/distributed/data_parallel.h)
  std::vector<float> origin, direction, target, background;
  std::vector<float> pixel_angle;  ///< [n], rad
  std::vector<Exposure> exposure;  ///< [n]; empty: no gains
  std::vector<float> weight;       ///< [n]: weight of a ray in the colour loss; empty: all 1
  std::vector<std::uint32_t>
      cell;  ///< [n]: the pixel's cell (PixelSampler::cells); empty without an error map
  std::vector<std::uint32_t> group;  ///< [groups + 1]: first rays of groups that share their first
                                     ///< proposal intervals; empty: no groups
  std::vector<std::uint32_t> view;   ///< [n]: index in the scene; empty in rendering
  bool refines = false;  ///< whether a step computes gradients of origins and directions
  std::vector<float>
      range_m;  ///< [n]: measured range of LiDAR rays, which have no target; empty for camera rays
};

/// An image's rays, neighbours together: squares of 2 x 2 pixels, ordered within squares of 16
/// x 16.
struct PixelSquares {
  std::vector<std::uint32_t> entry;  ///< every entry of the table, once
  std::vector<std::uint32_t>
      first;  ///< [squares + 1]: first index in `entry` of each 2 x 2 square; none is empty
};
PixelSquares make_pixel_squares(const RayTable& table);

/// Writes the rays of one view for rendering: ray k is entries[k] of the table.
void view_rays(const RayTable& table, const ShutterPoses& world_from_camera,
               std::span<const std::uint32_t> entries, RayBatch* batch);

/// The entries of a ray table that a mask keeps: one bit each, and a count for every 64.
class UsedPixels {
 public:
  UsedPixels() = default;
  /// used [height, width] as in Image8; not empty.
  UsedPixels(const RayTable& table, const std::vector<std::uint8_t>& used);

  std::size_t size() const { return before_.empty() ? 0 : before_.back(); }
  /// Returns the entry of the k-th pixel in use, k < size().
  std::size_t entry(std::size_t k) const { return used_entry(bits_, before_, k); }
  std::span<const std::uint64_t> bits() const { return bits_; }
  std::span<const std::uint32_t> before() const { return before_; }

 private:
  std::vector<std::uint64_t> bits_;
  std::vector<std::uint32_t> before_;  ///< [bits_.size() + 1]: entries in use before each word
};

/// Returns the number of an image's pixels in an epoch of PixelSampler.
std::uint64_t epoch_pixels(const RayTable& table, const Image8& image);

/// Rays of a batch that are drawn by the error map, besides the uniform ones.
struct ErrorMapRays {
  int n = 0;
  std::span<const float>
      errors;  ///< [cells().size()], kept by update_error_map; may be empty if n is 0
};

/// Sampler of the training pixels of a scene: every valid, unmasked pixel of every view that is not
/// held out, in an order shuffled anew each epoch; of the fully transparent ones, which carry
/// little information, a different fourth each epoch. The order is a permutation computed on the
/// fly (base/rng.h permute_index), so resuming needs only the number of pixels drawn so far.
class PixelSampler {
 public:
  /// Throws InputError if no pixel is left. Scene and images must outlive the sampler and stay
  /// unchanged except for the poses.
  PixelSampler(const Scene& scene, const std::vector<Image8>& images, std::uint64_t seed);
  /// For methods that draw whole images: counts the epoch_pixels of all, and cannot gather.
  PixelSampler(const Scene& scene, std::uint64_t pixels, std::uint64_t seed);
  PixelSampler(const PixelSampler&) = delete;
  PixelSampler& operator=(const PixelSampler&) = delete;

  /// Copies the poses of the scene's views, after they have changed.
  void update_poses();

  std::uint64_t pixels() const { return source_.pixels; }  ///< pixels of one epoch
  const ErrorMapLayout& cells() const { return cells_; }   ///< cells of the training views
  std::int64_t steps_per_epoch(
      int rays) const;  ///< steps of `rays` uniform rays; the last may have fewer

  /// Gathers a batch: the `epoch_rays` pixels from the `first`-th on, counted through all epochs
  /// (fewer at the end of an epoch), then those drawn by the error map. Pixels that both strategies
  /// draw get weights by the balance heuristic. A function of the seed, `first` and the errors.
  void gather(std::uint64_t first, int epoch_rays, RayBatch* batch,
              const ErrorMapRays& more = {}) const;

 private:
  PixelDraw draw(std::uint64_t first, int epoch_rays, int error_map_rays) const;
  GatheredRays resize_batch(const PixelDraw& draw, RayBatch* batch) const;
  void add(int image, int every, const UsedPixels* used);
  void check_any() const;

  const Scene& scene_;
  std::uint64_t seed_;
  std::vector<RayTable> tables_;  ///< one per camera of the rig
  std::vector<UsedPixels> used_;  ///< pixels of the pools that use part of a table
  ErrorMapLayout cells_;          ///< one image per training view
  // Storage of source_'s spans:
  std::vector<RayTableSpans> table_spans_;
  std::vector<TrainingImage> images_;
  std::vector<PixelPool> pools_;
  std::vector<std::uint64_t> offsets_;
  std::vector<PlainPose> poses_;
  PixelSpans source_;
};

}  // namespace redrive
