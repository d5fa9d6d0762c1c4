// SPDX-License-Identifier: Apache-2.0
// Data of a run: images with masks applied, and LiDAR returns.
#pragma once

#include <memory>
#include <optional>

#include "redrive/perception/masks.h"
#include "redrive/rays/ray_table.h"
#include "redrive/scene/image_cache.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/train/run.h"

namespace redrive {

/// Pixels that training and scores exclude.
struct Exclusions {
  std::vector<Mask> masks;  ///< one per camera of the rig
  MovingObjects moving;     ///< those that the model does not draw
};

/// Reads masks/ of an existing run; nothing with --masks none. InputError as read_masks.
Exclusions read_exclusions(const Run& run);

struct TrainingData {
  /// images of scene.views, held-out ones empty; or all are in `cache`
  std::vector<Image8> images;
  Exclusions left_out;                ///< masked pixels of the images
  LidarReturns lidar;                 ///< none if the model uses none
  std::vector<Finding> damaged;       ///< about images that cannot be decoded: no pixel is used
  std::unique_ptr<ImageCache> cache;  ///< decodes images when needed; null: all are in memory
  std::uint64_t pixels = 0;           ///< pixels of an epoch, where there is a cache

  ViewImages view_images() const { return cache ? ViewImages(*cache) : ViewImages(images); }
  PixelSampler sampler(const Scene& scene, std::uint64_t seed) const {
    if (cache) return PixelSampler(scene, pixels, seed);
    return PixelSampler(scene, images, seed);
  }
};

/// Loads the data of an existing run. `cache_bytes`: size of the cache that images are decoded into
/// when needed (image_cache_bytes in train/memory.h); without it all are in memory. All images are
/// read once in either case: InputError where more are damaged than the recording allows.
TrainingData load_training_data(const Run& run, ThreadPool& pool,
                                std::optional<std::uint64_t> cache_bytes = {});
/// Loads the data of a new run and its moving objects (load_actors, with what find_moving found).
/// Masks are detected, or read from the folder that options.masks names; UsageError as mask_folder.
TrainingData prepare_training_data(Run* run, ThreadPool& pool,
                                   std::optional<std::uint64_t> cache_bytes = {});
/// Returns the folder that --masks names; empty for auto and none. UsageError if it has no mask of
/// any camera.
std::filesystem::path mask_folder(const TrainOptions& options, const Scene& scene);
/// Returns the moving objects that nobody annotated: from the mask_folder where it has a
/// moving_file, else searched in the LiDAR of the run's frames that are not held out; none with
/// --masks none.
std::vector<MovingObject> find_moving(const Run& run, ThreadPool& pool);
/// Writes the masks and found objects of prepare_training_data into paths.masks(), for create_run.
void write_run_masks(const RunPaths& paths, const TrainingData& training, const Run& run);

}  // namespace redrive
