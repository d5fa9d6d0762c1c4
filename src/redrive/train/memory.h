// SPDX-License-Identifier: Apache-2.0
// Estimates of the memory of training, before any image is loaded.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <string>

#include "redrive/train/run.h"

namespace redrive {

/// Bytes, from the sizes of what is allocated.
struct MemoryEstimate {
  std::uint64_t program = 0;  ///< code, libraries, threads
  std::uint64_t state = 0;    ///< parameters and moments
  std::uint64_t images = 0;   ///< bytes of all training views, with masks
  /// Bytes of the smallest cache, with what decodes into it; 0: all images are needed.
  std::uint64_t least_images = 0;
  std::uint64_t decoders = 0;  ///< part of least_images that the decoding threads take
  std::uint64_t lidar = 0;     ///< bytes of all returns
  std::uint64_t search = 0;  ///< bytes of the search for moving objects, before any image is loaded
  // The peak is in loading or in training, or in the search:
  std::uint64_t decoding = 0;  ///< images as recorded
  /// bytes of LiDAR points as recorded and of their rays, before they become returns
  std::uint64_t sorting = 0;
  std::uint64_t of_lidar = 0;  ///< bytes that the model derives from the returns
  std::uint64_t rays = 0;      ///< directions of all pixels of all cameras
  std::uint64_t step = 0;      ///< gradients and a batch's working memory
  std::string step_option;     ///< option that lowers it: "--batch (2048 rays: "
  std::uint64_t saving = 0;    ///< a checkpoint that a run goes back to

  std::uint64_t total() const { return total_with(images); }  ///< at the peak
  /// Total with a cache of the smallest size, where images may be in one.
  std::uint64_t least() const { return total_with(least_images > 0 ? least_images : images); }
  std::uint64_t total_with(std::uint64_t of_images) const {
    const std::uint64_t sum =
        program + state +
        std::max(search, of_images + std::max({decoding, lidar + sorting,
                                               lidar + of_lidar + rays + step + saving}));
    return sum + sum / 20;  // small buffers, and gaps between blocks
  }
};
MemoryEstimate estimate_memory(const Run& run, int threads, bool data_parallel = false);

/// Returns the size of the image cache (ImageCacheOptions) that --memory leaves where not all
/// images fit; nothing where they do. `need` must have passed check_memory.
std::optional<std::uint64_t> image_cache_bytes(const MemoryEstimate& need, std::uint64_t allowed);
/// Number of threads that decode images, in addition to the training threads.
int image_decoders(int threads);

/// "1.3 GiB", from bytes.
std::string gib_text(std::uint64_t bytes);
/// "needs about 1.3 GiB of 16.8 GiB allowed", from bytes.
std::string memory_text(std::uint64_t needed, std::uint64_t allowed);
/// As memory_text with all images; where they do not fit, says how many are in memory at a time.
/// `need` must have passed check_memory.
std::string describe_memory(const MemoryEstimate& need, std::uint64_t allowed);
/// Throws UsageError naming the options to lower if more is needed than allowed.
void check_memory(const MemoryEstimate& need, std::uint64_t allowed, const TrainOptions& options);

/// Throws UsageError naming --gpu-memory if more of a device's memory is needed than allowed.
void check_device_memory(std::uint64_t need, std::uint64_t allowed, const TrainOptions& options);

/// Memory of a training on the machine and on its device, within their limits.
struct RunMemory {
  MemoryEstimate need;
  std::uint64_t allowed = 0;
  /// Bytes of the backend's device for the model, and for the images that it keeps; 0 without one.
  std::uint64_t of_device = 0, images_of_device = 0, allowed_of_device = 0;
  std::optional<std::uint64_t> cache_bytes;  ///< image_cache_bytes
};
/// Estimates a training's memory, checks it, and lets the device keep images as far as there is
/// room. machine_shares and device_shares: numbers of processes that share the machine and the
/// device. Throws as check_memory and check_device_memory.
RunMemory reserve_memory(const Run& run, kernels::Backend& backend, bool data_parallel = false,
                         std::uint64_t machine_shares = 1, std::uint64_t device_shares = 1);

/// Throws UsageError if the run's --memory allows less than its model takes plus, unless `camera`
/// is null, an image of the camera.
void check_rendering_memory(const Run& run, const Camera* camera = nullptr);

}  // namespace redrive
