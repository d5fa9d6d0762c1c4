// SPDX-License-Identifier: Apache-2.0
// Rays of pixels. An exact direction for every pixel of a camera, computed once; a batch is a gather and a rotation.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "redrive/camera/camera.h"
#include "redrive/scene/image_set.h"
#include "redrive/scene/scene.h"

namespace redrive {

/// Directions (unit, camera axes) of the pixels that the camera's model reaches.
struct RayTable {
  int width = 0, height = 0;
  std::vector<std::uint32_t> pixel;  ///< y * width + x, ascending
  std::vector<float> direction;      ///< [pixel.size(), 3]
  float pixel_angle = 0;  ///< side of a pixel as the camera's centre sees it, rad: root of the mean solid angle
};
RayTable make_ray_table(const Camera& camera);

/// A batch in world metres, structure of arrays [3, n] (kernels::Rays), and the colours to meet, [3, n] in [0, 1], which a ray
/// of opacity o shows as its colour + (1 - o) background. Without one (Background::kNone) background is empty.
struct RayBatch {
  int n = 0;
  std::vector<float> origin, direction, target, background;
  std::vector<float> pixel_angle;  ///< [n], rad: of the ray's camera
  std::vector<Exposure> exposure;  ///< [n], empty: none
  std::vector<float>
      range_m;  ///< [n]: where a LiDAR's ray ends; empty for those of cameras, as target is for a LiDAR's
};

/// All rays of one view (rows [first_row, last_row)) for rendering: ray k belongs to pixel table.pixel[first + k].
void view_rays(const RayTable& table, const Rigid3d& world_from_camera, std::size_t first, std::size_t count,
               RayBatch* batch);

/// Which entries of a ray table a mask leaves in use: a bit each and a count every 64.
class UsedPixels {
 public:
  UsedPixels() = default;
  /// used [height, width] as in Image8, not empty.
  UsedPixels(const RayTable& table, const std::vector<std::uint8_t>& used);

  std::size_t size() const { return before_.empty() ? 0 : before_.back(); }
  std::size_t entry(std::size_t k) const;  ///< the table's entry that is the k-th in use, k < size()

 private:
  std::vector<std::uint64_t> bits_;
  std::vector<std::uint32_t> before_;  ///< [bits_.size() + 1]: entries in use before each word
};

/// The training pixels of a scene: every valid pixel of every view that is not held out and that no mask leaves out, but of those
/// that are transparent altogether, which have little to say, another fourth each epoch; in an order shuffled anew each epoch (base/rng.h permute_index: no table, any position reachable at once, so resuming needs only the step).
class PixelSampler {
 public:
  /// InputError: no pixel is left.
  PixelSampler(const Scene& scene, const std::vector<Image8>& images, std::uint64_t seed);

  std::uint64_t pixels() const { return offsets_.back(); }  ///< of one epoch
  std::int64_t steps_per_epoch(int batch_rays) const;       ///< the last batch of an epoch may be smaller

  /// Batch `step` (from 0, counted through all epochs): batch->n = batch_rays, fewer at the end of an epoch.
  void gather(std::int64_t step, int batch_rays, RayBatch* batch) const;

 private:
  const Scene& scene_;
  const std::vector<Image8>& images_;
  std::uint64_t seed_;
  std::vector<RayTable> tables_;  ///< by camera of the rig
  /// Pixels of a training view: all of its table, or those in `used`; of those one in `every` an epoch.
  struct Pool {
    int view = 0;
    Rigid3d world_from_camera;
    std::optional<UsedPixels> used;
    int every = 1;
  };
  void add(Pool pool, std::size_t size);

  std::vector<Pool> pools_;
  std::vector<std::uint64_t> offsets_;  ///< [pools_.size() + 1]: first pixel of each
};

}  // namespace redrive
