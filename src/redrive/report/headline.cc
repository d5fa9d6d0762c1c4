// SPDX-License-Identifier: Apache-2.0
#include "redrive/report/headline.h"

#include <algorithm>
#include <cmath>

#include "redrive/recording/core/wording.h"
#include "redrive/report/html.h"
#include "redrive/train/files/blocks.h"
#include "redrive/train/train_command.h"

namespace redrive {
namespace {

constexpr int kHoldoutEvery = 8;  // in the command that is shown for a run without held-out frames

std::string duration(double seconds) {
  if (seconds < 60) return fixed(seconds, 1) + " s";
  if (seconds < 3600) return fixed(seconds / 60, 1) + " min";
  return fixed(seconds / 3600, 2) + " h";
}

std::string restarts_text(const TrainState& state) {
  if (state.restarts == 0) return "";
  return "; " + counted(state.restarts, "restart") +
         " from another seed, since training did not converge";
}

std::string images_text(const Evaluation& evaluation) {
  return counted(evaluation.overall.images,
                 evaluation.held_out ? "held-out image" : "training image");
}

std::string score_line(const Evaluation& evaluation) {
  const Score& score = evaluation.overall;
  return "<p class=\"score\"><span>PSNR <strong>" + fixed(score.psnr_db, 2) +
         " dB</strong></span><span>SSIM " + fixed(score.ssim, 3) + "</span><span>FLIP " +
         fixed(score.flip, 3) + "</span></p>\n<p>Means over " + images_text(evaluation) +
         (evaluation.held_out ? ", which training did not see" : ", which training saw") +
         ". Equal images have SSIM 1 and FLIP 0; each 6 dB of PSNR are half the error.</p>\n";
}

/// Returns the run's folder without a slash at its end.
std::filesystem::path folder_of(const Run& run) {
  const std::filesystem::path& root = run.paths.root;
  return root.has_filename() ? root : root.parent_path();
}

/// Returns the run that this one is a block of; empty if it is none.
std::filesystem::path whole_of(const Run& run) {
  const std::filesystem::path whole =
      std::filesystem::absolute(folder_of(run)).parent_path().parent_path();
  return is_divided_run(whole) ? whole : std::filesystem::path();
}

/// Returns a folder beside the run, or beside the run that it is a block of.
std::filesystem::path folder_beside(const Run& run, const std::string& suffix) {
  const std::filesystem::path folder = folder_of(run), whole = whole_of(run);
  return whole.empty() ? folder.string() + suffix
                       : whole.string() + "-" + folder.filename().string() + suffix;
}

/// Returns what the run lacks, with the command that makes it; empty where nothing is missing.
std::string missing(const ScoredRun& scored) {
  const Run& run = *scored.run;
  std::string out;
  if (run.state.step == 0)
    out += html_warning("The run has no training step yet. This trains it:") +
           html_command("redrive resume " + shell_word(folder_of(run).string()));
  if (scored.evaluation.held_out) return out;
  TrainOptions options = run.options;
  options.train_every = 0;
  options.holdout_every =
      std::clamp(static_cast<int>(run.scene.frames.size()) / 2, 2, kHoldoutEvery);
  return out +
         html_warning(
             "No frame was held out, so the score says nothing about images that "
             "training did not see. This trains a run that keeps one frame of " +
             std::to_string(options.holdout_every) + " for that:") +
         html_command(train_command(run, options, folder_beside(run, "-held-out")));
}

std::string command(const Run& run) {
  const std::filesystem::path whole = whole_of(run);
  if (whole.empty())
    return "<h3>The command of this run</h3>\n" +
           html_command(train_command(run, run.options, folder_of(run)));
  return "<h3>A command for this part of the drive</h3>\n<p>This run is a block of " +
         html_escape(whole.string()) +
         ", which train --blocks made. This trains its frames alone:</p>\n" +
         html_command(train_command(run, run.options, folder_beside(run, "")));
}

std::string facts(const Run& run, const kernels::Backend& backend) {
  constexpr std::size_t kCamerasNamed = 8;  // photographs may have a camera each
  std::vector<std::string> cameras;
  for (const RigCamera& camera : run.scene.rig) cameras.push_back(camera.name);
  return "<p>" + counted(cameras.size(), "camera") + ": " +
         html_escape(first_few(cameras, kCamerasNamed)) + "; " +
         counted(run.scene.frames.size(), "frame") + "; method " + run.field()->method() + ", " +
         html_escape(run.field()->describe()) + "</p>\n<p>" + counted(run.state.step, "step") +
         " in " + duration(run.state.seconds) + " of training" + restarts_text(run.state) +
         "; images rendered with " + html_escape(kernels::describe(backend)) + "</p>\n";
}

}  // namespace

ScoredRun score_run(const Run& run, kernels::Backend& backend, EvalOptions options) {
  ScoredRun scored{&run, {}, {}};
  options.scored = [&](const View& view, const Score& score) {
    scored.images.emplace_back(view, score);
  };
  scored.evaluation = evaluate(run, backend, options);
  return scored;
}

const View* median_view(const ScoredRun& scored) {
  std::vector<std::pair<double, const View*>> by_psnr;
  for (const auto& [view, score] : scored.images)
    if (!std::isnan(score.psnr_db)) by_psnr.emplace_back(score.psnr_db, &view);
  if (by_psnr.empty()) return nullptr;
  std::ranges::stable_sort(by_psnr, {}, [](const auto& entry) { return entry.first; });
  return by_psnr[(by_psnr.size() - 1) / 2].second;
}

std::string score_text(const Evaluation& evaluation) {
  const Score& score = evaluation.overall;
  return "PSNR " + fixed(score.psnr_db, 2) + " dB, SSIM " + fixed(score.ssim, 3) + ", FLIP " +
         fixed(score.flip, 3) + " on " + images_text(evaluation);
}

std::string recording_name(const Run& run) {
  const auto path = run.recording.root.lexically_normal();
  return (path.has_filename() ? path.filename() : path.parent_path().filename()).string();
}

ImageRow headline_images(const ScoredRun& own, const ScoredRun* compared,
                         kernels::Backend& backend) {
  const View* const view = median_view(own);
  if (!view) return {};
  const View* same = nullptr;
  const auto name_of = [](const Run& run, const View& v) {
    return std::pair(run.scene.rig[v.camera].name, run.scene.frames[v.frame].id);
  };
  if (compared)
    for (const auto& [other, score] : compared->images)
      if (name_of(*compared->run, other) == name_of(*own.run, *view)) same = &other;
  return headline_image_row(*own.run, backend, *view, compared ? compared->run : nullptr, same);
}

std::string headline(const ScoredRun& own, const ScoredRun* compared,
                     const kernels::Backend& backend, const std::string& images) {
  std::string out =
      "<h1>" + html_escape(recording_name(*own.run)) + "</h1>\n" + score_line(own.evaluation);
  if (compared)
    out += "<p>Compared with " + html_escape(method_text(*compared->run)) + ": " +
           score_text(compared->evaluation) + ".</p>\n";
  if (!images.empty())
    out += images + "<p>Of the scored images, this one's PSNR is the median.</p>\n";
  return out + missing(own) + command(*own.run) + facts(*own.run, backend);
}

}  // namespace redrive
