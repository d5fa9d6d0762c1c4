// SPDX-License-Identifier: Apache-2.0
// redrive view: shows a run or a recording in a browser.
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/cli/actor_options.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/notes.h"
#include "redrive/cli/train/training.h"
#include "redrive/cli/view_server.h"
#include "redrive/render/open_to_render.h"
#include "redrive/train/memory.h"
#include "redrive/view/run_watch.h"
#include "redrive/view/traffic.h"
#include "redrive/view/viewer.h"

namespace redrive {
namespace {

struct ViewOptions {
  std::string run, actors = "all", edit;
  bool outside_files = false;
  std::optional<double> max_damaged;
  ViewServerOptions server;
  kernels::BackendChoice backend;
};

int run_view(const ViewOptions& options) {
  check_page("view", options.run);
  const bool is_run = is_run_folder(options.run), is_bundle = is_scene_bundle(options.run);
  if (!is_run && !is_bundle && !(options.edit.empty() && options.actors == "all"))
    throw UsageError(options.edit.empty() ? "--actors" : "--edit",
                     options.edit.empty() ? options.actors : options.edit,
                     "needs a run: a recording has its images alone");
  if ((is_run || is_bundle) && options.outside_files)
    throw UsageError("--outside-files", "", "is for recordings; a run has what train was given");
  std::optional<view::RunWatch> watch;
  if (is_run) watch.emplace(options.run, options.max_damaged);
  auto run = is_run ? watch->run()
             : is_bundle
                 ? std::make_shared<const Run>(open_to_render(options.run, options.max_damaged))
                 : std::make_shared<const Run>(open_without_model(
                       {.folder = options.run,
                        .outside_files = options.outside_files,
                        .max_damaged = options.max_damaged.value_or(kMostDamagedPercent)}));
  if (!is_run && !is_bundle) print_notes(run->recording);
  const auto backend = make_backend(options.backend, run->options.method);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  for (const RigCamera& rig : run->scene.rig) check_rendering_memory(*run, &rig.camera);
  const view::FirstEdit edit = view::first_edit(run->scene, options.actors, options.edit);
  for (const std::string& remark : edit.remarks)
    std::printf("%s: %s\n", options.edit.c_str(), remark.c_str());
  const std::atomic<bool>& stop = stop_on_signal();
  view::Viewer::Look look;
  if (watch) look = [&watch] { return watch->look(); };
  view::Viewer viewer(std::move(run), *backend, look, edit);
  const ViewServer started = start_view_server(options.server, &viewer);
  viewer.serve(*started.server, stop);
  return kExitOk;
}

}  // namespace

Action configure_view(CLI::App& command) {
  auto options = std::make_shared<ViewOptions>();
  command
      .add_option("RUN", options->run,
                  "run folder, as train makes it, a scene bundle, or a recording")
      ->required();
  add_actor_options(command, &options->actors, &options->edit);
  add_outside_files_option(command, &options->outside_files);
  add_max_damaged_option(command, &options->max_damaged);
  add_view_server_options(command, &options->server);
  add_backend_options(command, &options->backend);
  return [options] { return run_view(*options); };
}

}  // namespace redrive
