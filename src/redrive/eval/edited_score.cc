// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/edited_score.h"

#include <algorithm>
#include <charconv>
#include <optional>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/files/files.h"
#include "redrive/base/progress.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/eval/coverage.h"
#include "redrive/eval/score_mean.h"
#include "redrive/recording/formats/frame_files.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

constexpr const char* kEdit = "edit.json";

struct EditedImage {
  fs::path image, changed;
  std::size_t view = 0;  ///< index in the run's scene
};

struct EditedSet {
  std::string name;
  TrafficEdit edit;
  std::vector<EditedImage> images;
};

/// Returns the view of a file <CAM>_<frame id>; none if the run has no such camera or frame.
std::optional<std::size_t> view_of(const Scene& scene, const std::string& stem) {
  const std::size_t underscore = stem.rfind('_');
  if (underscore == std::string::npos) return std::nullopt;
  const int camera = scene.camera_index(stem.substr(0, underscore));
  std::int64_t id = 0;
  const char *begin = stem.data() + underscore + 1, *end = stem.data() + stem.size();
  if (std::from_chars(begin, end, id).ptr != end || begin == end) return std::nullopt;
  const auto view = std::ranges::find_if(scene.views, [&](const View& v) {
    return v.camera == camera && scene.frames[v.frame].id == id;
  });
  if (view == scene.views.end()) return std::nullopt;
  return view - scene.views.begin();
}

EditedSet read_set(const fs::path& folder, const Scene& scene, std::size_t limit) {
  EditedSet set{folder.filename().string(), read_traffic_edit(folder / kEdit), {}};
  std::vector<EditedImage> all;
  for (const fs::path& file : list_folder(folder)) {
    if (!has_extension(file, {".jpg", ".png"})) continue;
    if (const auto view = view_of(scene, file.stem().string()))
      all.push_back({file, folder / (file.stem().string() + "_changed.png"), *view});
  }
  if (all.empty())
    throw InputError(folder, "images", "none",
                     "must hold CAM_<frame id>.jpg or .png of a camera and a frame of the run");
  for (const std::size_t i : evenly_spaced(all.size(), limit)) set.images.push_back(all[i]);
  return set;
}

std::vector<EditedSet> read_sets(const fs::path& folder, const Scene& scene, std::size_t limit) {
  if (is_there(folder / kEdit)) return {read_set(folder, scene, limit)};
  std::vector<EditedSet> sets;
  for (const fs::path& inner : list_folder(folder))
    if (is_there(inner / kEdit)) sets.push_back(read_set(inner, scene, limit));
  if (sets.empty())
    throw InputError(folder, kEdit, "none", "must be in the folder or in folders in it");
  return sets;
}

/// Registers held-out views among the images with the field, as for scores of held-out images.
void align_held_out(const Run& run, kernels::Backend& backend, const std::vector<EditedSet>& sets,
                    const Exclusions& left_out, Scene* scene) {
  if (!run.state.poses.refines()) return;
  std::vector<std::size_t> views;
  for (const EditedSet& set : sets)
    for (const EditedImage& image : set.images)
      if (scene->views[image.view].held_out && std::ranges::find(views, image.view) == views.end())
        views.push_back(image.view);
  if (!views.empty()) align_views(run, backend, views, left_out, scene);
}

}  // namespace

std::map<std::string, EditedScore> score_edited(const Run& run, kernels::Backend& backend,
                                                const fs::path& folder,
                                                const EvalOptions& options) {
  const std::vector<EditedSet> sets =
      read_sets(folder, run.scene, static_cast<std::size_t>(options.max_images));
  std::vector<Scene> scenes;  // wrong edits are reported before anything is rendered
  int total = 0;
  for (const EditedSet& set : sets) {
    scenes.push_back(run.scene);
    edit_actors(set.edit, &scenes.back());
    total += static_cast<int>(set.images.size());
  }
  const Exclusions left_out = read_exclusions(run);
  Scene aligned = run.scene;
  align_held_out(run, backend, sets, left_out, &aligned);
  const Coverage coverage(run, backend);

  Progress progress("scoring images", total);
  std::map<std::string, EditedScore> scores;
  for (std::size_t s = 0; s < sets.size(); ++s) {
    Scene& scene = scenes[s];
    scene.views = aligned.views;
    ScoreMean inside, seen, outside;
    for (const EditedImage& image : sets[s].images) {
      View view = scene.views[image.view];
      view.image = image.image;
      const auto ground_truth = [&](bool changed) {
        view.mask = {image.changed, changed};
        Image8 of_part = load_view(scene, view);
        apply_mask(left_out.masks[view.camera], &of_part);
        return of_part;
      };
      Image8 changed = ground_truth(true);
      const Image8 rest = ground_truth(false);
      const Camera& camera = scene.rig[view.camera].camera;
      const ShutterPoses poses = scene.shutter_poses(view);
      const RenderedImage rendered =
          render_image(backend, *run.field(), make_ray_table(camera, backend.pool()), poses,
                       scene.exposure(view));
      inside.add(score_image(backend, rendered, changed));
      outside.add(score_image(backend, rendered, rest));
      const std::vector<std::uint8_t> is_seen = coverage.seen(camera, poses, rendered);
      for (std::size_t i = 0; i < changed.used.size(); ++i) changed.used[i] &= is_seen[i];
      if (std::ranges::count_if(changed.used, [](std::uint8_t used) { return used != 0; }) > 0)
        seen.add(score_image(backend, rendered, changed));
      progress.count();
    }
    scores[sets[s].name] = {inside.mean(), seen.mean(), outside.mean()};
  }
  return scores;
}

nlohmann::json edited_to_json(const std::map<std::string, EditedScore>& scores) {
  nlohmann::json edits = nlohmann::json::object();
  for (const auto& [name, score] : scores)
    edits[name] = {{"inside", score_to_json(score.inside)},
                   {"seen", score_to_json(score.seen)},
                   {"outside", score_to_json(score.outside)}};
  return {{"edited", edits}};
}

}  // namespace redrive
