// SPDX-License-Identifier: Apache-2.0
// The table of commands.
#include <malloc.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <iostream>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include <CLI/App.hpp>
#include <CLI/Config.hpp>
#include <CLI/Formatter.hpp>

#include "redrive/base/error.h"
#include "redrive/base/processes/interruption.h"
#include "redrive/base/processes/process_group.h"
#include "redrive/base/progress.h"
#include "redrive/base/wrapped_text.h"
#include "redrive/cli/command.h"
#include "redrive/cli/failure.h"
#include "redrive/cli/help.h"
#include "redrive/cli/manual.h"

namespace {

constexpr redrive::Command kRenderCommands[] = {
    {"image", "render the image of a frame's camera, moved or turned",
     redrive::configure_render_image,
     "  redrive render image RUN --camera CAM --frame 1028 --out same.png\n"
     "  redrive render image RUN --camera CAM --frame 1028 --translate 0,0.5,0 \\\n"
     "      --out left.png --depth left.exr",
     "rendering"},
    {"mount", "render the image of a camera of your own on the car",
     redrive::configure_render_mount,
     "  redrive render mount RUN --mount=-1,0,1.5,180,-5,0 \\\n"
     "      --lens pinhole:90:1280x720 --frame 1028 --out rear.png",
     "rendering"},
    {"poses", "render every image of a POSES.json into a folder", redrive::configure_render_poses,
     "  redrive render poses RUN POSES.json --out DIR", "rendering"},
    {"path", "render a camera path into a video or a folder", redrive::configure_render_path,
     "  redrive render path RUN drive --out drive.mp4\n"
     "  redrive render path RUN sideways:1 --seconds 5 --out left.mp4\n"
     "  redrive render path RUN RUN/paths/NAME.json --out DIR",
     "rendering"},
    {"lidar", "render a LiDAR's revolution, or the revolutions of all frames",
     redrive::configure_render_lidar,
     "  redrive render lidar RUN --frame 1028 --out scan.las     # the recorded rays\n"
     "  redrive render lidar RUN --sensor hdl-64e --frame 1028 --out scan.pcd\n"
     "  redrive render lidar RUN --sensor vlp-16 --mount 0,0,2,0,0,0 --out velodyne",
     "rendering"},
};

constexpr redrive::Command kCommands[] = {
    {"inspect", "check a recording: content, missing or inconsistent parts",
     redrive::configure_inspect,
     "  redrive inspect DRIVE\n"
     "  redrive inspect DRIVE --report CHECK     # calibration, poses, times\n"
     "  redrive inspect DRIVE --actors --frames 100:200",
     "inspecting"},
    {"align",
     "refine poses, extrinsics and time offsets by bundle adjustment of images, LiDAR and "
     "egomotion",
     redrive::configure_align,
     "  redrive align DRIVE --out ALIGNED\n"
     "  redrive train DRIVE --poses ALIGNED --out RUN",
     "aligning"},
    {"train", "train a radiance field on a recording", redrive::configure_train,
     "  redrive train DRIVE --out RUN\n"
     "  redrive train DRIVE --poses ALIGNED --holdout-every 8 --out RUN\n"
     "  redrive train PHOTOS --preset best --downscale 2 --out RUN\n"
     "  redrive train DRIVE --method grid --max-seconds 600 --out RUN"},
    {"resume", "continue an interrupted run", redrive::configure_resume,
     "  redrive resume RUN\n"
     "  redrive resume RUN --max-seconds 600     # of training in all"},
    {"plan", "estimate what training a recording will cost and give", redrive::configure_plan,
     "  redrive plan DRIVE --downscale 2\n"
     "  redrive plan DRIVE --blocks auto --machines 8 --cores 64",
     "planning"},
    {"eval", "score a run: PSNR, SSIM, FLIP, and depth error where there is ground truth",
     redrive::configure_eval,
     "  redrive eval RUN\n"
     "  redrive eval RUN --all --json",
     "scoring"},
    {"render", "render images, videos and LiDAR scans of novel views", nullptr,
     "  redrive render RUN --camera CAM --frame 1028 --yaw 10 --out turned.png\n"
     "  redrive render path RUN sideways:1 --out left.mp4\n"
     "  redrive render lidar RUN --frame 1028 --out scan.las\n"
     "  redrive help render path                 # options of a subcommand",
     nullptr, kRenderCommands},
    {"view", "look around in a run or a recording with a browser", redrive::configure_view,
     "  redrive view RUN --open"},
    {"serve", "render for AlpaSim, CARLA and other simulators by gRPC", redrive::configure_serve,
     "  redrive serve RUNS"},
    {"export", "write a run's model in a file format of other programs", redrive::configure_export,
     "  redrive export RUN --to mesh street.glb\n"
     "  redrive export RUN --to splat-ply street.ply\n"
     "  redrive export DRIVE --poses ALIGNED --to colmap DIR",
     "exporting"},
    {"simulate", "render the whole drive anew, with labels, as a drive of a data set",
     redrive::configure_simulate,
     "  redrive simulate RUN --path sideways:1 --out LEFT\n"
     "  redrive simulate RUN --edit EDIT.json --sensor hdl-64e --to kitti360 --out NEW"},
    {"figures", "write a run's figures as PNG and one report.html", redrive::configure_figures,
     "  redrive figures RUN\n"
     "  redrive figures RUN --compare OTHER",
     "drawing figures"},
    {"bench", "time kernels and whole training steps on this machine", redrive::configure_bench,
     "  redrive bench --filter splat"},
    {"doctor", "show what this machine offers and which backend is chosen",
     redrive::configure_doctor, "  redrive doctor"},
};

constexpr const char* kExamples =
    "Examples\n"
    "  redrive inspect DRIVE\n"
    "  redrive train DRIVE --out RUN\n"
    "  redrive view RUN --open\n"
    "  redrive help train                       # options of a command";

/// Throws IoError where printed text did not arrive. A closed pipe (| head) is no error.
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
  if (processes->rank() == 0)
    std::fprintf(stderr, "redrive: %s\n", redrive::usage_message(app, error).c_str());
  return redrive::kExitUsage;
}

/// Returns the words of the command line; `help COMMAND` becomes `COMMAND --help`.
std::vector<std::string> words_of(int argc, char** argv) {
  std::vector<std::string> words(argv + std::min(argc, 1), argv + argc);
  if (!words.empty() && words[0] == "help") {
    words.erase(words.begin());
    words.emplace_back("--help");
  }
  return words;
}

using Actions = std::map<const CLI::App*, std::pair<const redrive::Command*, redrive::Action>>;

/// Adds commands with their subcommands to the program or to a command.
void add_commands(CLI::App& app, std::span<const redrive::Command> commands, Actions* actions) {
  for (const redrive::Command& command : commands) {
    CLI::App* sub = app.add_subcommand(command.name, command.summary);
    std::string footer = std::string("Examples\n") + command.examples;
    if (command.configure) {
      (*actions)[sub] = {&command, command.configure(*sub)};
    } else {
      sub->require_subcommand(1);
      add_commands(*sub, command.subcommands, actions);
      footer =
          redrive::wrapped("Where the word after " + std::string(command.name) +
                               " is none of these, " + command.subcommands[0].name + " is meant.",
                           0, 0) +
          "\n\n" + footer;
    }
    redrive::name_options(*sub);
    sub->footer(footer);
  }
}

/// Prints the help of a program or a command that was called without a word. Returns the exit code.
int end_without_words(const CLI::App& app) {
  if (redrive::launched_rank() == 0) std::fputs(app.help().c_str(), stdout);
  return redrive::kExitUsage;
}

int run(int argc, char** argv) {
  CLI::App app("redrive: from the recording of a sensor car to a radiance field and novel views",
               "redrive");
  app.require_subcommand(1);
  redrive::use_own_help(app);
  app.footer(kExamples);
  app.set_version_flag("--version", "redrive " REDRIVE_VERSION);
  Actions actions;
  add_commands(app, kCommands, &actions);
  redrive::add_generate_option(app, REDRIVE_VERSION);
  redrive::name_options(app);
  std::vector<std::string> words = words_of(argc, argv);
  if (words.empty()) return end_without_words(app);
  if (words.size() == 1)
    if (const CLI::App* command = redrive::find_subcommand(app, words[0]);
        command && !redrive::subcommands_of(*command).empty())
      return end_without_words(*command);
  try {
    redrive::insert_usual_subcommand(app, &words);
    redrive::check_words(app, words);
    std::ranges::reverse(words);  // in the order that the parser takes
    app.parse(words);
  } catch (const CLI::ParseError& error) {
    return end_parsing(app, error);
  } catch (const redrive::UsageError&) {
    const auto processes = redrive::join_process_group();  // they all end here
    return processes->rank() == 0 ? redrive::print_failure() : redrive::kExitUsage;
  }
  const auto& [command, action] = actions.at(&redrive::chosen_command(app));
  std::optional<redrive::Progress> progress;
  if (command->work) progress.emplace(command->work);
  return action();
}

}  // namespace

int main(int argc, char** argv) {
  // Returns buffers of 4 MiB and more to the system when they are freed; the GNU C library would
  // stop doing so after the first ones. The street's training takes 17 % less memory. Smaller
  // buffers are kept for reuse: the system clears each page that it hands out.
  mallopt(M_MMAP_THRESHOLD, 4 << 20);
  mallopt(M_TRIM_THRESHOLD, 1 << 30);
  redrive::handle_signals();
  const redrive::TerminalOutput output;
  try {
    const int code = run(argc, argv);
    check_standard_output();
    return code;
  } catch (...) {
    return redrive::print_failure();
  }
}
