// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/run.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/model/grid_model.h"
#include "redrive/model/nerf_model.h"
#include "redrive/recording/pose_files.h"

namespace redrive {
namespace {

/// Names and values of a model's numbers.
class Numbers final : public NumberVisitor {
 public:
  explicit Numbers(Model& model) { model.visit_numbers(*this); }
  void operator()(const std::string& name, int& value) override {
    values.emplace_back(name, value);
  }
  void operator()(const std::string& name, float& value) override {
    values.emplace_back(name, value);
  }

  std::vector<std::pair<std::string, double>> values;
};

/// The checkpoint belongs to these options and this recording, or InputError.
void check_belongs(const Run& run) {
  const std::filesystem::path file = run.paths.checkpoint();
  const std::unique_ptr<Model> expected = make_run_model(run.options, run.scene);
  if (std::string(run.state.model->method()) != expected->method())
    throw InputError(
        file, "method", run.state.model->method(),
        std::string("is ") + expected->method() + " in " + run.paths.config().string());
  const PoseCorrections& poses = run.state.poses.corrections;
  if (run.state.poses.refines() && (poses.frames != static_cast<int>(run.scene.frames.size()) ||
                                    poses.cameras != static_cast<int>(run.scene.rig.size())))
    throw InputError(
        file, "poses",
        std::to_string(poses.frames) + " frames, " + std::to_string(poses.cameras) + " cameras",
        run.recording.root.string() + " has " + std::to_string(run.scene.frames.size()) + " and " +
            std::to_string(run.scene.rig.size()) +
            " of the run: it is no longer the recording that was trained on");
  const Numbers there(*run.state.model), here(*expected);
  for (std::size_t i = 0; i < here.values.size(); ++i) {
    const auto& [name, value] = there.values[i];
    const double wanted = here.values[i].second;
    // Another compiler may round the last bit otherwise; another trajectory or option differs by
    // far more.
    if (std::abs(value - wanted) > 1e-5 * std::max({0.1, std::abs(value), std::abs(wanted)}))
      throw InputError(file, name, std::to_string(value),
                       "is " + std::to_string(wanted) + " now: " + run.recording.root.string() +
                           " is no longer the recording that was trained on, or " +
                           run.paths.config().string() + " of another run");
  }
}

}  // namespace

void check_run_is_new(const std::filesystem::path& root) {
  if (root.empty()) throw UsageError("--out", "", "must name a folder");
  std::error_code error;
  const std::filesystem::file_status status = std::filesystem::symlink_status(root, error);
  if (error && status.type() == std::filesystem::file_type::none)
    throw UsageError("--out", root.string(), error.message());
  if (std::filesystem::exists(status))
    throw UsageError("--out", root.string(),
                     "exists already; nothing is overwritten, choose another name");
}

RunPaths create_run(const std::filesystem::path& out, const TrainOptions& options,
                    const std::function<void(const RunPaths&)>& fill) {
  check_run_is_new(out);
  const std::filesystem::path root = out.has_filename() ? out : out.parent_path();  // "run/" is run
  std::error_code error;
  if (root.has_parent_path()) std::filesystem::create_directories(root.parent_path(), error);
  // Made beside it under another name and then renamed: a kill in between must not leave a folder
  // that train refuses because it exists and resume because it holds no run.
  std::filesystem::path temporary = root;
  temporary += ".tmp-" + std::to_string(::getpid());
  if (error || !std::filesystem::create_directory(temporary, error))
    throw IoError(temporary, error ? error.message() : "exists already");
  try {
    write_config({temporary}, options);
    if (fill) fill({temporary});
    std::filesystem::rename(temporary, root, error);
    if (error) throw IoError(root, error.message());
  } catch (...) {
    std::filesystem::remove_all(temporary, error);
    throw;
  }
  return {root};
}

void write_config(const RunPaths& paths, const TrainOptions& options) {
  write_file(paths.config(), options_to_json(options).dump(2) + "\n");
}

namespace {

/// The near region reaches kNearPadding beyond all cameras: what is further than that from every
/// one of them has its pixels several centimetres wide (a pixel of 1/500 rad), which the
/// contraction's coarser cells still resolve.
constexpr double kNearPaddingM = 25;

/// Half of an unbounded ray's first samples lie within so many half sides of the near region, as on
/// the road.
constexpr float kHalfSpacing = 3;

std::unique_ptr<Model> grid_model_of(const TrainOptions& options, const Scene& scene) {
  auto model = std::make_unique<GridModel>();
  Eigen::AlignedBox3d cameras;
  for (const View& view : scene.views) cameras.extend(scene.world_from_camera(view).translation());
  for (int k = 0; k < 3; ++k)
    model->contraction.center[k] = static_cast<float>(cameras.center()[k]);
  model->contraction.half_m = static_cast<float>(cameras.sizes().maxCoeff() / 2 + kNearPaddingM);
  if (scene.half_side) {  // its centre is the world's
    const auto half = static_cast<float>(*scene.half_side);
    const bool from_within = std::ranges::any_of(scene.views, [&](const View& view) {
      return scene.world_from_camera(view).translation().cwiseAbs().maxCoeff() < half;
    });
    // Photographs from within see further than their cube, too.
    const bool unbounded = from_within && scene.background == Background::kNone;
    model->contraction = {{0, 0, 0}, half, unbounded};
    model->spacing.half_m = kHalfSpacing * half;
    if (!unbounded) {
      model->field.grid.max_resolution =
          1024;  // from outside a picture's thousand pixels span the cube
      model->histogram_padding =
          0.4f;  // surfaces behind surfaces, and no LiDAR to say which one is real
      // Thin things: a proposal sees them when they are anywhere in its interval, and more of them
      // see them again.
      model->min_proposal_footprint =
          0.3f;  // level with 0.5, better than 1 and none at all (docs/benchmarks.md)
      model->proposal_samples[1] = 64;
      model->field.colour_layers = 2;  // what shines, seen from all around
      model->empty_space = 1e-4f;      // behind and below, which few views look at
    }
  }
  if (scene.background != Background::kNone) {  // nothing to learn of it
    model->sky.levels = 0;
    model->background = background_colour(scene.background)[0];
  }
  if (!scene.metric)
    model->huber_delta = 2;  // photographs of what stands still: the mean is asked for
  if (scene.metric) {
    const double seconds = scene.exposure(0, scene.frames.back().t_ns).t_s;
    model->appearance = {static_cast<int>(scene.rig.size()),
                         static_cast<int>(std::ceil(seconds / kKnotSpacing_s)) + 1};
  }
  model->field.width = options.width;
  model->samples = options.samples;
  model->spacing.near_m = static_cast<float>(options.near_m);
  model->spacing.far_m = static_cast<float>(options.far_m);
  return model;
}

}  // namespace

std::unique_ptr<Model> make_run_model(const TrainOptions& options, const Scene& scene) {
  if (options.method == "grid") return grid_model_of(options, scene);
  auto model = std::make_unique<NerfModel>();
  model->config.width = options.width;
  model->samples = options.samples;
  model->fine_samples = options.fine_samples;
  model->near_m = static_cast<float>(scene.near_m);
  model->far_m = static_cast<float>(scene.far_m);
  model->unit_from_world = scene.unit_from_world;
  return model;
}

TrainState make_initial_state(const TrainOptions& options, const Scene& scene) {
  TrainState state = initial_state(make_run_model(options, scene), options.seed);
  if (refines_poses(options, scene)) state.poses = PoseState(scene);
  return state;
}

Run open_run(const std::filesystem::path& root, bool to_resume) {
  Run run;
  run.paths.root = root;
  std::error_code error;
  if (!std::filesystem::is_directory(root, error))
    throw InputError(root, "", "", "no such run folder");
  run.options = options_from_json(read_json(run.paths.config()), run.paths.config());
  run.recording = open_recording(run.options);
  if (has_external_poses(run.options))
    use_external_poses(read_pose_files(run.recording, run.paths.poses()), run.paths.poses(),
                       run.options, &run.recording);
  run.scene = make_scene(run.recording, scene_options(run.options));
  const auto there = std::filesystem::status(run.paths.checkpoint(), error).type();
  if (to_resume && there == std::filesystem::file_type::not_found) {
    run.state = make_initial_state(run.options, run.scene);
  } else {
    run.state = load_checkpoint(run.paths.checkpoint());
    check_belongs(run);
    if (!to_resume && run.state.poses.refines()) {
      const Scene initial = run.scene;
      run.recording.frames =
          apply_corrections(initial, run.recording.frames, run.state.poses.corrections, &run.scene);
    }
  }
  return run;
}

}  // namespace redrive
