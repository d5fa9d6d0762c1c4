// SPDX-License-Identifier: Apache-2.0
// Rays of pixels. An exact direction for every pixel of a camera, computed once; a batch is a
// gather and a rotation.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/image/image.h"
#include "redrive/kernels/gather/gather_pixels.h"
#include "redrive/rays/error_map_layout.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Directions (unit, camera axes) of the pixels that the camera's model reaches.
struct RayTable {
  int width = 0, height = 0;
  std::vector<std::uint32_t> pixel;  ///< y * width + x, ascending
  std::vector<float> direction;      ///< [pixel.size(), 3]
  float pixel_angle =
      0;  ///< side of a pixel as the camera's centre sees it, rad: root of the mean solid angle
};
RayTable make_ray_table(const Camera& camera, int threads = 1);

/// A batch in world metres, structure of arrays [3, n] (kernels::Rays), and the colours to meet,
/// [3, n] in [0, 1], which a ray of opacity o shows as its colour + (1 - o) background. Without one
/// (Background::kNone) background is empty.
struct RayBatch {
  int n = 0;
  int error_map_rays =
      0;  ///< of them the last, which PixelSampler drew by error, the others evenly
  std::uint64_t first_ray = 0;  ///< rays of the same step before these, which other backends have
                                ///< (train/data_parallel_group.h)
  std::vector<float> origin, direction, target, background;
  std::vector<float> pixel_angle;  ///< [n], rad: of the ray's camera
  std::vector<Exposure> exposure;  ///< [n], empty: none
  std::vector<float> weight;       ///< [n]: what a ray's colour counts in the loss; empty: all 1
  std::vector<std::uint32_t>
      cell;  ///< [n]: of the pixel (PixelSampler::cells); empty where none are drawn by error
  std::vector<std::uint32_t>
      group;  ///< [groups + 1]: first rays of neighbours that start alike; empty: none do
  std::vector<std::uint32_t> view;  ///< [n]: of the scene; empty in rendering
  bool refines = false;             ///< a step says what each ray's own place and direction change
  std::vector<float> range_m;  ///< [n]: where a LiDAR's ray ends; empty for those of cameras, as
                               ///< target is for a LiDAR's
};

/// A picture's rays, neighbours together: squares of 2 x 2 pixels, and these in squares of 16 x 16.
struct PixelSquares {
  std::vector<std::uint32_t> entry;  ///< every entry of the table once
  std::vector<std::uint32_t>
      first;  ///< [squares + 1]: where in `entry` each square of 2 x 2 begins; none is empty
};
PixelSquares make_pixel_squares(const RayTable& table);

/// Rays of one view for rendering: ray k is entries[k] of the table.
void view_rays(const RayTable& table, const ShutterPoses& world_from_camera,
               std::span<const std::uint32_t> entries, RayBatch* batch);

/// Which entries of a ray table a mask leaves in use: a bit each and a count every 64.
class UsedPixels {
 public:
  UsedPixels() = default;
  /// used [height, width] as in Image8, not empty.
  UsedPixels(const RayTable& table, const std::vector<std::uint8_t>& used);

  std::size_t size() const { return before_.empty() ? 0 : before_.back(); }
  /// The table's entry that is the k-th in use, k < size().
  std::size_t entry(std::size_t k) const { return used_entry(bits_, before_, k); }
  std::span<const std::uint64_t> bits() const { return bits_; }
  std::span<const std::uint32_t> before() const { return before_; }

 private:
  std::vector<std::uint64_t> bits_;
  std::vector<std::uint32_t> before_;  ///< [bits_.size() + 1]: entries in use before each word
};

/// Rays of a batch beside the even ones, drawn by what the rays of each of PixelSampler::cells
/// lately missed.
struct ErrorMapRays {
  int n = 0;
  std::span<const float>
      errors;  ///< [cells().size()], as update_error_map keeps them; may be empty if n is 0
};

/// The training pixels of a scene: every valid pixel of every view that is not held out and that no
/// mask leaves out, but of those that are transparent altogether, which have little to say, another
/// fourth each epoch; in an order shuffled anew each epoch (base/rng.h permute_index: no table, any
/// position reachable at once, so resuming needs only the count of pixels drawn so far).
class PixelSampler {
 public:
  /// InputError: no pixel is left. Scene and images have to outlive it, and to stay as they are but
  /// for the poses.
  PixelSampler(const Scene& scene, const std::vector<Image8>& images, std::uint64_t seed);
  PixelSampler(const PixelSampler&) = delete;
  PixelSampler& operator=(const PixelSampler&) = delete;

  /// Takes the poses of the scene's views anew: they have been moved.
  void place();

  std::uint64_t pixels() const { return source_.pixels; }  ///< of one epoch
  const ErrorMapLayout& cells() const { return cells_; }   ///< of the training views
  std::int64_t steps_per_epoch(int rays) const;  ///< of so many even rays; the last may have fewer

  /// The `even` pixels from the `first`-th on, counted from 0 through all epochs, fewer at the end
  /// of an epoch; then those by error, transparent ones a fourth as often as others, too. Where a
  /// pixel is drawn more often its rays weigh less (balance_heuristic_weight). A function of the
  /// seed, `first` and the errors.
  void gather(std::uint64_t first, int even, RayBatch* batch, const ErrorMapRays& more = {}) const;

  /// gather() in its parts, for backends that gather themselves: what is drawn, room for it, and
  /// what it is drawn from.
  PixelDraw draw(std::uint64_t first, int even, int error_map_rays) const;
  GatheredRays resize_batch(const PixelDraw& draw, RayBatch* batch) const;
  const PixelSource& source() const { return source_; }

 private:
  void add(int picture, int every, const UsedPixels* used);

  const Scene& scene_;
  std::uint64_t seed_;
  std::vector<RayTable> tables_;  ///< by camera of the rig
  std::vector<UsedPixels> used_;  ///< of the pools that are not whole tables
  ErrorMapLayout cells_;          ///< a picture a training view
  // What source_ speaks of:
  std::vector<RayTableSpans> table_spans_;
  std::vector<TrainingImage> pictures_;
  std::vector<PixelPool> pools_;
  std::vector<std::uint64_t> offsets_;
  std::vector<PlainPose> poses_;
  PixelSource source_;
};

}  // namespace redrive
