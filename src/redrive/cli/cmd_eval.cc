// SPDX-License-Identifier: Apache-2.0
// redrive eval: prints PSNR, SSIM, FLIP and depth error of a run, and its errors of LiDAR ranges.
#include <cmath>
#include <cstdio>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/json_output.h"
#include "redrive/eval/edited_score.h"
#include "redrive/eval/evaluate.h"
#include "redrive/eval/other_cameras.h"
#include "redrive/render/open_to_render.h"
#include "redrive/report/html.h"

namespace redrive {
namespace {

struct EvalCommandOptions {
  std::string run;
  bool json = false;
  std::vector<std::string> cameras;  ///< cameras that were not trained on
  std::string edited;                ///< folder of edited ground truth
  std::optional<double> max_damaged;
  EvalOptions eval;
  kernels::BackendChoice backend;
};

/// Prints the titles of print_row's columns. "px masked" is Score::left_out.
void print_header(const char* title, bool has_depth = false) {
  std::printf("%-24s %6s %8s %8s %8s %8s %9s%s\n", title, "images", "PSNR dB", "luma dB", "SSIM",
              "FLIP", "px masked", has_depth ? " depth err %" : "");
}

void print_row(const std::string& name, const Score& score) {
  std::printf("%-24s %6d %8.2f %8.2f %8.4f %8.4f %9lld", name.c_str(), score.images, score.psnr_db,
              score.luma_psnr_db, score.ssim, score.flip, static_cast<long long>(score.left_out));
  if (!std::isnan(score.depth_error)) std::printf(" %11.2f", 100 * score.depth_error);
  std::printf("\n");
}

void print_moving(const MovingEvaluation& moving) {
  print_row("moving objects", moving.inside);
  print_row("beside moving objects", moving.outside);
  for (const auto& [id, object] : moving.objects)
    std::printf("%-24s %6d %8.2f %8.2f %8.4f\n",
                ("  " + object.type + " " + std::to_string(id)).c_str(), object.score.images,
                object.score.psnr_db, object.score.luma_psnr_db, object.score.ssim);
}

/// Prints the share of the images that the scores cover.
void print_scored_share(const std::map<std::string, Score>& cameras, const Score& overall) {
  constexpr double kFew = 0.5;
  std::printf("scored: %.1f %% of the pixels\n", 100 * overall.scored_share());
  for (const auto& [name, score] : cameras)
    if (score.scored_share() < kFew)
      std::printf("WARNING: %s: only %.1f %% of its pixels are scored\n", name.c_str(),
                  100 * score.scored_share());
}

/// Prints a row for each novel set with scans, or for each LiDAR.
void print_scans(const char* title, const std::map<std::string, LidarScore>& sets) {
  if (sets.empty()) return;
  std::printf("%-16s %5s %7s %10s %8s %9s %7s %10s %9s %10s %7s\n", title, "scans", "returns",
              "rendered %", "<= 0.2 m", "median cm", "mean cm", "chamfer cm", "intensity",
              "lost acc %", "lost F1");
  for (const auto& [name, score] : sets) {
    std::printf("%-16s %5d %7lld %10.1f %8.1f %9s %7s %10s", name.c_str(), score.revolutions,
                static_cast<long long>(score.returns), 100 * score.hit_rate,
                100 * score.near_hit_rate, fixed(100 * score.range_error_m, 1).c_str(),
                fixed(100 * score.mean_range_error_m, 1).c_str(),
                fixed(100 * score.chamfer_m, 1).c_str());
    if (score.intensity_rmse) std::printf(" %9.3f", *score.intensity_rmse);
    if (score.lost)
      std::printf(" %10.1f %7s", 100 * score.lost->accuracy, fixed(score.lost->f1, 3).c_str());
    std::printf("\n");
  }
}

void print_lidar(const LidarScore& lidar) {
  std::printf(
      "LiDAR of %d held-out frames, %lld returns: %.1f %% rendered, %.1f %% within %.1f m; range "
      "error %s cm (median; mean %s cm), chamfer distance %s cm\n",
      lidar.revolutions, static_cast<long long>(lidar.returns), 100 * lidar.hit_rate,
      100 * lidar.near_hit_rate, kNearHit_m, fixed(100 * lidar.range_error_m, 1).c_str(),
      fixed(100 * lidar.mean_range_error_m, 1).c_str(), fixed(100 * lidar.chamfer_m, 1).c_str());
  if (lidar.intensity_rmse)
    std::printf("intensity: error %.3f of 0..1 (RMS)\n", *lidar.intensity_rmse);
  if (lidar.lost)
    std::printf("rays without a return, of %lld: accuracy %.1f %%, F1 %s\n",
                static_cast<long long>(lidar.lost->rays), 100 * lidar.lost->accuracy,
                fixed(lidar.lost->f1, 3).c_str());
  if (const auto& moving = lidar.moving)
    std::printf(
        "of them on moving objects, %lld returns: %.1f %% rendered, %.1f %% within %.1f m; range "
        "error %s cm (median)\n",
        static_cast<long long>(moving->returns), 100 * moving->hit_rate,
        100 * moving->near_hit_rate, kNearHit_m, fixed(100 * moving->range_error_m, 1).c_str());
}

void print_evaluation(const Evaluation& evaluation) {
  std::printf("%s\n",
              evaluation.held_out ? "held-out frames" : "training frames (no frame was held out)");
  print_header("camera");
  for (const auto& [name, score] : evaluation.cameras) print_row(name, score);
  print_row("all", evaluation.overall);
  const auto& [red, green, blue] = evaluation.overall.channel_psnr_db;
  std::printf("PSNR by channel: red %.2f, green %.2f, blue %.2f dB\n", red, green, blue);
  for (const Finding& damaged : evaluation.damaged)
    std::printf("note: %s: %s\n", damaged.subject.c_str(), damaged.what.c_str());
  print_scored_share(evaluation.cameras, evaluation.overall);
  for (const auto& [name, part] : evaluation.parts)
    if (part.overall.images > 0) print_row("  block " + name, part.overall);
  if (evaluation.moving) print_moving(*evaluation.moving);
  if (const auto& changes = evaluation.pose_changes)
    if (const std::string which = at_bound(*changes); !which.empty())
      std::printf("WARNING: pose corrections at their bounds: %s; see redrive align\n",
                  which.c_str());
  if (const auto& aligned = evaluation.view_alignment)
    std::printf(
        "poses of %d held-out images refined against the trained model before scoring: %.1f cm, "
        "%.3f deg RMS\n",
        aligned->views, 100 * aligned->translation_m, aligned->rotation_deg);
  if (evaluation.lidar) print_lidar(*evaluation.lidar);
  print_scans("each LiDAR", evaluation.lidars);
  const bool has_truth = !evaluation.novel.empty() || !evaluation.novel_lidar.empty();
  if (const auto& alignment = evaluation.alignment; alignment && has_truth)
    std::printf(
        "trajectory aligned to the ground truth by %.1f cm and %.3f deg; residual %.1f cm, "
        "%.3f deg RMS\n",
        100 * alignment->translation_m, alignment->rotation_deg, 100 * alignment->residual_m,
        alignment->residual_deg);
  print_scans("novel scans", evaluation.novel_lidar);
  if (evaluation.novel.empty()) return;
  print_header("novel views", true);
  for (const auto& [name, score] : evaluation.novel) {
    print_row(name, score);
    for (const auto& [block, part] : evaluation.parts)
      if (const auto of_block = part.novel.find(name); of_block != part.novel.end())
        print_row("  block " + block, of_block->second);
  }
}

void print_other_cameras(const std::map<std::string, OtherCameraScore>& scores) {
  print_header("camera not trained on");
  for (const auto& [name, other] : scores) {
    print_row(name, other.score);
    if (other.moving) print_moving(*other.moving);
  }
  for (const auto& [name, other] : scores) {
    std::printf("%s: after gains of %.3f %.3f %.3f (red, green, blue)", name.c_str(),
                other.gains[0], other.gains[1], other.gains[2]);
    if (const auto& aligned = other.view_alignment)
      std::printf("; poses refined against the trained model: %.1f cm, %.3f deg RMS",
                  100 * aligned->translation_m, aligned->rotation_deg);
    std::printf("\n");
  }
}

void print_edited(const std::map<std::string, EditedScore>& scores) {
  print_header("edit");
  for (const auto& [name, score] : scores) {
    print_row(name + ", changed region", score.inside);
    print_row(name + ", seen part of it", score.seen);
    print_row(name + ", beside it", score.outside);
  }
}

int run_eval(EvalCommandOptions options) {
  const Run run = open_to_render(options.run, options.max_damaged);
  const auto backend = make_backend(options.backend, run.options.method);
  if (!options.json) std::printf("%s\n", kernels::describe(*backend).c_str());
  if (!options.edited.empty()) {
    const auto scores = score_edited(run, *backend, options.edited, options.eval);
    if (options.json)
      print_json(edited_to_json(scores));
    else
      print_edited(scores);
    return kExitOk;
  }
  if (!options.cameras.empty()) {
    const auto scores = score_other_cameras(run, *backend, options.cameras, options.eval);
    if (options.json)
      print_json(other_cameras_to_json(scores));
    else
      print_other_cameras(scores);
    return kExitOk;
  }
  const Evaluation evaluation = evaluate(run, *backend, options.eval);
  if (options.json)
    print_json(evaluation_to_json(evaluation));
  else
    print_evaluation(evaluation);
  return kExitOk;
}

}  // namespace

Action configure_eval(CLI::App& command) {
  auto options = std::make_shared<EvalCommandOptions>();
  add_run_option(command, &options->run);
  add_json_option(command, &options->json);
  auto* cameras =
      command
          .add_option("--cameras", options->cameras,
                      "cameras of the recording that were not trained on, to score instead: each "
                      "image after gains for red, green and blue that fit the camera's images best")
          ->delimiter(',');
  command
      .add_option("--edited", options->edited,
                  "folder of ground truth of edited moving objects, to score instead: edit.json "
                  "beside images CAM_<frame id>.jpg and CAM_<frame id>_changed.png, or folders of "
                  "these")
      ->excludes(cameras);
  auto* limit = command
                    .add_option("--max-images", options->eval.max_images,
                                "number of images to score per camera and per novel set, "
                                "evenly spaced (default: every held-out image; " +
                                    std::to_string(kTrainingImagesPerCamera) +
                                    " training images per camera where none is held out)")
                    ->check(within("--max-images", 1, 1000000));
  command
      .add_flag("--all", options->eval.all,
                "score every image, also of the training frames where none is held out")
      ->excludes(limit);
  add_max_damaged_option(command, &options->max_damaged);
  add_backend_options(command, &options->backend);
  return [options] { return run_eval(*options); };
}

}  // namespace redrive
