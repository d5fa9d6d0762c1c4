// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/splat_model.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/base/rng.h"
#include "redrive/camera/plain_camera.h"
#include "redrive/kernels/gaussian/pixel_gains.h"
#include "redrive/methods/splat/actors/actor_gaussians.h"
#include "redrive/methods/splat/actors/articulated.h"
#include "redrive/methods/splat/gaussian_points.h"
#include "redrive/methods/splat/image_windows.h"
#include "redrive/methods/splat/lidar/scan_step.h"
#include "redrive/methods/splat/lidar/trace_gaussians.h"
#include "redrive/methods/splat/range_pixels.h"
#include "redrive/methods/splat/surface_planes.h"
#include "redrive/recording/core/actor_kind.h"

namespace redrive {
namespace {

constexpr float kGainsFrom = 0.05f;     // progress
constexpr float kMotionsFrom = 0.05f;   // progress
constexpr double kShareOfActors = 0.5;  // maximum share of all Gaussians at the start

/// Working memory of a run's steps.
struct SplatBuffers final : MethodBuffers {
  std::optional<SurfacePlanes> surfaces;  ///< found by prepare()
  // Made by the first step:
  std::optional<ExposureTimes> exposures;
  std::vector<ImageLevel> levels;
  /// Smaller images by level and view, made when first needed; if all are in memory.
  std::vector<std::vector<ImagePointer>> reduced;
  std::optional<ReturnTimes> times;                            ///< made when first needed
  std::vector<std::optional<std::vector<ShownReturn>>> shown;  ///< one per view, likewise
  /// The steps that the images' plan covers.
  struct Plan {
    std::uint64_t seed = 0;
    int level = -1;
    int rank = 0, world_size = 0;
    std::int64_t first = 0, end = 0;
  } plan;
  /// Not 0: the images of targets_level (TargetWindow::set).
  std::uint64_t targets = 0;
  int targets_level = -1;
  std::vector<float> log_range;       ///< kNoRange but at `ranged`
  std::vector<std::uint32_t> ranged;  ///< pixels
  std::vector<std::uint8_t> tiles;
  ScanBuffers scan;
};

SplatBuffers& splat_buffers(StepBuffers* buffers) {
  if (!buffers->method) buffers->method = std::make_unique<SplatBuffers>();
  return static_cast<SplatBuffers&>(*buffers->method);
}

SplatBuffers& step_buffers(const TrainingSet& data, int window_pixels, StepBuffers* buffers) {
  SplatBuffers& own = splat_buffers(buffers);
  if (!own.exposures) {
    own.exposures.emplace(data.scene);
    own.levels = image_levels(data, window_pixels);
    own.reduced.assign(kImageLevels, std::vector<ImagePointer>(data.images.size()));
    own.shown.resize(data.images.size());
  }
  return own;
}

std::uint64_t draw_of(const StepRequest& request, std::int64_t step) {
  return static_cast<std::uint64_t>(request.world_size * step + request.rank);
}

/// Announces the images that the next steps draw, where not all are in memory. The order is known
/// for as long as the level stays.
void plan_images(const TrainingSet& data, const StepRequest& request, int level,
                 SplatBuffers* own) {
  constexpr std::size_t kMostPlanned = 1 << 16;
  if (data.images.all_in_memory()) return;
  const SplatBuffers::Plan& last = own->plan;
  if (last.seed == request.seed && last.level == level && last.rank == request.rank &&
      last.world_size == request.world_size && request.step >= last.first &&
      request.step < (last.first + last.end) / 2)
    return;
  const std::vector<ImageWindow>& windows = own->levels[level].windows;
  // Two epochs, so that each image's next use is known.
  const auto n = static_cast<std::int64_t>(std::min(2 * windows.size(), kMostPlanned));
  own->plan = {request.seed,       level,        request.rank,
               request.world_size, request.step, request.step + n};
  std::vector<ImageKey> coming;
  for (std::int64_t step = request.step; step < request.step + n; ++step)
    coming.push_back(
        {windows[drawn_window(request.seed, draw_of(request, step), windows.size())].view,
         level > 0});
  data.images.plan(std::move(coming));
}

/// Returns a view's image at the size of a level.
ImagePointer image_of(const TrainingSet& data, int view, int level, SplatBuffers* own) {
  if (level == 0) return data.images[view];
  ImagePointer& kept = own->reduced[level][view];
  if (kept) return kept;
  ImagePointer image = data.images.half(view);
  for (int k = 1; k < level; ++k) image = std::make_shared<const Image8>(halved(*image));
  if (data.images.all_in_memory()) kept = image;
  return image;
}

/// Finds the LiDAR returns of the views that windows show, unless they are known, in parallel.
void find_returns(const TrainingSet& data, std::span<const ImageWindow* const> windows,
                  ThreadPool& pool, SplatBuffers* own) {
  std::vector<int> views;
  for (const ImageWindow* window : windows)
    if (!own->shown[window->view] && std::ranges::find(views, window->view) == views.end())
      views.push_back(window->view);
  if (views.empty()) return;
  if (!own->times) own->times.emplace(data.lidar);
  pool.run(static_cast<int>(views.size()),
           [&](int i) { own->shown[views[i]] = find_shown_returns(data, *own->times, views[i]); });
}

kernels::GaussianCamera camera_of(const PlainCamera& whole, const ImageWindow& window,
                                  const ShutterPoses& poses,
                                  std::span<const kernels::GaussianPart> parts) {
  const bool by_column = poses.by_column();
  return {.camera = window_of(whole, window.x, window.y, window.width, window.height),
          .world_from_camera = poses.keys(),
          .first_row = static_cast<float>(by_column ? window.x : window.y),
          .image_rows = static_cast<float>(by_column ? whole.width : whole.height),
          .parts = parts,
          .by_column = by_column};
}

/// Writes row y of an image; pixels that are not in the table are outside the valid region.
/// gains: [3, width].
void write_image_row(const kernels::RasterImage& from, std::span<const float> gains,
                     const RayTable& rays, std::size_t y, RenderedImage* image) {
  const auto width = static_cast<std::size_t>(rays.width);
  const std::size_t first = y * width, plane = from.size.plane(), row = y * from.size.stride;
  const auto begin = std::ranges::lower_bound(rays.pixel, first),
             end = std::lower_bound(begin, rays.pixel.end(), first + width);
  if (end - begin < rays.width) {
    std::fill_n(&image->rgb[3 * first], 3 * width, 0.0f);
    std::fill_n(&image->depth[first], width, 0.0f);
    std::fill_n(&image->opacity[first], width, 0.0f);
    std::fill_n(&image->valid[first], width, std::uint8_t{0});
  }
  for (auto pixel = begin; pixel != end; ++pixel) {
    const std::size_t x = *pixel - first;
    for (std::size_t c = 0; c < 3; ++c)
      image->rgb[3 * *pixel + c] =
          std::clamp(gains[c * width + x] * from.rgb[c * plane + row + x], 0.0f, 1.0f);
    image->depth[*pixel] = from.depth[row + x];
    image->opacity[*pixel] = 1 - from.transmittance[row + x];
    image->valid[*pixel] = 1;
  }
}

}  // namespace

void SplatModel::initialize(std::uint64_t) {
  gaussians = first_gaussians = unseen_gaussians = filled = 0;
  actor_ids.clear();
  actor_ends.clear();
  actor_keys.clear();
  parameters = Buffer<float>(size());
  renew_version();
}

void SplatModel::initialize_from(const TrainingSet& data, std::uint64_t seed, ThreadPool& pool) {
  if (data.scene.background == Background::kNone) set_background(data);
  InitialGaussianOptions options = initial;
  unseen_gaussians = 0;
  options.max_gaussians = most_gaussians();
  options.max_unseen = scan_every > 0 ? max_gaussians : 0;
  std::vector<GaussianList> lists(1);
  std::size_t of_actors = 0;
  for (const MovingObject& actor : data.scene.actors) {
    lists.push_back(actor_gaussians(data, actor, options.voxel,
                                    kind_of(actor.type).headlights ? ahead_m() : kShadow_m,
                                    random_key(seed, kStreamActors), pool));
    of_actors += lists.back().size();
  }
  const auto most_of_actors = static_cast<std::size_t>(kShareOfActors * most_gaussians());
  if (of_actors > most_of_actors)
    for (std::size_t i = 1; i < lists.size(); ++i)
      shuffle(lists[i].size() * most_of_actors / of_actors, random_key(seed, kStreamActors, i),
              &lists[i]);
  options.max_gaussians -= static_cast<int>(std::min(of_actors, most_of_actors));
  std::size_t unseen = 0;
  lists[0] = initial_gaussians(data, options, seed, pool, &unseen);
  unseen_gaussians = static_cast<int>(unseen);
  set_gaussians(std::move(lists), data.scene.actors);
}

void SplatModel::set_background(const TrainingSet& data) {
  constexpr std::size_t kEvery = 101;  // pixels
  double sum[3] = {0, 0, 0}, n = 0;
  std::vector<ImageKey> views;
  for (int v = 0; v < std::ssize(data.scene.views); ++v)
    if (!data.scene.views[v].held_out) views.push_back({v, false});
  data.images.plan(views);
  for (const ImageKey& key : views) {
    const ImagePointer image = data.images[key.view];
    for (std::size_t i = 0; 3 * i < image->rgb.size(); i += kEvery) {
      if (!image->used.empty() && image->used[i] == 0) continue;
      for (int c = 0; c < 3; ++c) sum[c] += image->rgb[3 * i + c] / 255.0;
      ++n;
    }
  }
  for (int c = 0; c < 3; ++c) background[c] = static_cast<float>(sum[c] / std::max(n, 1.0));
}

void SplatModel::set_gaussians(std::vector<GaussianList> lists,
                               std::span<const MovingObject> actors) {
  REDRIVE_CHECK_OP(lists.size(), ==, 1 + actors.size());
  first_gaussians = 0;
  for (const GaussianList& list : lists) first_gaussians += static_cast<int>(list.size());
  std::vector<GaussianList> parts;
  parts.push_back(std::move(lists[0]));
  std::vector<Eigen::Vector3d> sizes_m;
  actor_ids.clear();
  actor_keys.clear();
  for (std::size_t i = 0; i < actors.size(); ++i) {
    const MovingObject& actor = actors[i];
    std::vector<GaussianList> own =
        is_articulated(actor) ? divided(lists[1 + i], actor.size_m) : std::vector{lists[1 + i]};
    for (GaussianList& part : own) {
      parts.push_back(std::move(part));
      sizes_m.push_back(actor.size_m);
      actor_ids.push_back(actor.id);
      actor_keys.push_back((actor_keys.empty() ? 0 : actor_keys.back()) + std::ssize(actor.keys));
    }
  }
  const GaussianLayout layout = layout_of(parts);
  gaussians = static_cast<int>(layout.world);
  actor_ends = layout.actor_ends;
  parameters = Buffer<float>(size());
  write_blocks(parts, layout, &parameters);
  float* bound = parameters.data() + (blocks_size() + gains.size());
  for (const Eigen::Vector3d& size_m : sizes_m)
    for (int k = 0; k < 3; ++k) *bound++ = static_cast<float>(size_m[k] / 2) + kBeyondBox_m;
  renew_version();
}

std::int64_t SplatModel::steps_per_epoch(const TrainingSet& data, int world_size) const {
  ImageLevel full;
  for (const RigCamera& rig : data.scene.rig) full.cameras.push_back(rig.camera);
  cut_into_windows(data, window_pixels, &full);
  return (static_cast<std::int64_t>(full.windows.size()) + world_size - 1) / world_size;
}

/// One window of a step.
struct SplatModel::WindowStep {
  int factor;                ///< factor by which the image is smaller than the view's
  const PlainCamera& whole;  ///< camera of the window's image
  const Image8& image;
  const ImageWindow& window;
  float colour[3];  ///< colour of the background
};

void SplatModel::prepare(const TrainingSet& data, ThreadPool& pool, StepBuffers* buffers) const {
  if (!uses_lidar() || surface_rate == 0 || data.lidar.n == 0 || !data.scene.metric) return;
  const Progress progress("fitting planes to the LiDAR");
  splat_buffers(buffers).surfaces.emplace(data.scene, data.lidar, pool);
}

const SurfacePlanes* SplatModel::surfaces_of(const StepBuffers& buffers) {
  if (!buffers.method) return nullptr;
  const auto& own = static_cast<const SplatBuffers&>(*buffers.method);
  return own.surfaces ? &*own.surfaces : nullptr;
}

StepOutput SplatModel::step(kernels::Backend& backend, const TrainingSet& data,
                            const StepRequest& request, std::span<float> gradients,
                            StepBuffers* buffers) const {
  SplatBuffers& own = step_buffers(data, window_pixels, buffers);
  // Batches outside training use all views at once, at half size.
  const bool all = request.pixels > 0;
  REDRIVE_CHECK(!all || !request.update);
  const int at_level = all ? 1 : level_at(own.levels, request.progress, double(coarse_progress));
  const ImageLevel& level = own.levels[at_level];
  const std::uint64_t drawn = draw_of(request, request.step), n = level.windows.size();
  const std::size_t first = all ? 0 : drawn_window(request.seed, drawn, n),
                    end = all ? n : first + 1;
  if (!all) plan_images(data, request, at_level, &own);
  if (!all && own.targets_level != at_level) {
    own.targets_level = at_level;
    own.targets = new_version();
  }
  if (range_weight > 0 && data.lidar.n > 0) {
    constexpr int kAhead = 16;  // steps
    std::vector<const ImageWindow*> coming;
    for (std::size_t w = first; w < end; ++w) coming.push_back(&level.windows[w]);
    const bool known = own.shown[coming.front()->view].has_value();
    for (int k = 1; !all && !known && k < kAhead; ++k)
      coming.push_back(
          &level.windows[drawn_window(request.seed, draw_of(request, request.step + k), n)]);
    find_returns(data, coming, backend.pool(), &own);
  }

  buffers->workspace.begin();
  StepSums& sums = buffers->workspace.sums();
  sums = {};
  StepOutput out;
  out.stage = at_level;
  if (request.pose_gradients) out.views.resize(data.scene.views.size());
  for (std::size_t w = first; w < end; ++w) {
    const ImageWindow& window = level.windows[w];
    const View& view = data.scene.views[window.view];
    const ImagePointer image = image_of(data, window.view, at_level, &own);
    const PlainCamera whole = make_plain_camera(level.cameras[view.camera]);
    WindowStep step{
        1 << at_level, whole, *image, window, {background[0], background[1], background[2]}};
    const std::uint64_t colour = random_key(request.seed, kStreamBackground, drawn);
    for (int c = 0; data.scene.random_background && c < 3; ++c)
      step.colour[c] = random_unit(colour, static_cast<std::uint64_t>(c));
    step_window(backend, data, request, step, gradients, &own, 1.0 / double(end - first), &sums,
                &out);
  }
  if (has_scan(data, request)) {
    const auto draw =
        static_cast<std::uint64_t>(request.world_size * (request.step / scan_every) + request.rank);
    step_scan(backend, data, request, random_key(request.seed, kStreamScans), draw, gradients,
              &own.scan, &sums);
  }
  return out;
}

int SplatModel::set_ranges(const TrainingSet& data, const WindowStep& step, ThreadPool& pool,
                           MethodBuffers* buffers) const {
  if (range_weight == 0 || data.lidar.n == 0) return 0;
  SplatBuffers& own = static_cast<SplatBuffers&>(*buffers);
  const kernels::RasterSize size = kernels::raster_size(step.window.width, step.window.height);
  for (const std::uint32_t i : own.ranged) own.log_range[i] = kernels::kNoRange;
  own.ranged.clear();
  own.log_range.resize(size.plane(), kernels::kNoRange);
  const View& view = data.scene.views[step.window.view];
  for (const RangePixel& p : range_pixels(data.scene, view, *own.shown[step.window.view], pool)) {
    const int x = p.x / step.factor - step.window.x, y = p.y / step.factor - step.window.y;
    if (x < 0 || y < 0 || x >= step.window.width || y >= step.window.height) continue;
    // Tiles with only masked pixels are not drawn.
    const Image8& image = step.image;
    if (!image.used.empty() &&
        !image.used[static_cast<std::size_t>(step.window.y + y) * image.width + step.window.x + x])
      continue;
    const std::size_t i = static_cast<std::size_t>(y) * size.stride + static_cast<std::size_t>(x);
    if (own.log_range[i] != kernels::kNoRange) continue;  // a pixel takes one return
    own.log_range[i] = p.log_range;
    own.ranged.push_back(static_cast<std::uint32_t>(i));
  }
  return static_cast<int>(own.ranged.size());
}

void SplatModel::step_window(kernels::Backend& backend, const TrainingSet& data,
                             const StepRequest& request, const WindowStep& step,
                             std::span<float> gradients, MethodBuffers* buffers, double weight,
                             StepSums* sums, StepOutput* out) const {
  SplatBuffers& own = static_cast<SplatBuffers&>(*buffers);
  kernels::GaussianStages& stages = backend.gaussians();
  const ImageWindow& window = step.window;
  const View& view = data.scene.views[window.view];
  const Image8& image = step.image;
  const ShutterPoses poses = shutter_poses(data.scene, view);
  const DrawnGaussians actors = this->drawn(poses.actors());  // as trained
  const kernels::GaussianCamera camera = camera_of(step.whole, window, poses, actors.parts);
  find_tiles(image, window, backend.pool(), &own.tiles);
  kernels::RasterOptions options;
  options.tiles = own.tiles;
  std::ranges::copy(step.colour, options.background);
  const int returns = set_ranges(data, step, backend.pool(), &own);
  if (returns > 0) {
    options.log_range = own.log_range;
    options.ranged = own.ranged;
  }
  kernels::Raster raster = stages.rasterise(camera, all(), options);

  const kernels::RasterSize size = kernels::raster_size(window.width, window.height);
  kernels::ImageLossInput input;
  input.target = {.width = image.width,
                  .x = window.x,
                  .y = window.y,
                  .rgb = image.rgb,
                  .alpha = image.alpha,
                  .used = image.used,
                  .set = request.pixels > 0 ? 0 : own.targets,
                  .index = window.view};
  const std::array<float, 3> of_scene = background_colour(data.scene.background);
  for (int c = 0; !image.alpha.empty() && c < 3; ++c)
    input.target.background_change[c] = step.colour[c] - of_scene[c];
  input.l1_weight = l1_weight;
  input.ssim_weight = ssim_weight;
  const Exposure exposure = data.scene.exposure(view);
  const ImagePart part{window.x, window.y, step.whole.width, step.whole.height};
  input.gains = gains.of(gain_parameters(), exposure);
  kernels::PixelWeights weights;
  if (data.scene.background == Background::kNone) weights.transmittance = opacity_weight;
  if (returns > 0) weights.range = range_weight / static_cast<float>(returns);

  std::vector<GaussianPoseGradient<NumberMath<double>>> d_poses(
      request.pose_gradients || (motion_rate > 0 && !poses.actors().empty())
          ? 1 + actors.parts.size()
          : 0);
  kernels::GaussianDerivatives to;
  kernels::GaussianUpdate update;
  if (request.update) {
    update = gaussian_update(*request.update, SeenBy::kCamera);
    to.update = &update;
  } else {
    to.gradients = gradients.first(blocks_size());
    to.errors = gradients.last(errors());
  }
  const kernels::ImageLossOutput loss = raster.backward(input, weights, to, d_poses);
  const std::span<float> others = others_of(gradients);
  if (request.progress > double(kGainsFrom))
    gains.add_changes(gain_parameters(), exposure, own.exposures->gaps(exposure), size, part,
                      loss.patches,
                      static_cast<float>(std::pow(last_rate, std::min(request.progress, 1.0))),
                      others.first(gains.size()));
  if (motion_rate > 0 && request.progress > double(kMotionsFrom))
    out->left_out_tracks +=
        add_motion_gradients(data.scene, data.scene.exposed_ns(view), actors, d_poses, others);

  sums->opacity += weight * (1 - loss.transmittance);
  sums->rgb_mse += weight * loss.mse;
  sums->terms[kL1Loss] += weight * loss.l1;
  sums->terms[kSsimLoss] += weight * loss.dssim;
  sums->terms[kRangeLoss] += weight * loss.range;
  sums->terms[kOpacityLoss] += weight * double(weights.transmittance) * loss.transmittance;
  out->pixels += static_cast<int>(loss.pixels);
  out->epoch_pixels = out->pixels;
  out->colour_variance += weight * loss.colour_variance;
  if (!request.pose_gradients) return;
  for (int k = 0; k < 3; ++k) {
    out->views[window.view].d_translation[k] += d_poses[0].translation[k];
    out->views[window.view].d_rotation[k] += d_poses[0].rotation[k];
  }
}

void SplatModel::render_to(kernels::Backend& backend, const RayTable& rays,
                           const ShutterPoses& world_from_camera, const Exposure& exposure,
                           RenderedImage* image) const {
  const PlainCamera camera = make_plain_camera(rays.camera);
  kernels::RasterOptions options;
  options.depth = true;
  options.parts = image->labelled;
  std::ranges::copy(background, options.background);
  const DrawnGaussians shown = drawn(world_from_camera.actors());
  const kernels::Raster raster = backend.gaussians().rasterise(
      camera_of(camera, {0, 0, 0, rays.width, rays.height}, world_from_camera, shown.parts),
      shown.gaussians, options);
  const kernels::RasterImage& from = raster.image();
  image->resize(rays.width, rays.height);
  constexpr std::size_t kRowsPerRange = 16;
  backend.pool().run_ranges(rays.height, kRowsPerRange, [&](std::size_t begin, std::size_t end) {
    std::vector<float> row_gains(3 * static_cast<std::size_t>(rays.width));
    const kernels::PixelGains of_image = gains.of(gain_parameters(), exposure);
    for (std::size_t y = begin; y < end; ++y) {
      for (int c = 0; c < 3; ++c)
        kernels::write_gains(of_image, {0, 0, rays.width, rays.height}, static_cast<int>(y), c,
                             std::span(row_gains).subspan(c * std::size_t(rays.width), rays.width));
      write_image_row(from, row_gains, rays, y, image);
      for (int x = 0; image->labelled && x < rays.width; ++x) {
        const std::uint16_t object = from.parts[y * from.size.stride + x];
        image->ids[y * rays.width + x] =
            object == 0 ? 0 : static_cast<std::uint16_t>(shown.numbers[object - 1]);
      }
    }
  });
  if (image->labelled) image->seen = seen_actors_of(from, shown);
}

RenderedRays SplatModel::trace(kernels::Backend& backend, const kernels::Rays& rays,
                               const std::vector<MovingObject>& actors) const {
  REDRIVE_CHECK(actors.empty() || !rays.t_ns.empty());
  return trace_gaussians(backend.gaussians(), backend.pool(), rays, [&](const RayRaster& raster) {
    return drawn(seen_actors(actors, raster.key_poses(), raster.key_times()));
  });
}

}  // namespace redrive
