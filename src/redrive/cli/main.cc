// SPDX-License-Identifier: Apache-2.0
// The table of commands.
#include <malloc.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <iostream>
#include <map>
#include <string>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "redrive/base/error.h"
#include "redrive/base/interruption.h"
#include "redrive/base/process_group.h"
#include "redrive/cli/command.h"
#include "redrive/cli/failure.h"
#include "redrive/cli/manual.h"

namespace {

constexpr redrive::Command kCommands[] = {
    {"inspect", "check a recording: content, missing or inconsistent parts",
     redrive::configure_inspect},
    {"align",
     "refine poses, extrinsics and time offsets by bundle adjustment of images, LiDAR and "
     "egomotion",
     redrive::configure_align},
    {"train", "train a radiance field on a recording", redrive::configure_train},
    {"resume", "continue an interrupted run", redrive::configure_resume},
    {"plan", "estimate what training a recording will cost", redrive::configure_plan},
    {"eval", "score a run: PSNR, SSIM, FLIP, and depth error where there is ground truth",
     redrive::configure_eval},
    {"render", "render images of novel views", redrive::configure_render},
    {"view", "look around in a run or a recording with a browser", redrive::configure_view},
    {"export", "write a run's model in a file format of other programs", redrive::configure_export},
    {"figures", "write a run's figures as PNG and one report.html", redrive::configure_figures},
    {"bench", "time kernels and whole training steps on this machine", redrive::configure_bench},
    {"doctor", "show what this machine offers and which backend is chosen",
     redrive::configure_doctor},
};

std::string known_commands() {
  std::string names;
  for (const redrive::Command& command : kCommands)
    names += (names.empty() ? "there are " : ", ") + std::string(command.name);
  return names;
}

/// Throws IoError where what was printed did not arrive. A closed pipe (| head) is no error.
void check_standard_output() {
  struct stat out {};
  const bool pipe =
      fstat(STDOUT_FILENO, &out) == 0 && (S_ISFIFO(out.st_mode) || S_ISSOCK(out.st_mode));
  std::cout.flush();
  if ((std::fflush(stdout) != 0 || std::ferror(stdout) || !std::cout) && !pipe)
    throw redrive::IoError("standard output", "cannot be written");
}

/// Prints what is wrong with the arguments, or the help that they ask for, once where a launcher
/// started several processes. Returns the exit code.
int end_parsing(const CLI::App& app, const CLI::ParseError& error) {
  if (error.get_exit_code() == 0) {  // help needs no MPI
    if (redrive::launched_rank() == 0) app.exit(error);
    return redrive::kExitOk;
  }
  const auto processes = redrive::join_process_group();  // they all end here
  if (processes->rank() > 0) return redrive::kExitUsage;
  if (const auto words = app.remaining(); app.get_subcommands().empty() && !words.empty())
    std::fprintf(
        stderr, "redrive: %s\n",
        redrive::UsageError("redrive", words.front(), "is not a command; " + known_commands())
            .what());
  else
    app.exit(error);
  return redrive::kExitUsage;
}

int run(int argc, char** argv) {
  CLI::App app("redrive: from the recording of a sensor car to a radiance field and novel views",
               "redrive");
  app.require_subcommand(1);
  app.set_version_flag("--version", "redrive " REDRIVE_VERSION);
  std::map<const CLI::App*, redrive::Action> actions;
  for (const redrive::Command& command : kCommands) {
    CLI::App* sub = app.add_subcommand(command.name, command.summary);
    actions[sub] = command.configure(*sub);
  }
  redrive::add_generate_option(app, REDRIVE_VERSION);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return end_parsing(app, error);
  }
  return actions.at(app.get_subcommands().front())();
}

}  // namespace

int main(int argc, char** argv) {
  // Returns buffers of 4 MiB and more to the system when they are freed, which the GNU C library
  // stops to do after the first ones. The street's training takes 17 % less memory so. Smaller ones
  // are kept for the next: the system clears each page that it gives anew.
  mallopt(M_MMAP_THRESHOLD, 4 << 20);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  redrive::handle_signals();
  try {
    const int code = run(argc, argv);
    check_standard_output();
    return code;
  } catch (...) {
    return redrive::print_failure();
  }
}
