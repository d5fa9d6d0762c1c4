// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/memory.h"

#include <algorithm>
#include <cstdio>

#include "redrive/base/error.h"
#include "redrive/base/files/file_container.h"
#include "redrive/base/memory_limit.h"
#include "redrive/kernels/gaussian/gaussian_stages.h"
#include "redrive/perception/masks.h"
#include "redrive/perception/seen_through.h"
#include "redrive/perception/track_points.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/scene/lidar/cloud_returns.h"
#include "redrive/train/step.h"

namespace redrive {
namespace {

// Measured with minimal runs.
constexpr std::uint64_t kProgram = std::uint64_t{56} << 20, kThread = std::uint64_t{4} << 20;
// A lost ray for four returns.
constexpr std::uint64_t kReturn = 4 * sizeof(float) + sizeof(std::int64_t) + sizeof(std::uint16_t) +
                                  sizeof(LidarReturns::LostRay) / 4;
constexpr std::uint64_t kSortedRay = 32;

std::uint64_t pixels(const Camera& camera) { return std::uint64_t(camera.width) * camera.height; }

constexpr const char* kOfImages = "--downscale, --frames or --cameras (images and their rays: ";
constexpr const char* kOfLidar = "--frames or --lidar-rays 0 (LiDAR: ";
constexpr const char* kOfSearch = "--frames or --masks none (search for moving objects: ";

/// Returns byte counts with their descriptions, largest first.
std::string what_to_lower(std::vector<std::pair<std::uint64_t, std::string>> parts) {
  std::ranges::sort(parts, std::greater<>());
  std::string lower;
  for (const auto& [bytes, what] : parts)
    if (bytes > 0) lower += (lower.empty() ? "" : ", ") + what + gib_text(bytes) + ")";
  return lower;
}

/// Images, what decoding them takes, and their rays.
void add_images(const Run& run, int threads, MemoryEstimate* need) {
  const Scene& scene = run.scene;
  const Trainee& model = *run.state.model;
  // Image8 and the lists of unmasked, or of opaque and transparent pixels (UsedPixels): a bit per
  // pixel and a count every 64.
  const bool masked = run.options.masks != "none" && run.recording.metric;
  std::uint64_t largest = 0, largest_trained = 0;  // pixels
  for (const View& view : scene.views) {
    const RigCamera& rig = scene.rig[view.camera];
    largest = std::max(largest, pixels(rig.recorded));
    largest_trained = std::max(largest_trained, pixels(rig.camera));
    if (view.held_out) continue;
    const bool used = masked || !view.mask.path.empty(),
               alpha = scene.background != Background::kNone;
    const std::uint64_t bytes = 3 + alpha + used, lists = alpha ? 2 : used;
    need->images += pixels(rig.camera) * bytes + lists * pixels(rig.camera) * 3 / 16;
  }
  if (model.keeps_half_images(scene)) need->images += need->images / 3;  // and smaller ones
  if (model.streams_images()) {
    // The images that a stage before training needs at once, and one for each thread.
    const auto at_once =
        static_cast<std::uint64_t>(kMostTrackImages + threads + image_decoders(threads));
    need->decoders = static_cast<std::uint64_t>(image_decoders(threads)) * 8 * largest;
    need->least_images =
        std::max(at_once * (scene.background == Background::kNone ? 4 : 5), kMostMaskViews * 3) *
            largest_trained +
        need->decoders;
    if (need->least_images >= need->images) need->least_images = 0;
  }
  // For each thread the recorded image, the undistorted one and the bytes of its file.
  need->decoding = std::uint64_t(threads) * 8 * largest;
  if (scene.undistort)
    for (const RigCamera& rig : scene.rig)
      need->decoding += 2 * sizeof(float) * pixels(rig.recorded);
  for (const RigCamera& rig : scene.rig)
    need->rays += (sizeof(std::uint32_t) + 3 * sizeof(float)) * pixels(rig.camera);
}

/// Returns of the LiDAR's scans, for training and for the search for moving objects.
void add_scans(const Run& run, MemoryEstimate* need) {
  const Scene& scene = run.scene;
  const Trainee& model = *run.state.model;
  // An existing run has the found objects in its masks.
  const bool searches = run.options.masks != "none" && !std::filesystem::exists(run.paths.masks());
  if (!(model.uses_lidar() || searches) || run.recording.lidars.empty()) return;
  std::uint64_t points = 0, files = 0;
  for (const FrameFile& file : run.recording.lidar_files)
    if (file.frame_id >= scene.frames.front().id && file.frame_id <= scene.frames.back().id) {
      points += run.recording.reader->lidar_point_count(file);
      ++files;
    }
  const std::uint64_t lidar =
      points * kReturn * 2 / 3;  // a third of the points are in two overlapping revolutions
  const std::uint64_t sorting = points * (sizeof(LidarPoint) + kSortedRay * 2 / 3);
  if (model.uses_lidar()) {
    need->lidar = lidar;
    need->of_lidar = model.lidar_bytes(scene, points * 2 / 3);
    need->sorting = sorting;
  }
  if (searches && points > 0) need->search = lidar + std::max(sorting, search_bytes(points, files));
}

/// Points of a drive without scans, where training takes them as returns.
void add_cloud(const Run& run, MemoryEstimate* need) {
  const Trainee& model = *run.state.model;
  if (!model.uses_lidar() || !run.recording.lidar_files.empty() ||
      run.recording.points_file.empty())
    return;
  constexpr std::uint64_t kCloudPoint =
      64;  // a point in world coordinates and the nearest of its cell
  std::error_code error;
  const std::uint64_t size = std::filesystem::file_size(run.recording.points_file, error),
                      bytes = error ? 0 : size,
                      points = bytes / (3 * sizeof(float)),  // at most
      used = std::min<std::uint64_t>(points, kMaxCloudPoints);
  need->lidar = used * kReturn;
  need->of_lidar = model.lidar_bytes(run.scene, used);
  need->sorting = bytes + points * sizeof(Eigen::Vector3d) + used * kCloudPoint;
}

}  // namespace

MemoryEstimate estimate_memory(const Run& run, int threads, bool data_parallel) {
  const Trainee& model = *run.state.model;
  // The numbers that a step updates itself may become more; their moments are packed, and their
  // gradients exist in data-parallel training only.
  const std::uint64_t others = model.size() - model.updated_in_step(),
                      in_step = model.max_size() - others, per_error = model.numbers_per_error(),
                      errors = per_error > 0 ? in_step / per_error : 0,
                      mean = model.average_every(1) > 0 ? in_step + others : 0,
                      state = sizeof(float) * (2 * in_step + errors + 3 * others + mean);
  MemoryEstimate need;
  need.program = kProgram + std::uint64_t(threads) * kThread;
  need.state = need.saving = state;

  add_images(run, threads, &need);
  add_scans(run, &need);
  add_cloud(run, &need);
  need.step =
      sizeof(float) * (others + (data_parallel ? in_step + errors : 0)) + model.step_bytes();
  need.step_option = "--batch (" + model.describe_batch() + ": ";
  return need;
}

int image_decoders(int threads) { return std::max(1, threads / 2); }

std::optional<std::uint64_t> image_cache_bytes(const MemoryEstimate& need, std::uint64_t allowed) {
  if (need.total() <= allowed || need.least_images == 0) return std::nullopt;
  const std::uint64_t others = need.total_with(0);
  REDRIVE_CHECK_OP(others, <=, allowed);
  return std::max((allowed - others) / 21 * 20, need.least_images) - need.decoders;
}

std::string gib_text(std::uint64_t bytes) {
  constexpr double kGiB = 1024.0 * 1024 * 1024;
  const double gib = static_cast<double>(bytes) / kGiB;
  char text[32];
  std::snprintf(text, sizeof text, gib < 0.995 ? "%.2f GiB" : "%.1f GiB", gib);
  return text;
}

std::string memory_text(std::uint64_t needed, std::uint64_t allowed) {
  return "needs about " + gib_text(needed) + " of " + gib_text(allowed) + " allowed";
}

std::string describe_memory(const MemoryEstimate& need, std::uint64_t allowed) {
  const std::optional<std::uint64_t> cache = image_cache_bytes(need, allowed);
  return memory_text(need.total(), allowed) +
         (cache ? ": images are decoded when needed, " + gib_text(*cache) + " of " +
                      gib_text(need.images) + " at a time"
                : "");
}

void check_memory(const MemoryEstimate& need, std::uint64_t allowed, const TrainOptions& options) {
  if (need.least() <= allowed) return;
  const std::uint64_t images = need.least_images > 0 ? need.least_images : need.images;
  throw UsageError(
      "--memory", options.memory,
      memory_text(need.least(), allowed) + "; lower " +
          what_to_lower({{images + need.rays, kOfImages},
                         {need.lidar + std::max(need.sorting, need.of_lidar), kOfLidar},
                         {need.search, kOfSearch},
                         {need.step, need.step_option}}));
}

void check_device_memory(std::uint64_t need, std::uint64_t allowed, const TrainOptions& options) {
  if (need > allowed)
    throw UsageError("--gpu-memory", options.gpu_memory,
                     "training " + memory_text(need, allowed) +
                         "; lower --max-gaussians, or --backend cpu needs none");
}

RunMemory reserve_memory(const Run& run, kernels::Backend& backend, bool data_parallel,
                         std::uint64_t machine_shares, std::uint64_t device_shares) {
  RunMemory memory;
  memory.need = estimate_memory(run, backend.threads(), data_parallel);
  memory.allowed = allowed_memory(run.options, memory_bytes()) / machine_shares;
  check_memory(memory.need, memory.allowed, run.options);
  memory.cache_bytes = image_cache_bytes(memory.need, memory.allowed);
  memory.of_device = run.state.model->device_bytes(backend);
  if (memory.of_device == 0) return memory;
  memory.allowed_of_device =
      allowed_device_memory(run.options, backend.device_memory()) / device_shares;
  check_device_memory(memory.of_device, memory.allowed_of_device, run.options);
  const std::uint64_t images = memory.need.images + memory.need.images / 16;  // gaps between them
  memory.images_of_device = std::min(memory.allowed_of_device - memory.of_device, images);
  backend.gaussians().keep_targets(memory.images_of_device);
  return memory;
}

void check_rendering_memory(const Run& run, const Camera* camera) {
  // An estimate of a pixel: its ray, its colour, depth and opacity twice, its bytes and the file.
  constexpr std::uint64_t kPixel = 100;
  const std::uint64_t file = file_bytes(run.paths.checkpoint()).value_or(0),
                      need = kProgram + 2 * file + (camera ? kPixel * pixels(*camera) : 0),
                      allowed = allowed_memory(run.options, memory_bytes());
  if (need > allowed)
    throw UsageError(
        "--memory", run.options.memory,
        "is that of " + run.paths.config().string() + "; rendering " + memory_text(need, allowed));
}

}  // namespace redrive
