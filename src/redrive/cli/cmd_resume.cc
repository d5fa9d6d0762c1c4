// SPDX-License-Identifier: Apache-2.0
// redrive resume RUN: continues from the last checkpoint. Options may raise the limits on epochs,
// steps or seconds, and are written to the run's config.json. (More steps move the default
// milestones of the learning rate, which are fractions of all steps.)
#include <cstdio>
#include <memory>
#include <optional>
#include <utility>

#include "redrive/base/error.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/notes.h"
#include "redrive/cli/train/train_blocks.h"
#include "redrive/cli/train/train_together.h"
#include "redrive/cli/train/training.h"
#include "redrive/train/files/run_lock.h"

namespace redrive {
namespace {

constexpr const char* kChangeable[] = {"epochs",     "max-steps",  "max-seconds", "memory",
                                       "gpu-memory", "backend",    "isa",         "device",
                                       "threads",    "max-damaged"};

struct ResumeArguments {
  std::string run;
  GivenFields given;
  bool data_parallel = false;
  LiveViewOptions live;
};

std::optional<double> max_damaged(const GivenFields& given) {
  if (!given.contains("max-damaged")) return std::nullopt;
  TrainOptions options;
  parse_given(given, &options);
  return options.max_damaged;
}

/// Applies what is given to the run's options. Another backend than vulkan does without the run's
/// device.
void apply(const GivenFields& given, TrainOptions* options) {
  const std::string backend = options->backend;
  parse_given(given, options);
  if (options->backend != backend && options->backend != "vulkan" && !given.contains("device"))
    options->device.clear();
  validate(*options);
}

/// Continues the blocks that are not finished, or all of them where their limits changed.
int resume_blocks(const ResumeArguments& arguments, ProcessGroup& processes) {
  if (arguments.live.view)
    throw UsageError("--view", "", "shows one run; this one has blocks, see redrive view RUN");
  if (arguments.data_parallel)
    throw UsageError("--data-parallel", "",
                     "is for one run; this one has blocks, of which each process trains some");
  const RunLock lock(arguments.run);
  DividedRun whole = open_divided_run(arguments.run, max_damaged(arguments.given));
  print_notes(whole.recording, whole.scene);
  apply(arguments.given, &whole.options);
  check_blocks(whole, block_resources(processes, whole.options));
  if (!arguments.given.empty()) write_config(whole.paths, whole.options);
  for (const char* limit : {"epochs", "max-steps", "max-seconds"})
    if (arguments.given.contains(limit))
      for (Block& block : whole.blocks) block.finished = false;
  if (!arguments.given.empty()) write_blocks(whole.paths.root, whole.blocks);
  return train_blocks(processes, &whole);
}

int lead_resuming(const ResumeArguments& arguments, ProcessGroup& processes) {
  check_live_view(arguments.live);
  require_run(arguments.run);
  if (is_divided_run(arguments.run)) return resume_blocks(arguments, processes);
  if (!arguments.data_parallel) check_one_process(processes);
  if (arguments.data_parallel && arguments.live.view)
    throw UsageError("--view", "", "shows a run that one process trains, without --data-parallel");
  const RunLock lock(arguments.run);
  Run run = open_run(arguments.run, /*to_resume=*/true, max_damaged(arguments.given));
  print_notes(run.recording, run.scene);
  apply(arguments.given, &run.options);
  if (run.state.step > 0 && run_progress(run.options, run.state) >= 1) {
    std::printf(
        "%s is finished: step %lld after %.1f s of training; nothing is written. A higher "
        "--max-seconds, --max-steps or --epochs goes on\n",
        run.paths.root.c_str(), static_cast<long long>(run.state.step), run.state.seconds);
    return kExitOk;
  }
  const bool together = arguments.data_parallel && processes.size() > 1;
  const auto backend = make_backend(together ? options_here(processes, run.options) : run.options);
  const std::atomic<bool>& stop = stop_on_signal();
  if (together) check_together(processes, run);
  const ProcessGroup alone;
  const std::optional<std::uint64_t> cache =
      check_run_memory(run, *backend, together ? processes : alone, together);
  std::unique_ptr<LivePage> page = start_live_page(arguments.live);
  const TrainingData training = load_training_data(run, backend->pool(), cache);
  if (!arguments.given.empty()) write_config(run.paths, run.options, run.state.model.get());
  print_summary(run, training, *backend);
  if (together) return lead_together(processes, &run, training, *backend);
  return train_to_end(&run, training, *backend, stop, std::move(page));
}

int run_resume(const ResumeArguments& arguments) {
  return with_processes(
      arguments.run, [&](ProcessGroup& processes) { return lead_resuming(arguments, processes); });
}

}  // namespace

Action configure_resume(CLI::App& command) {
  auto arguments = std::make_shared<ResumeArguments>();
  add_run_option(command, &arguments->run);
  for (const char* name : kChangeable) {
    TrainField field = field_named(name);
    field.help += "; as in the run unless given";
    add_field(command, field, &arguments->given);
  }
  add_data_parallel_option(command, &arguments->data_parallel);
  add_live_view_options(command, &arguments->live);
  return [arguments] { return run_resume(*arguments); };
}

}  // namespace redrive
