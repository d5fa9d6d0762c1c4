// SPDX-License-Identifier: Apache-2.0
// redrive figures: the run's figures as PNG, and report.html.
#include <cstdio>
#include <memory>
#include <string>

#include "redrive/base/error.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/report/report.h"

namespace redrive {
namespace {

struct FiguresOptions {
  std::string run;
  EvalOptions eval;
  kernels::BackendChoice backend;
};

int run_figures(const FiguresOptions& options) {
  const Run run = open_run(options.run);
  const auto backend = make_checked_backend(options.backend);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  write_figures(run, *backend, options.eval);
  std::printf("figures in %s, report in %s\n", run.paths.figures().c_str(), run.paths.report().c_str());
  return kExitOk;
}

}  // namespace

Action configure_figures(CLI::App& command) {
  auto options = std::make_shared<FiguresOptions>();
  command.add_option("RUN", options->run, "folder that train made")->required();
  command.add_option("--max-images", options->eval.max_images,
      "images scored for the report, per camera and per novel set, evenly spaced (default: as eval)")
      ->check(CLI::Range(1, 1000000));
  add_backend_options(command, &options->backend);
  return [options] { return run_figures(*options); };
}

}  // namespace redrive
