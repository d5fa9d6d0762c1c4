// SPDX-License-Identifier: Apache-2.0
// redrive train RECORDING --out RUN [options]: every option comes from train_fields().
#include <filesystem>
#include <memory>
#include <optional>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/cli/alignment.h"
#include "redrive/cli/command.h"
#include "redrive/cli/help.h"
#include "redrive/cli/notes.h"
#include "redrive/cli/train/train_blocks.h"
#include "redrive/cli/train/train_together.h"
#include "redrive/cli/train/training.h"
#include "redrive/recording/core/frame_range.h"
#include "redrive/recording/core/readout_options.h"
#include "redrive/recording/formats/pose_files.h"
#include "redrive/report/align_page.h"
#include "redrive/train/files/run_lock.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

struct TrainArguments {
  GivenFields given;
  std::string out;
  std::string blocks;  ///< "auto" or metres; empty: one run
  bool data_parallel = false;
  LiveViewOptions live;
};

/// Poses that replace the recording's; the run keeps a copy.
struct ExternalPoses {
  PoseFiles files;
  std::optional<AlignResult> alignment;
  Recording recording;  ///< before alignment
};

/// Puts the poses of --poses or --align into run->recording.
std::optional<ExternalPoses> load_external_poses(Run* run, ThreadPool& pool) {
  if (!has_external_poses(run->options)) return std::nullopt;
  ExternalPoses own;
  if (run->options.align) {
    FrameRange range = parse_frame_range(run->options.frames);
    range.step = 1;  // tracks also need the frames between
    keep_frames(range, &run->recording);
    AlignOptions options;
    if (std::filesystem::is_directory(run->options.masks))
      options.tracks.masks = run->options.masks;
    options.bundle.readouts = apply_readout_options(run->options.rolling_shutter, &run->recording);
    own.recording = run->recording;
    own.alignment = align_verbose(run->recording, options, pool);
    own.files = aligned_pose_files(run->recording, *own.alignment);
  } else {
    own.files = read_pose_files(run->recording, run->options.poses);
  }
  // Parses the text in both cases, so that a resumed run has the same bits.
  use_external_poses(own.files, run->options.align ? run->options.recording : run->options.poses,
                     run->options, &run->recording);
  return own;
}

std::function<void(const RunPaths&)> write_poses(const std::optional<ExternalPoses>& poses) {
  return [&poses](const RunPaths& paths) {
    if (poses) write_pose_files(paths.poses(), poses->files);
    if (poses && poses->alignment)
      write_align_page(paths.poses(), poses->recording, *poses->alignment);
  };
}

/// Trains the drive in blocks. Returns nothing if it is one block.
std::optional<int> train_divided(const TrainArguments& arguments, ProcessGroup& processes,
                                 const Run& run, const std::optional<ExternalPoses>& poses,
                                 ThreadPool& pool) {
  DividedRun whole{{}, run.options, run.recording, run.scene, {}};
  const BlockResources resources = block_resources(processes, run.options);
  whole.blocks = divide_as_told(arguments.blocks, whole, resources);
  if (whole.blocks.size() == 1) return std::nullopt;
  if (arguments.data_parallel)
    throw UsageError("--data-parallel", "",
                     "is for one run, and this drive has " + std::to_string(whole.blocks.size()) +
                         " blocks, of which each process trains some");
  std::printf("each block %s\n",
              describe_memory(check_blocks(whole, resources), resources.memory).c_str());
  std::fflush(stdout);
  create_divided_run(arguments.out, &whole, pool, write_poses(poses));
  const RunLock lock(whole.paths.root);
  return train_blocks(processes, &whole);
}

int lead_training(const TrainArguments& arguments, ProcessGroup& processes) {
  Run run;
  run.options = options_of_new_run(arguments.given);
  check_run_is_new(arguments.out);
  check_live_view(arguments.live);
  if (arguments.blocks.empty() && !arguments.data_parallel) check_one_process(processes);
  if (arguments.data_parallel && arguments.live.view)
    throw UsageError("--view", "", "shows a run that one process trains, without --data-parallel");
  if (!arguments.blocks.empty() && arguments.live.view)
    throw UsageError("--view", "", "shows one run; --blocks makes several, see redrive view RUN");
  const auto backend = make_backend(options_here(processes, run.options));
  run.recording = open_recording(run.options);
  if (!arguments.blocks.empty()) check_divisible(arguments.blocks, run.options, run.recording);
  const std::optional<ExternalPoses> poses = load_external_poses(&run, backend->pool());
  make_run_scene(&run, given_names(arguments.given));
  print_notes(run.recording, run.scene);
  if (!arguments.blocks.empty())
    if (const auto code = train_divided(arguments, processes, run, poses, backend->pool()))
      return *code;
  run.state = make_initial_state(run.options, run.scene);
  record_hyperparameters(*run.state.model, &run.options);
  const std::atomic<bool>& stop = stop_on_signal();
  const bool together = arguments.data_parallel && processes.size() > 1;
  if (together) check_together(processes, run);
  const ProcessGroup alone;
  const std::optional<std::uint64_t> cache =
      check_run_memory(run, *backend, together ? processes : alone, together);
  std::unique_ptr<LivePage> page = start_live_page(arguments.live);
  const TrainingData training = prepare_training_data(&run, backend->pool(), cache);
  // Nothing is written before the input has been checked.
  run.paths = create_run(
      arguments.out, run.options,
      [&](const RunPaths& paths) {
        write_run_masks(paths, training, run);
        write_poses(poses)(paths);
      },
      run.state.model.get());
  const RunLock lock(run.paths.root);
  print_summary(run, training, *backend);
  if (together) return lead_together(processes, &run, training, *backend);
  return train_to_end(&run, training, *backend, stop, std::move(page));
}

int run_train(const TrainArguments& arguments) {
  return with_processes(
      arguments.out, [&](ProcessGroup& processes) { return lead_training(arguments, processes); });
}

}  // namespace

Action configure_train(CLI::App& command) {
  auto arguments = std::make_shared<TrainArguments>();
  command.add_option("--out", arguments->out, "folder of the run; must not exist")
      ->required()
      ->type_name("RUN")
      ->group("Run");
  for (const TrainField& field : train_fields()) add_field(command, field, &arguments->given);
  command
      .add_option("--blocks", arguments->blocks,
                  "metres, or auto: divides the drive into blocks of so many metres at most, each "
                  "trained as a run of its own, one after the other or by the processes of "
                  "mpirun; auto: " +
                      number_text(kLongestCore_m) +
                      " m, or less by --memory. --max-seconds, --max-steps and --epochs are those "
                      "of each block")
      ->type_name("METRES")
      ->check(offering({"auto"}))
      ->group("Run");
  add_data_parallel_option(command, &arguments->data_parallel);
  add_live_view_options(command, &arguments->live);
  return [arguments] { return run_train(*arguments); };
}

}  // namespace redrive
