// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/evaluate.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/progress.h"
#include "redrive/eval/for_each_loaded.h"
#include "redrive/eval/moving_scores.h"
#include "redrive/eval/novel_scans.h"
#include "redrive/eval/score_mean.h"
#include "redrive/math/angles.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

/// Returns the median of |depth - ground truth| / ground truth where the mask is set and the ground
/// truth known; NaN without such pixels.
double median_depth_error(const RenderedImage& rendered, std::span<const std::uint8_t> mask,
                          std::span<const float> ground_truth_m) {
  std::vector<double> errors;
  for (std::size_t i = 0; i < ground_truth_m.size(); ++i)
    if (mask[i] && ground_truth_m[i] > 0)
      errors.push_back(std::abs(rendered.depth[i] - ground_truth_m[i]) / ground_truth_m[i]);
  if (errors.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = errors.begin() + static_cast<std::ptrdiff_t>(errors.size() / 2);
  std::nth_element(errors.begin(), middle, errors.end());
  return *middle;
}

/// Returns the views to score, one list for each camera of the rig.
std::vector<std::vector<std::size_t>> views_to_score(const Scene& scene, bool held_out,
                                                     const EvalOptions& options) {
  std::vector<std::vector<std::size_t>> by_camera(scene.rig.size());
  for (std::size_t v = 0; v < scene.views.size(); ++v)
    if (scene.views[v].held_out == held_out) by_camera[scene.views[v].camera].push_back(v);
  std::size_t limit = options.max_images;
  if (limit == 0 && !held_out) limit = kTrainingImagesPerCamera;
  if (options.all) limit = 0;
  for (auto& views : by_camera) {
    std::vector<std::size_t> chosen;
    for (const std::size_t i : evenly_spaced(views.size(), limit)) chosen.push_back(views[i]);
    views = std::move(chosen);
  }
  return by_camera;
}

/// Drops views whose images cannot be decoded from the lists.
std::vector<Finding> leave_out_damaged_views(const Run& run, ThreadPool& pool,
                                             std::vector<std::vector<std::size_t>>* by_camera) {
  DamagedViews damaged;
  const ViewLoader load(run.scene, pool, &damaged);
  const auto& views = run.scene.views;
  for (std::vector<std::size_t>& chosen : *by_camera) {
    pool.run(static_cast<int>(chosen.size()),
             [&](int i) { load(views[chosen[static_cast<std::size_t>(i)]]); });
    std::erase_if(chosen, [&](std::size_t v) { return damaged.contains(views[v]); });
  }
  return damaged.judge(run.recording, run.scene);
}

nlohmann::json changes_to_json(const PoseChanges& changes) {
  const auto three = [](const Eigen::Vector3d& v) { return nlohmann::json{v.x(), v.y(), v.z()}; };
  nlohmann::json cameras = nlohmann::json::object();
  for (const CameraChange& camera : changes.cameras)
    cameras[camera.name] = {{"translation_m", three(camera.pose.translation_m)},
                            {"rotation_deg", three(kDegreesPerRadian * camera.pose.rotation_rad)},
                            {"time_offset_s", camera.time_offset_s},
                            {"at_bound", camera.pose.at_bound}};
  return {{"frames",
           {{"translation_m", changes.translation_m},
            {"rotation_deg", kDegreesPerRadian * changes.rotation_rad},
            {"at_bound", changes.frames_at_bound()}}},
          {"cameras", cameras}};
}

nlohmann::json range_score_to_json(const RangeScore& score) {
  return {{"range_error_m", score.range_error_m},
          {"mean_range_error_m", score.mean_range_error_m},
          {"hit_rate", score.hit_rate},
          {"near_hit_rate", score.near_hit_rate},
          {"returns", score.returns}};
}

nlohmann::json lidar_score_to_json(const LidarScore& score) {
  nlohmann::json json = range_score_to_json(score);
  json["chamfer_m"] = score.chamfer_m;
  json["revolutions"] = score.revolutions;
  json["intensity_rmse"] = nullptr;
  if (score.intensity_rmse) json["intensity_rmse"] = *score.intensity_rmse;
  json["lost"] = nullptr;
  if (const auto& lost = score.lost)
    json["lost"] = {{"rays", lost->rays}, {"accuracy", lost->accuracy}, {"f1", lost->f1}};
  json["moving"] = nullptr;
  if (score.moving) json["moving"] = range_score_to_json(*score.moving);
  return json;
}

}  // namespace

nlohmann::json score_to_json(const Score& score) {
  return {{"psnr_db", score.psnr_db},
          {"luma_psnr_db", score.luma_psnr_db},
          {"channel_psnr_db", score.channel_psnr_db},
          {"ssim", score.ssim},
          {"flip", score.flip},
          {"depth_error", score.depth_error},
          {"images", score.images},
          {"masked_pixels", score.left_out},
          {"scored_share", score.scored_share()}};
}

nlohmann::json view_alignment_to_json(const ViewAlignment& alignment) {
  return {{"translation_m", alignment.translation_m},
          {"rotation_deg", alignment.rotation_deg},
          {"views", alignment.views}};
}

Score score_image(kernels::Backend& backend, const RenderedImage& rendered,
                  const Image8& ground_truth, std::span<const float> depth_m) {
  REDRIVE_CHECK_OP(rendered.width, ==, ground_truth.width);
  REDRIVE_CHECK_OP(rendered.height, ==, ground_truth.height);
  std::vector<std::uint8_t> mask = rendered.valid;
  std::int64_t left_out = 0;
  for (std::size_t i = 0; i < ground_truth.used.size(); ++i) {
    if (ground_truth.used[i] != 0 || mask[i] == 0) continue;
    mask[i] = 0;
    ++left_out;
  }
  const kernels::ImageScore score =
      backend.score({rendered.width, rendered.height, rendered.rgb, ground_truth.rgb, mask});
  const auto scored = std::ranges::count_if(mask, [](std::uint8_t used) { return used != 0; });
  Score out{.psnr_db = std::min(score.psnr_db, kPsnrCapDb),
            .luma_psnr_db = std::min(score.luma_psnr_db, kPsnrCapDb),
            .ssim = score.ssim,
            .flip = score.flip,
            .depth_error = median_depth_error(rendered, mask, depth_m),
            .images = 1,
            .left_out = left_out,
            .pixels = static_cast<std::int64_t>(mask.size()),
            .scored = scored};
  for (std::size_t c = 0; c < 3; ++c)
    out.channel_psnr_db[c] = std::min(score.channel_psnr_db[c], kPsnrCapDb);
  return out;
}

namespace {

/// Means of a run's scores, as a whole and by the blocks of its drive.
class Scores {
 public:
  Scores(const Run& run, kernels::Backend& backend, const EvalOptions& options, Progress* progress)
      : run_(run), backend_(backend), options_(options), progress_(progress) {}

  /// Scores the views of each camera; `scene` has their poses.
  void add_views(const Scene& scene, const std::vector<std::vector<std::size_t>>& by_camera,
                 const Exclusions& left_out, Evaluation* evaluation) {
    ScoreMean overall;
    MovingScores moving(run_, backend_);
    for (std::size_t c = 0; c < by_camera.size(); ++c) {
      if (by_camera[c].empty()) continue;
      const RayTable table = make_ray_table(scene.rig[c].camera, backend_.pool());
      ScoreMean mean;
      const auto load = [&](std::size_t i) {
        return load_view(scene, scene.views[by_camera[c][i]]);
      };
      const auto add = [&](std::size_t i, Image8 ground_truth) {
        const View& view = scene.views[by_camera[c][i]];
        const RenderedImage rendered = render_image(
            backend_, *run_.field(), table, scene.shutter_poses(view), scene.exposure(view));
        moving.add(scene, view, left_out.masks[c], rendered, ground_truth);
        apply_mask(view_mask(scene, view, left_out.masks[c], left_out.moving), &ground_truth);
        const Score score = score_image(backend_, rendered, ground_truth);
        mean.add(score);
        overall.add(score);
        if (options_.scored) options_.scored(view, score);
        if (Part* const part = part_of(scene.frames[view.frame].id)) part->overall.add(score);
        progress_->count();
      };
      for_each_loaded(by_camera[c].size(), backend_.pool(), load, add);
      evaluation->cameras[run_.scene.rig[c].name] = mean.mean();
    }
    evaluation->overall = overall.mean();
    evaluation->moving = moving.mean();
  }

  void add_novel(const NovelGroundTruth& ground_truth, std::span<const std::size_t> chosen,
                 Evaluation* evaluation) {
    ScoreMean mean;
    std::map<const RigCamera*, RayTable> tables;
    const auto load = [&](std::size_t k) { return ground_truth.load(chosen[k]); };
    const auto add = [&](std::size_t k, const GroundTruthView& view) {
      RayTable& table = tables[&ground_truth.camera(chosen[k])];
      if (table.width == 0) table = make_ray_table(view.camera, backend_.pool());
      const Score score = score_image(
          backend_, render_image(backend_, *run_.field(), table, view.poses, view.exposure),
          view.image, view.depth_m);
      mean.add(score);
      if (Part* const part = part_of(ground_truth.request(chosen[k]).frame_id))
        part->novel[ground_truth.name()].add(score);
      progress_->count();
    };
    for_each_loaded(chosen.size(), backend_.pool(), load, add);
    evaluation->novel[ground_truth.name()] = mean.mean();
  }

  void write_parts(Evaluation* evaluation) const {
    for (const auto& [name, part] : parts_) {
      PartEvaluation& scores = evaluation->parts[name];
      scores.overall = part.overall.mean();
      for (const auto& [novel, mean] : part.novel) scores.novel[novel] = mean.mean();
    }
  }

 private:
  struct Part {
    ScoreMean overall;
    std::map<std::string, ScoreMean> novel;
  };
  /// Returns nothing for a drive that is not in blocks.
  Part* part_of(std::int64_t frame_id) {
    return run_.blocks.empty() ? nullptr : &parts_[block_of_frame(run_.blocks, frame_id).name];
  }

  const Run& run_;
  kernels::Backend& backend_;
  const EvalOptions& options_;
  Progress* progress_;
  std::map<std::string, Part> parts_;
};

}  // namespace

Evaluation evaluate(const Run& run, kernels::Backend& backend, const EvalOptions& options) {
  Evaluation evaluation;
  Scene scene = run.scene;
  const auto& views = scene.views;
  evaluation.held_out =
      std::any_of(views.begin(), views.end(), [](const View& view) { return view.held_out; });

  const Exclusions left_out = read_exclusions(run);
  evaluation.alignment = register_with_ground_truth(run);
  if (run.state.poses.refines())
    evaluation.pose_changes =
        pose_changes(run.scene, run.state.poses.corrections, pose_refinement(run.options).bounds);
  auto by_camera = views_to_score(scene, evaluation.held_out, options);
  evaluation.damaged = leave_out_damaged_views(run, backend.pool(), &by_camera);
  if (evaluation.held_out && run.state.poses.refines()) {
    std::vector<std::size_t> all;
    for (const auto& chosen : by_camera) all.insert(all.end(), chosen.begin(), chosen.end());
    evaluation.view_alignment = align_views(run, backend, all, left_out, &scene);
  }
  const std::vector<NovelGroundTruth> ground_truths = novel_ground_truths(run);
  const auto chosen_of = [&](std::size_t of_set) {
    return evenly_spaced(of_set, options.all ? 0 : options.max_images);
  };
  std::size_t total = 0;
  for (const auto& chosen : by_camera) total += chosen.size();
  for (const NovelGroundTruth& ground_truth : ground_truths)
    total += chosen_of(ground_truth.size()).size();
  const std::vector<std::int64_t> held_out_scans = held_out_revolutions(run);
  std::vector<std::int64_t> scans;
  for (const std::size_t i : chosen_of(held_out_scans.size())) scans.push_back(held_out_scans[i]);
  total += scans.size();
  std::vector<NovelScans> novel_sets = novel_scans(run, &evaluation.damaged);
  for (NovelScans& set : novel_sets) {
    std::vector<FrameFile> chosen;
    for (const std::size_t i : chosen_of(set.files.size())) chosen.push_back(set.files[i]);
    set.files = std::move(chosen);
    total += set.files.size();
  }
  Progress progress("scoring images", static_cast<std::int64_t>(total));

  Scores scores(run, backend, options, &progress);
  scores.add_views(scene, by_camera, left_out, &evaluation);
  for (const NovelGroundTruth& ground_truth : ground_truths)
    scores.add_novel(ground_truth, chosen_of(ground_truth.size()), &evaluation);
  scores.write_parts(&evaluation);
  if (!scans.empty())
    evaluation.lidar =
        score_lidar(run, backend, scans, left_out.moving, &progress, &evaluation.lidars);
  for (const NovelScans& set : novel_sets)
    if (const auto score =
            score_novel_scans(run, backend, evaluation.alignment.value_or(TrajectoryRegistration{}),
                              set, left_out.moving, &progress))
      evaluation.novel_lidar[set.name] = *score;
  return evaluation;
}

nlohmann::json moving_to_json(const MovingEvaluation& moving) {
  nlohmann::json json = {{"inside", score_to_json(moving.inside)},
                         {"outside", score_to_json(moving.outside)},
                         {"objects", nlohmann::json::object()}};
  for (const auto& [id, object] : moving.objects)
    json["objects"][std::to_string(id)] = {{"type", object.type},
                                           {"psnr_db", object.score.psnr_db},
                                           {"luma_psnr_db", object.score.luma_psnr_db},
                                           {"ssim", object.score.ssim},
                                           {"images", object.score.images}};
  return json;
}

nlohmann::json evaluation_to_json(const Evaluation& evaluation) {
  nlohmann::json json = {{"overall", score_to_json(evaluation.overall)},
                         {"cameras", nlohmann::json::object()},
                         {"novel", nlohmann::json::object()},
                         {"held_out", evaluation.held_out},
                         {"moving", nullptr},
                         {"lidar", nullptr},
                         {"lidars", nlohmann::json::object()},
                         {"novel_lidar", nlohmann::json::object()},
                         {"alignment", nullptr},
                         {"view_alignment", nullptr},
                         {"pose_changes", nullptr}};
  for (const auto& [name, part] : evaluation.parts) {
    nlohmann::json& scores = json["blocks"][name];
    scores = {{"overall", score_to_json(part.overall)}, {"novel", nlohmann::json::object()}};
    for (const auto& [novel, score] : part.novel) scores["novel"][novel] = score_to_json(score);
  }
  if (evaluation.pose_changes) json["pose_changes"] = changes_to_json(*evaluation.pose_changes);
  if (const auto& aligned = evaluation.view_alignment)
    json["view_alignment"] = view_alignment_to_json(*aligned);
  if (evaluation.moving) json["moving"] = moving_to_json(*evaluation.moving);
  if (const auto& alignment = evaluation.alignment)
    json["alignment"] = registration_to_json(*alignment);
  if (evaluation.lidar) json["lidar"] = lidar_score_to_json(*evaluation.lidar);
  for (const auto& [name, score] : evaluation.lidars)
    json["lidars"][name] = lidar_score_to_json(score);
  for (const auto& [name, score] : evaluation.novel_lidar)
    json["novel_lidar"][name] = lidar_score_to_json(score);
  for (const auto& [name, score] : evaluation.cameras) json["cameras"][name] = score_to_json(score);
  for (const auto& [name, score] : evaluation.novel) json["novel"][name] = score_to_json(score);
  return json;
}

}  // namespace redrive
