// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/training_data.h"

#include <algorithm>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/perception/find_moving.h"
#include "redrive/perception/moving_file.h"
#include "redrive/scene/lidar/lidar_gains.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

/// `masks` and the moving objects that the model does not draw; nothing with --masks none.
Exclusions with_moving(const Run& run, const std::function<std::vector<Mask>()>& masks) {
  if (run.options.masks != "none") return {masks(), run.moving.without(run.scene.actors)};
  std::vector<Mask> full;
  for (const RigCamera& rig : run.scene.rig)
    full.push_back(full_mask(rig.camera.width, rig.camera.height));
  return {full, {}};
}

LidarReturns training_returns(const Run& run, const MovingObjects& moving, ThreadPool& pool) {
  LidarSelection selection;
  selection.lost = true;
  selection.frame = [held_out = held_out_frames(run.scene)](std::int64_t frame) {
    return !held_out.contains(frame);
  };
  return load_lidar_returns(run.recording, run.scene, moving, pool, selection);
}

/// Bytes of a training view's image at most.
std::uint64_t largest_image(const Scene& scene) {
  std::uint64_t largest = 0;
  for (const RigCamera& rig : scene.rig)
    largest = std::max(largest, (scene.background == Background::kNone ? 4 : 5) *
                                    std::uint64_t(rig.camera.width) * rig.camera.height);
  return largest;
}

/// The images that a cache decodes: a copy of what the run's scene was when training began.
struct StreamedImages {
  Scene scene;
  DamagedViews damaged;
  ViewLoader load;
  ViewMasker masker;

  StreamedImages(const Run& run, const Exclusions& left_out, ThreadPool& pool)
      : scene(run.scene),
        load(scene, pool, &damaged),
        masker(scene, left_out.masks, left_out.moving, MovingObjects(scene.actors), pool) {}
  Image8 image(int view) const {
    const View& of = scene.views[static_cast<std::size_t>(view)];
    Image8 image = load(of);
    masker.apply(of, &image);
    return image;
  }
};

/// Makes the cache of a run's images and reads each of them once: for errors, and to count pixels.
void stream_images(const Run& run, std::uint64_t bytes, ThreadPool& pool, TrainingData* data) {
  const auto images = std::make_shared<StreamedImages>(run, data->left_out, pool);
  const Scene& scene = images->scene;
  ImageCacheOptions options;
  options.bytes = bytes;
  options.image_bytes = largest_image(scene);
  options.decoders = image_decoders(pool.threads());
  data->cache = std::make_unique<ImageCache>(
      static_cast<int>(scene.views.size()), [images](int view) { return images->image(view); },
      options);
  std::vector<std::uint64_t> pixels(scene.views.size());
  std::vector<RayTable> tables;
  for (const RigCamera& rig : scene.rig) tables.push_back(make_ray_table(rig.camera, pool));
  Progress progress("reading images", std::ssize(pixels));
  pool.run(static_cast<int>(pixels.size()), [&](int v) {
    const View& view = scene.views[static_cast<std::size_t>(v)];
    if (view.held_out)
      images->load(view);
    else
      pixels[v] = epoch_pixels(tables[view.camera], *data->cache->get({v, false}));
    progress.count();
  });
  for (const std::uint64_t of_view : pixels) data->pixels += of_view;
  data->damaged = images->damaged.judge(run.recording, scene);
  images->damaged.close();  // a file that breaks while it trains would go unsaid
}

/// Objects that nobody annotated, and the returns in which they were searched: static ones and
/// theirs.
struct Search {
  std::vector<MovingObject> found;
  std::optional<LidarReturns> returns;  ///< nothing where a file has the objects
};

Search search_moving(const Run& run, ThreadPool& pool) {
  if (run.options.masks == "none") return {};
  const std::filesystem::path folder = mask_folder(run.options, run.scene);
  if (!folder.empty() && std::filesystem::exists(moving_file(folder)))
    return {as_in_moving_file(read_moving_file(moving_file(folder))), {}};
  if (run.recording.lidar_files.empty()) return {};
  const MovingObjects annotated = read_moving_objects(run.recording, run.scene);
  LidarReturns returns = training_returns(run, annotated, pool);
  // What trains now is what resume reads.
  auto found = as_in_moving_file(find_moving_objects(run.scene, returns, annotated, pool));
  return {std::move(found), std::move(returns)};
}

/// Applies `left_out` to the images, or to a cache's images where `cache_bytes` is given.
/// `returns`: returns of the search, if there was one.
TrainingData applied(const Run& run, ThreadPool& pool, Exclusions left_out,
                     std::vector<Image8> images, std::optional<std::uint64_t> cache_bytes,
                     std::optional<LidarReturns> returns = std::nullopt) {
  TrainingData data{{}, std::move(left_out), {}, {}, {}, 0};
  if (cache_bytes) {
    stream_images(run, *cache_bytes, pool, &data);
  } else {
    data.images = std::move(images);
    apply_masks(run.scene, data.left_out.masks, data.left_out.moving, pool, &data.images);
    if (!run.scene.actors.empty())
      mark_objects(run.scene, MovingObjects(run.scene.actors), pool, &data.images);
  }
  if (!run.state.model->uses_lidar()) return data;
  const MovingObjects& moving = run.scene.actors.empty() ? data.left_out.moving : run.moving;
  const std::vector<MovingObject> found = found_objects(moving);
  data.lidar = returns ? *std::move(returns) : training_returns(run, moving.without(found), pool);
  take_out(run.scene, MovingObjects(found), &data.lidar);
  if (!data.lidar.scan_ends.empty() && run.state.step == 0 && run.state.lidar_gains.empty()) {
    std::vector<LidarGains> gains = estimate_gains(run.scene, data.lidar, pool);
    for (std::size_t k = 0; k < gains.size(); ++k) {
      data.lidar.sensors[k].gain = gains[k].gain;
      data.lidar.sensors[k].beam_gains = std::move(gains[k].beams);
      data.lidar.sensors[k].blind = std::move(gains[k].blind);
    }
  }
  return data;
}

}  // namespace

std::vector<MovingObject> find_moving(const Run& run, ThreadPool& pool) {
  return search_moving(run, pool).found;
}

std::filesystem::path mask_folder(const TrainOptions& options, const Scene& scene) {
  const std::string& given = options.masks;
  if (given == "auto" || given == "none") return {};
  if (!std::filesystem::is_directory(given))
    throw UsageError("--masks", given, "must be auto, none or a folder");
  if (!std::filesystem::exists(moving_file(given)) &&
      std::ranges::none_of(scene.rig, [&](const RigCamera& rig) {
        return std::filesystem::exists(mask_file(given, rig));
      }))
    throw UsageError(
        "--masks", given,
        "holds neither moving.json nor a mask of a camera that is trained on, such as " +
            mask_file("", scene.rig[0]).string());
  return given;
}

Exclusions read_exclusions(const Run& run) {
  return with_moving(run, [&] { return read_masks(run.paths.masks(), run.scene); });
}

TrainingData load_training_data(const Run& run, ThreadPool& pool,
                                std::optional<std::uint64_t> cache_bytes) {
  DamagedViews damaged;
  std::vector<Image8> images;
  if (!cache_bytes) images = load_views(run.scene, pool, &damaged);
  TrainingData data = applied(run, pool, read_exclusions(run), std::move(images), cache_bytes);
  if (!cache_bytes) data.damaged = damaged.judge(run.recording, run.scene);
  return data;
}

TrainingData prepare_training_data(Run* to_train, ThreadPool& pool,
                                   std::optional<std::uint64_t> cache_bytes) {
  const std::filesystem::path folder = mask_folder(to_train->options, to_train->scene);
  Search search = search_moving(*to_train, pool);
  load_actors(to_train, search.found);
  const Run& run = *to_train;
  DamagedViews damaged;
  std::vector<Image8> images;
  if (!cache_bytes) images = load_views(run.scene, pool, &damaged);
  const std::vector<Finding> findings = damaged.judge(run.recording, run.scene);
  Exclusions left_out = with_moving(run, [&] {
    const bool on_car = run.recording.metric;
    return cache_bytes ? static_masks(run.scene, ViewLoader(run.scene, pool, &damaged), folder,
                                      pool, on_car)
                       : static_masks(run.scene, images, folder, pool, on_car);
  });
  TrainingData data = applied(run, pool, std::move(left_out), std::move(images), cache_bytes,
                              std::move(search.returns));
  if (!cache_bytes) data.damaged = findings;
  return data;
}

void write_run_masks(const RunPaths& paths, const TrainingData& training, const Run& run) {
  std::error_code error;
  std::filesystem::create_directory(paths.masks(), error);
  if (error) throw IoError(paths.masks(), error.message());
  write_masks(paths.masks(), training.left_out.masks, run.scene);
  const std::vector<MovingObject> found = found_objects(run.moving);
  if (!found.empty()) write_moving_file(moving_file(paths.masks()), found);
}

}  // namespace redrive
