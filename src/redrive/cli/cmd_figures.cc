// SPDX-License-Identifier: Apache-2.0
// redrive figures: writes a run's figures as PNG, and report.html.
#include <cstdio>
#include <memory>
#include <optional>
#include <string>

#include "redrive/base/error.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/json_output.h"
#include "redrive/render/open_to_render.h"
#include "redrive/report/headline.h"
#include "redrive/report/report.h"

namespace redrive {
namespace {

struct FiguresCommandOptions {
  std::string run, compare;
  std::optional<double> max_damaged;
  FigureOptions figures;
  bool json = false;
  kernels::BackendChoice backend;
};

/// A path may name no folder but a scene in one (nuScenes).
bool same_recording(const std::filesystem::path& a, const std::filesystem::path& b) {
  std::error_code error;
  return a == b || std::filesystem::equivalent(a, b, error);
}

int run_figures(FiguresCommandOptions options) {
  const Run run = open_to_render(options.run, options.max_damaged);
  std::optional<Run> compared;
  if (!options.compare.empty()) {
    compared = open_to_render(options.compare, options.max_damaged);
    if (!same_recording(compared->recording.root, run.recording.root))
      throw UsageError("--compare", options.compare,
                       "is of another recording: " + compared->recording.root.string() + ", not " +
                           run.recording.root.string());
    options.figures.compared = &*compared;
  }
  const auto backend = make_backend(options.backend, run.options.method);
  const Evaluation scores = write_figures(run, *backend, options.figures);
  if (options.json) {
    nlohmann::json json = evaluation_to_json(scores);
    json["report"] = run.paths.report().string();
    print_json(json);
  } else {
    std::printf("%s: %s\n", run.paths.report().c_str(), score_text(scores).c_str());
  }
  return kExitOk;
}

}  // namespace

Action configure_figures(CLI::App& command) {
  auto options = std::make_shared<FiguresCommandOptions>();
  add_run_option(command, &options->run);
  command.add_option("--compare", options->compare,
                     "another run of the same recording, e.g. of --method nerf, to compare with: "
                     "adds its images and scores to the figures and the report");
  command
      .add_option("--max-images", options->figures.eval.max_images,
                  "number of images to score per camera and per novel set, evenly spaced "
                  "(default: as eval)")
      ->check(within("--max-images", 1, 1000000));
  add_json_option(command, &options->json);
  add_max_damaged_option(command, &options->max_damaged);
  add_backend_options(command, &options->backend);
  return [options] { return run_figures(*options); };
}

}  // namespace redrive
