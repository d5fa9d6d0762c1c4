// SPDX-License-Identifier: Apache-2.0
// The table of commands, and the one place where errors become exit codes.
#include <sys/stat.h>
#include <unistd.h>

#include <cstdio>
#include <exception>
#include <filesystem>
#include <map>
#include <string>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "redrive/base/error.h"
#include "redrive/cli/command.h"
#include "redrive/cli/manual.h"

namespace {

constexpr redrive::Command kCommands[] = {
    {"inspect", "what a recording holds, what is missing or odd, and why",
     redrive::configure_inspect},
    {"align",
     "poses and calibration worth training on: image points, LiDAR and egomotion brought into "
     "agreement",
     redrive::configure_align},
    {"train", "train a field on a recording", redrive::configure_train},
    {"resume", "go on with an interrupted run", redrive::configure_resume},
    {"eval",
     "PSNR, SSIM and FLIP of a run, per camera and in all; depth error where the truth ships",
     redrive::configure_eval},
    {"render", "pictures that were never taken", redrive::configure_render},
    {"figures", "the run's figures as PNG and one report.html", redrive::configure_figures},
    {"bench", "time kernels and whole training steps on this machine", redrive::configure_bench},
    {"doctor", "what this machine offers, and what redrive chooses", redrive::configure_doctor},
};

std::string known_commands() {
  std::string names;
  for (const redrive::Command& command : kCommands)
    names += (names.empty() ? "there are " : ", ") + std::string(command.name);
  return names;
}

int run(int argc, char** argv) {
  CLI::App app("redrive: from the recording of a sensor car to a radiance field and its pictures",
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
    if (const auto words = app.remaining(); app.get_subcommands().empty() && !words.empty())
      throw redrive::UsageError("redrive", words.front(), "is not a command; " + known_commands());
    return app.exit(error) == 0 ? redrive::kExitOk : redrive::kExitUsage;
  }
  const int code = actions.at(app.get_subcommands().front())();
  // A reader that went away (| head) had enough; a file that could not be written is an error.
  struct stat out {};
  const bool pipe =
      fstat(STDOUT_FILENO, &out) == 0 && (S_ISFIFO(out.st_mode) || S_ISSOCK(out.st_mode));
  if ((std::fflush(stdout) != 0 || std::ferror(stdout)) && !pipe)
    throw redrive::IoError("standard output", "cannot be written");
  return code;
}

int complain(const std::exception& error, redrive::ExitCode code) {
  std::fprintf(stderr, "redrive: %s\n", error.what());
  return code;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const redrive::UsageError& error) {
    return complain(error, redrive::kExitUsage);
  } catch (const redrive::InputError& error) {
    return complain(error, redrive::kExitBadInput);
  } catch (const redrive::InsufficientDataError& error) {
    return complain(error, redrive::kExitInsufficientData);
  } catch (const redrive::IoError& error) {
    return complain(error, redrive::kExitIo);
  } catch (const redrive::DeviceError& error) {
    return complain(error, redrive::kExitDevice);
  } catch (const std::filesystem::filesystem_error& error) {  // a name too long, a loop of links
    return complain(error, redrive::kExitBadInput);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "redrive: out of memory\n");
    return redrive::kExitInternal;
  } catch (const std::exception& error) {
    return complain(error, redrive::kExitInternal);
  }
}
