// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/other_cameras.h"

#include <algorithm>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/parallel.h"
#include "redrive/base/progress.h"
#include "redrive/eval/for_each_loaded.h"
#include "redrive/eval/moving_scores.h"
#include "redrive/eval/score_mean.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

/// The run's scene with the camera in place of the nearest one, and only its views.
struct OtherScene {
  Scene scene;
  int camera = 0;  ///< in the scene's rig
};

/// Returns the index of the run's camera nearest to a position in the body.
int nearest_camera(const Scene& scene, const Eigen::Vector3d& in_body) {
  const auto distance = [&](const RigCamera& camera) {
    return (camera.body_from_sensor.translation() - in_body).norm();
  };
  return static_cast<int>(std::ranges::min_element(scene.rig, {}, distance) - scene.rig.begin());
}

OtherScene scene_of(const Run& run, const std::string& name, const EvalOptions& options) {
  if (run.scene.camera_index(name) >= 0)
    throw UsageError("--cameras", name, "was trained on; eval without the option scores it");
  SceneOptions own = scene_options(run.options);
  own.cameras = {name};
  own.holdout_every = own.train_every = 0;
  own.shown_only = false;  // keeps the run's frames
  own.frame_step = 1;
  const Scene made = make_scene(run.recording, own);
  OtherScene other{run.scene,
                   nearest_camera(run.scene, made.rig[0].body_from_sensor.translation())};
  Scene& scene = other.scene;
  RigCamera& camera = scene.rig[static_cast<std::size_t>(other.camera)];
  const CameraCalibration& recorded = run.recording.find_camera(camera.name)->calibration;
  const Rigid3d correction =
      camera.body_from_sensor * recorded.body_from_sensor.inverse(Eigen::Isometry);
  const std::int64_t later_ns = camera.time_offset_ns - recorded.time_offset_ns;
  camera = made.rig[0];
  camera.body_from_sensor = correction * camera.body_from_sensor;
  camera.time_offset_ns += later_ns;
  const std::size_t limit = options.all              ? 0
                            : options.max_images > 0 ? options.max_images
                                                     : kTrainingImagesPerCamera;
  scene.views.clear();
  std::vector<View> views;
  for (View view : made.views) {
    view.frame = scene.frame_index(made.frames[std::size_t(view.frame)].id);
    if (view.frame >= 0) views.push_back(std::move(view));
  }
  if (views.empty())
    throw UsageError("--cameras", name, "has no image of a frame that the run has");
  for (const std::size_t v : evenly_spaced(views.size(), limit)) {
    View view = views[v];
    view.camera = other.camera;
    view.held_out = false;
    scene.views.push_back(std::move(view));
  }
  return other;
}

/// Finds masks of the camera as for the run's cameras; the other cameras of the rig have no view.
Exclusions exclusions_of(const Run& run, const OtherScene& other, ThreadPool& pool) {
  std::vector<Mask> masks;
  for (const RigCamera& rig : other.scene.rig)
    masks.push_back(full_mask(rig.camera.width, rig.camera.height));
  if (run.options.masks == "none") return {masks, {}};
  Scene alone = other.scene;
  alone.rig = {other.scene.rig[static_cast<std::size_t>(other.camera)]};
  for (View& view : alone.views) view.camera = 0;
  const std::vector<Image8> images = load_views(alone, pool);
  masks[static_cast<std::size_t>(other.camera)] =
      static_masks(alone, images, run.options.masks == "auto" ? "" : run.options.masks, pool,
                   run.recording.metric)[0];
  Exclusions left_out = read_exclusions(run);
  left_out.masks = std::move(masks);
  return left_out;
}

struct Comparison {
  const View& view;
  RenderedImage rendered;
  Image8 recorded, ground_truth;  ///< which is masked
};

/// Minimises the sum over pixels of (gain rendered - ground truth)^2 for each channel.
std::array<double, 3> least_squares_gains(const std::vector<Comparison>& images) {
  std::array<double, 3> products{}, squares{}, gains{1, 1, 1};
  for (const Comparison& image : images)
    for (std::size_t i = 0; i < image.rendered.valid.size(); ++i) {
      if (!image.rendered.valid[i] ||
          (!image.ground_truth.used.empty() && !image.ground_truth.used[i]))
        continue;
      for (std::size_t c = 0; c < 3; ++c) {
        const double rendered = image.rendered.rgb[3 * i + c];
        products[c] += rendered * image.ground_truth.rgb[3 * i + c] / 255;
        squares[c] += rendered * rendered;
      }
    }
  for (std::size_t c = 0; c < 3; ++c)
    if (squares[c] > 0) gains[c] = products[c] / squares[c];
  return gains;
}

}  // namespace

std::map<std::string, OtherCameraScore> score_other_cameras(const Run& run,
                                                            kernels::Backend& backend,
                                                            const std::vector<std::string>& names,
                                                            const EvalOptions& options) {
  std::vector<OtherScene> scenes;  // wrong names are reported at once
  std::size_t total = 0;
  for (const std::string& name : names) {
    scenes.push_back(scene_of(run, name, options));
    total += scenes.back().scene.views.size();
  }
  std::map<std::string, OtherCameraScore> scores;
  Progress progress("scoring images", static_cast<std::int64_t>(total));
  for (OtherScene& other : scenes) {
    Scene& scene = other.scene;
    const RigCamera& camera = scene.rig[static_cast<std::size_t>(other.camera)];
    const Exclusions left_out = exclusions_of(run, other, backend.pool());
    const Mask& of_camera = left_out.masks[static_cast<std::size_t>(other.camera)];
    OtherCameraScore result;
    if (run.state.poses.refines()) {
      std::vector<std::size_t> all(scene.views.size());
      for (std::size_t v = 0; v < all.size(); ++v) all[v] = v;
      result.view_alignment = align_views(run, backend, all, left_out, &scene);
    }
    const RayTable table = make_ray_table(camera.camera, backend.pool());
    std::vector<Comparison> images;
    const auto load = [&](std::size_t v) { return load_view(scene, scene.views[v]); };
    const auto add = [&](std::size_t v, const Image8& recorded) {
      const View& view = scene.views[v];
      images.push_back({view,
                        render_image(backend, *run.field(), table, scene.shutter_poses(view),
                                     scene.exposure(view)),
                        recorded, recorded});
      apply_mask(view_mask(scene, view, of_camera, left_out.moving), &images.back().ground_truth);
      progress.count();
    };
    for_each_loaded(scene.views.size(), backend.pool(), load, add);
    result.gains = least_squares_gains(images);
    ScoreMean mean;
    MovingScores moving(run, backend);
    for (Comparison& image : images) {
      for (std::size_t i = 0; i < image.rendered.rgb.size(); ++i)
        image.rendered.rgb[i] =
            static_cast<float>(std::clamp(result.gains[i % 3] * image.rendered.rgb[i], 0.0, 1.0));
      mean.add(score_image(backend, image.rendered, image.ground_truth));
      moving.add(scene, image.view, of_camera, image.rendered, image.recorded);
    }
    result.score = mean.mean();
    result.moving = moving.mean();
    scores[camera.name] = result;
  }
  return scores;
}

nlohmann::json other_cameras_to_json(const std::map<std::string, OtherCameraScore>& scores) {
  nlohmann::json cameras = nlohmann::json::object();
  for (const auto& [name, other] : scores) {
    cameras[name] = score_to_json(other.score);
    cameras[name]["gains"] = other.gains;
    cameras[name]["view_alignment"] =
        other.view_alignment ? view_alignment_to_json(*other.view_alignment) : nullptr;
    cameras[name]["moving"] = other.moving ? moving_to_json(*other.moving) : nullptr;
  }
  return {{"other_cameras", cameras}};
}

}  // namespace redrive
