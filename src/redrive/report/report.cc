// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/report.h"
#include "redrive/image/image_io.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/unfinished.h"
#include "redrive/base/progress.h"
#include "redrive/eval/moving_scores.h"
#include "redrive/report/headline.h"
#include "redrive/report/html.h"
#include "redrive/report/lidar_images.h"
#include "redrive/report/plot.h"
#include "redrive/report/poses_section.h"
#include "redrive/report/report_images.h"
#include "redrive/train/divided_run.h"

namespace redrive {
namespace {

// number of cameras with images: photographs may have a camera each
constexpr std::size_t kCamerasShown = 8;

std::string training(const Run& run, const std::filesystem::path& folder) {
  std::string out = "<h2>Training</h2>\n";
  const std::vector<MetricsRow> rows =
      run.blocks.empty() ? read_metrics(run.paths) : read_block_metrics(run.paths.root).rows;
  if (rows.empty())
    return out + "<p>No curves yet: training writes a row of numbers every 25 steps.</p>\n";
  return out + html_row(plot_figure(folder, "loss", loss_script(rows), "training loss") +
                            plot_figure(folder, "psnr", psnr_script(rows),
                                        "PSNR of the training batches"),
                        FigureSize::kLarge);
}

std::vector<std::string> score_row(const std::string& name, const Score& score) {
  return {name,
          std::to_string(score.images),
          fixed(score.psnr_db, 2),
          fixed(score.ssim, 4),
          fixed(score.flip, 4),
          std::to_string(score.left_out)};
}

/// Adds PSNR and SSIM of another run to a row; dashes where it has none.
void add_compared_scores(const std::map<std::string, Score>& scores, const std::string& name,
                         std::vector<std::string>* row) {
  const auto found = scores.find(name);
  row->push_back(found == scores.end() ? "-" : fixed(found->second.psnr_db, 2));
  row->push_back(found == scores.end() ? "-" : fixed(found->second.ssim, 4));
}

std::string alignment_text(const TrajectoryRegistration& alignment) {
  return "<p>The run's trajectory is aligned to the ground truth first, by a rigid motion of " +
         fixed(100 * alignment.translation_m, 1) + " cm and " + fixed(alignment.rotation_deg, 3) +
         "&deg;. Residual: " + fixed(100 * alignment.residual_m, 1) + " cm and " +
         fixed(alignment.residual_deg, 3) + "&deg; RMS over " + std::to_string(alignment.frames) +
         " frames.</p>\n";
}

/// Returns the row of a run's LiDAR score; dashes where it has none.
std::vector<std::string> lidar_row(const std::string& name,
                                   const std::optional<LidarScore>& score) {
  if (!score) return {name, "-", "-", "-", "-", "-", "-"};
  return {name,
          std::to_string(score->revolutions),
          std::to_string(score->returns),
          fixed(100 * score->range_error_m, 1),
          fixed(100 * score->hit_rate, 1),
          fixed(100 * score->near_hit_rate, 1),
          fixed(100 * score->chamfer_m, 1)};
}

/// Returns the row of a run's score for returns on moving objects; it has no chamfer distance.
std::vector<std::string> moving_lidar_row(const std::string& name, const LidarScore& score) {
  LidarScore moving{*score.moving, score.revolutions, std::numeric_limits<double>::quiet_NaN(), {}};
  return lidar_row(name + ", on moving objects", moving);
}

/// Returns the LiDAR scores of held-out frames and of novel sets; empty if no run has any.
std::string lidar_scores(const Evaluation& evaluation, const Evaluation* other,
                         const std::string& name_of_other) {
  if (!evaluation.lidar && !(other && other->lidar) && evaluation.novel_lidar.empty()) return "";
  std::vector<std::vector<std::string>> rows = {
      {"LiDAR", "revolutions", "returns", "range error (cm)", "rendered (%)",
       "within " + fixed(kNearHit_m, 1) + " m (%)", "chamfer distance (cm)"},
      lidar_row("this run", evaluation.lidar)};
  if (evaluation.lidar && evaluation.lidar->moving)
    rows.push_back(moving_lidar_row("this run", *evaluation.lidar));
  for (const auto& [name, score] : evaluation.lidars)
    rows.push_back(lidar_row("this run, " + name, score));
  if (other) rows.push_back(lidar_row(name_of_other, other->lidar));
  if (other && other->lidar && other->lidar->moving)
    rows.push_back(moving_lidar_row(name_of_other, *other->lidar));
  for (const auto& [name, score] : evaluation.novel_lidar) {
    rows.push_back(lidar_row("this run, " + name, score));
    if (!other) continue;
    const auto same = other->novel_lidar.find(name);
    rows.push_back(lidar_row(name_of_other + ", " + name, same == other->novel_lidar.end()
                                                              ? std::nullopt
                                                              : std::optional(same->second)));
  }
  return "<h3>LiDAR of held-out frames and of novel sets</h3>\n" + html_table(rows, true) +
         "<p>Each recorded return is rendered along its own direction at its own time. Range "
         "error: median of |rendered - recorded|.</p>\n";
}

/// Returns the scores of moving objects, inside and outside their boxes and for each object; empty
/// if no image shows one.
std::string moving_scores(const Evaluation& evaluation, const Evaluation* other,
                          const std::string& name_of_other) {
  if (!evaluation.moving) return "";
  const MovingEvaluation& moving = *evaluation.moving;
  std::map<std::string, Score> of_other;
  std::vector<std::vector<std::string>> rows = {
      {"moving objects", "images", "PSNR (dB)", "SSIM", "FLIP"}};
  if (other)
    rows[0].insert(rows[0].end(), {"PSNR of " + name_of_other, "SSIM of " + name_of_other});
  const auto name_of = [](std::int64_t id, const MovingEvaluation::Object& object) {
    return object.type + " " + std::to_string(id);
  };
  if (other && other->moving) {
    of_other = {{"inside", other->moving->inside}, {"outside", other->moving->outside}};
    for (const auto& [id, object] : other->moving->objects)
      of_other[name_of(id, object)] = object.score;
  }
  const auto add = [&](const std::string& key, const std::string& shown, const Score& score) {
    rows.push_back(score_row(shown, score));
    rows.back().pop_back();  // masked pixels
    if (other) add_compared_scores(of_other, key, &rows.back());
  };
  add("inside", "all of them", moving.inside);
  for (const auto& [id, object] : moving.objects) {
    const std::string name = name_of(id, object);
    add(name, name, object.score);
  }
  add("outside", "beside them", moving.outside);
  return "<h3>Moving objects</h3>\n" + html_table(rows, true) +
         "<p>Pixels whose rays meet an annotated box that moves, grown by " +
         fixed(kBoxMargin_m, 1) +
         " m, whether the run draws the object or not; images with fewer than " +
         std::to_string(kLeastObjectPixels) + " pixels of an object do not count for it.</p>\n";
}

/// `other`: scores of the compared run `name_of_other`; null: none.
std::string scores(const Evaluation& evaluation, const Evaluation* other,
                   const std::string& name_of_other) {
  std::string out =
      "<h2>Scores</h2>\n<p>" +
      std::string(evaluation.held_out ? "Images of held-out frames."
                                      : "Images of training frames: no frame was held out.") +
      " Means over images; FLIP is 0 for equal images.</p>\n";
  if (const auto& aligned = evaluation.view_alignment)
    out += "<p>Training refined the poses; those of the " + std::to_string(aligned->views) +
           " held-out images were refined against the trained model before scoring: translation " +
           fixed(100 * aligned->translation_m, 1) + " cm, rotation " +
           fixed(aligned->rotation_deg, 3) + "&deg; RMS.</p>\n";
  std::vector<std::vector<std::string>> rows = {
      {"camera", "images", "PSNR (dB)", "SSIM", "FLIP", "pixels masked"}};
  const auto add_heads = [&] {
    if (other)
      rows[0].insert(rows[0].end(), {"PSNR of " + name_of_other, "SSIM of " + name_of_other});
  };
  add_heads();
  for (const auto& [name, score] : evaluation.cameras) {
    rows.push_back(score_row(name, score));
    if (other) add_compared_scores(other->cameras, name, &rows.back());
  }
  for (const auto& [name, part] : evaluation.parts) {
    if (part.overall.images == 0) continue;
    rows.push_back(score_row("block " + name, part.overall));
    if (other) add_compared_scores({}, name, &rows.back());
  }
  rows.push_back(score_row("all", evaluation.overall));
  if (other) add_compared_scores({{"all", other->overall}}, "all", &rows.back());
  out += html_table(rows, true) + moving_scores(evaluation, other, name_of_other) +
         lidar_scores(evaluation, other, name_of_other);
  if (evaluation.novel.empty()) return out;
  rows = {
      {"novel views", "images", "PSNR (dB)", "SSIM", "FLIP", "pixels masked", "depth error (%)"}};
  add_heads();
  for (const auto& [name, score] : evaluation.novel) {
    rows.push_back(score_row(name, score));
    rows.back().push_back(fixed(100 * score.depth_error, 1));
    if (other) add_compared_scores(other->novel, name, &rows.back());
  }
  out += "<h3>Novel views with ground truth</h3>\n";
  if (evaluation.alignment) out += alignment_text(*evaluation.alignment);
  return out + html_table(rows, true) +
         "<p>Depth error: median over an image's pixels of |depth - ground truth| / ground truth, "
         "along the ray.</p>\n";
}

/// Writes the images and returns them as figures side by side.
std::string figures_of(const std::filesystem::path& folder, const ImageRow& row, FigureSize size) {
  std::string figures;
  for (const ReportImage& image : row.images) {
    write_image(folder / (image.name + ".png"), image.image);
    figures += html_figure(jpeg_data_uri(image.image), image.caption);
  }
  return html_row(figures, size);
}

std::string image_row(const std::filesystem::path& folder, const ImageRow& row) {
  return "<h3>" + html_escape(row.title) + "</h3>\n" + figures_of(folder, row, FigureSize::kSmall);
}

/// Returns the section of a training image of each camera.
std::string training_views(const Run& run, kernels::Backend& backend, const Run* compared,
                           const std::filesystem::path& folder) {
  const int cameras = static_cast<int>(std::min(run.scene.rig.size(), kCamerasShown));
  std::string out = "<h2>Training views</h2>\n<p>A training image of each camera" +
                    std::string(run.scene.rig.size() > kCamerasShown
                                    ? " (the first " + std::to_string(kCamerasShown) + ")"
                                    : "") +
                    ", drawn at random.</p>\n";
  Progress progress("drawing training views", cameras);
  for (int camera = 0; camera < cameras; ++camera, progress.count())
    out += image_row(folder, camera_image_row(run, backend, camera, compared));
  return out;
}

/// Returns the section of the novel sets with ground truth; empty if there is none.
std::string novel_views(const Run& run, kernels::Backend& backend, const Run* compared,
                        const std::filesystem::path& folder) {
  const std::vector<NovelGroundTruth> ground_truths = novel_ground_truths(run);
  if (ground_truths.empty()) return "";
  const Coverage coverage(run, backend);
  std::string out =
      "<h2>Novel views</h2>\n<p>Coverage by the run's own depth: a surface counts as seen where a "
      "training image shows it, neither masked nor occluded.</p>\n";
  Progress progress("drawing novel views", std::ssize(ground_truths));
  for (const NovelGroundTruth& ground_truth : ground_truths) {
    out += image_row(folder, novel_image_row(run, backend, ground_truth, coverage, compared));
    progress.count();
  }
  return out;
}

/// Returns the section of a held-out scan; empty if there is none.
std::string lidar_scan_section(const Run& run, kernels::Backend& backend,
                               const std::filesystem::path& folder) {
  std::string out;
  for (const ImageRow& row : lidar_image_rows(run, backend))
    out +=
        "<h3>" + html_escape(row.title) + "</h3>\n" + figures_of(folder, row, FigureSize::kLarge);
  return out.empty() ? "" : "<h2>LiDAR</h2>\n" + out;
}

std::string option_text(const nlohmann::json& value) {
  if (value.is_string()) return value.get<std::string>();
  if (!value.is_array()) return value.dump();
  std::string text;
  for (const nlohmann::json& element : value)
    text += (text.empty() ? "" : ", ") + option_text(element);
  return text;
}

std::string all_options(const TrainOptions& options) {
  std::vector<std::pair<std::string, std::string>> pairs;
  const nlohmann::json json = options_to_json(options);
  for (const auto& [key, value] : json.items()) {
    const std::string text = value.empty() ? "" : option_text(value);
    pairs.emplace_back(key, text.empty() ? "-" : text);
  }
  return "<h2>Options</h2>\n" + html_pairs(pairs);
}

/// Writes the figures into the folder and returns the page's body.
std::string figures_and_page(const Run& run, kernels::Backend& backend,
                             const FigureOptions& options, const std::filesystem::path& folder,
                             Evaluation* evaluation) {
  const std::string curves = training(run, folder);  // first: fails at once without gnuplot
  const std::string images = training_views(run, backend, options.compared, folder) +
                             novel_views(run, backend, options.compared, folder) +
                             lidar_scan_section(run, backend, folder);
  const ScoredRun own = score_run(run, backend, options.eval);
  std::optional<ScoredRun> other;
  if (options.compared) other = score_run(*options.compared, backend, options.eval);
  const ScoredRun* const compared = other ? &*other : nullptr;
  const ImageRow row = headline_images(own, compared, backend);
  const std::string body =
      headline(own, compared, backend,
               row.images.empty() ? "" : figures_of(folder, row, FigureSize::kLarge)) +
      curves +
      scores(own.evaluation, other ? &other->evaluation : nullptr,
             other ? method_text(*options.compared) : "") +
      images + poses_section(run, folder) + all_options(run.options);
  *evaluation = own.evaluation;
  return body;
}

}  // namespace

Evaluation write_figures(const Run& run, kernels::Backend& backend, const FigureOptions& options) {
  std::string body;
  Evaluation evaluation;
  write_folder(run.paths.figures(), /*replace=*/true, [&](const std::filesystem::path& folder) {
    body = figures_and_page(run, backend, options, folder, &evaluation);
  });
  write_file(run.paths.report(), html_page("redrive: " + recording_name(run), body));
  return evaluation;
}

}  // namespace redrive
