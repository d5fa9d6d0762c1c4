// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/evaluate.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/eval/metrics.h"

namespace redrive {
namespace {

/// Means over images, those without an SSIM (too small) left out of its mean.
class ScoreMean {
 public:
  void add(const Score& score) {
    psnr_db_ += score.psnr_db;
    ++images_;
    if (std::isnan(score.ssim)) return;
    ssim_ += score.ssim;
    ++ssim_images_;
  }
  Score mean() const {
    if (images_ == 0) return {};
    const double ssim = ssim_images_ > 0 ? ssim_ / ssim_images_ : std::numeric_limits<double>::quiet_NaN();
    return {psnr_db_ / images_, ssim, images_};
  }

 private:
  double psnr_db_ = 0, ssim_ = 0;
  int images_ = 0, ssim_images_ = 0;
};

/// Views to score, by camera of the rig.
std::vector<std::vector<const View*>> views_to_score(const Scene& scene, bool held_out, const EvalOptions& options) {
  std::vector<std::vector<const View*>> by_camera(scene.rig.size());
  for (const View& view : scene.views)
    if (view.held_out == held_out) by_camera[view.camera].push_back(&view);
  std::size_t limit = options.max_images;
  if (limit == 0 && !held_out) limit = kTrainingImagesPerCamera;
  if (options.all) limit = 0;
  for (auto& views : by_camera) {
    std::vector<const View*> chosen;
    for (const std::size_t i : evenly_spaced(views.size(), limit)) chosen.push_back(views[i]);
    views = std::move(chosen);
  }
  return by_camera;
}

nlohmann::json score_to_json(const Score& score) {
  return {{"psnr_db", score.psnr_db}, {"ssim", score.ssim}, {"images", score.images}};
}

}  // namespace

std::vector<std::size_t> evenly_spaced(std::size_t size, std::size_t limit) {
  const std::size_t count = limit == 0 ? size : std::min(limit, size);
  std::vector<std::size_t> chosen(count);
  for (std::size_t i = 0; i < count; ++i) chosen[i] = (2 * i + 1) * size / (2 * count);  // middles of equal parts
  return chosen;
}

Score score_image(const RenderedImage& rendered, const Image8& truth) {
  REDRIVE_CHECK_OP(rendered.width, ==, truth.width);
  REDRIVE_CHECK_OP(rendered.height, ==, truth.height);
  std::vector<float> unit(truth.rgb.size());
  std::transform(truth.rgb.begin(), truth.rgb.end(), unit.begin(), [](std::uint8_t v) { return v / 255.0f; });
  const double psnr = psnr_db(rendered.rgb, unit, rendered.valid, rendered.width, rendered.height);
  return {std::min(psnr, kPsnrCapDb), ssim(rendered.rgb, unit, rendered.valid, rendered.width, rendered.height), 1};
}

Evaluation evaluate(const Run& run, kernels::Backend& backend, const EvalOptions& options) {
  Evaluation evaluation;
  const auto& views = run.scene.views;
  evaluation.held_out = std::any_of(views.begin(), views.end(), [](const View& view) { return view.held_out; });

  const auto by_camera = views_to_score(run.scene, evaluation.held_out, options);
  std::vector<std::vector<std::size_t>> by_set;
  std::size_t total = 0, done = 0;
  for (const auto& chosen : by_camera) total += chosen.size();
  for (const NovelSet& set : run.recording.novel) {
    const auto with_truth = novel_views_with_truth(run, set);
    std::vector<std::size_t> chosen;
    for (const std::size_t i : evenly_spaced(with_truth.size(), options.all ? 0 : options.max_images))
      chosen.push_back(with_truth[i]);
    total += chosen.size();
    by_set.push_back(std::move(chosen));
  }
  const auto tell = [&] {
    ++done;
    if (options.progress) options.progress(static_cast<int>(done), static_cast<int>(total));
  };

  ScoreMean overall;
  for (std::size_t c = 0; c < by_camera.size(); ++c) {
    if (by_camera[c].empty()) continue;
    const RayTable table = make_ray_table(run.scene.rig[c].camera);
    ScoreMean mean;
    for (const View* view : by_camera[c]) {
      const Image8 truth = load_view(run.scene, *view);  // first: a broken file must not cost a rendering
      const Score score =
          score_image(render_image(backend, run.state.model, table, run.scene.world_from_camera(*view)), truth);
      mean.add(score);
      overall.add(score);
      tell();
    }
    evaluation.cameras[run.scene.rig[c].name] = mean.mean();
  }
  evaluation.overall = overall.mean();

  for (std::size_t s = 0; s < by_set.size(); ++s) {
    if (by_set[s].empty()) continue;
    ScoreMean mean;
    for (const std::size_t i : by_set[s]) {
      const TruthView view = load_novel_view(run, run.recording.novel[s], i);
      mean.add(score_image(render_image(backend, run.state.model, view.camera, view.world_from_camera), view.truth));
      tell();
    }
    evaluation.novel[run.recording.novel[s].name] = mean.mean();
  }
  return evaluation;
}

nlohmann::json evaluation_to_json(const Evaluation& evaluation) {
  nlohmann::json json = {{"overall", score_to_json(evaluation.overall)},
                         {"cameras", nlohmann::json::object()},
                         {"novel", nlohmann::json::object()},
                         {"held_out", evaluation.held_out}};
  for (const auto& [name, score] : evaluation.cameras) json["cameras"][name] = score_to_json(score);
  for (const auto& [name, score] : evaluation.novel) json["novel"][name] = score_to_json(score);
  return json;
}

}  // namespace redrive
