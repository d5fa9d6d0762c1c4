// SPDX-License-Identifier: Apache-2.0
// redrive view: shows a run or a recording in a browser.
#include <fcntl.h>
#include <spawn.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/training.h"
#include "redrive/cli/view_server.h"
#include "redrive/cli/without_model.h"
#include "redrive/train/memory.h"
#include "redrive/view/run_watch.h"
#include "redrive/view/viewer.h"

namespace redrive {
namespace {

struct ViewOptions {
  std::string run, listen = "127.0.0.1";
  int port = -1;
  bool open = false;
  kernels::BackendChoice backend;
};

/// Opens the address in the user's browser, if there is xdg-open.
void open_browser(const std::string& address) {
  std::string program = "xdg-open", argument = address;
  const std::array<char*, 3> arguments = {program.data(), argument.data(), nullptr};
  posix_spawn_file_actions_t quiet;
  posix_spawn_file_actions_init(&quiet);
  for (const int output : {STDOUT_FILENO, STDERR_FILENO})
    posix_spawn_file_actions_addopen(&quiet, output, "/dev/null", O_WRONLY, 0);
  pid_t child = 0;
  if (posix_spawnp(&child, program.c_str(), &quiet, nullptr, arguments.data(), environ) != 0)
    std::fprintf(stderr, "redrive: --open: there is no xdg-open; open the address yourself\n");
  posix_spawn_file_actions_destroy(&quiet);
}

int run_view(const ViewOptions& options) {
  check_page("view", options.run);
  const bool is_run = is_run_folder(options.run);
  std::optional<view::RunWatch> watch;
  if (is_run) watch.emplace(options.run);
  auto run = is_run ? watch->run() : std::make_shared<const Run>(open_without_model(options.run));
  const auto backend =
      is_run ? make_backend_of(*run, options.backend) : make_checked_backend(options.backend);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  if (is_run) check_device_memory(*run, *backend, run->state.model->rendering_work());
  const std::atomic<bool>& stop = stop_on_signal();
  view::Viewer::Look look;
  if (watch) look = [&watch] { return watch->look(); };
  view::Viewer viewer(std::move(run), *backend, look);
  const auto server = start_view_server(options.listen, options.port, &viewer);
  if (options.open) open_browser(server->address());
  viewer.serve(*server, stop);
  return kExitOk;
}

}  // namespace

Action configure_view(CLI::App& command) {
  auto options = std::make_shared<ViewOptions>();
  command.add_option("RUN", options->run, "run folder, as train makes it, or a recording")
      ->required();
  command
      .add_option("--port", options->port,
                  "port to listen on, 0: any that is free (default: " +
                      std::to_string(kUsualViewPort) + ", or any if that is taken)")
      ->check(CLI::Range(0, 65535));
  command
      .add_option("--listen", options->listen,
                  "IP address to listen on; 0.0.0.0 lets other machines in, without encryption")
      ->capture_default_str();
  command.add_flag("--open", options->open, "opens the address in a browser");
  add_backend_options(command, &options->backend);
  return [options] { return run_view(*options); };
}

}  // namespace redrive
