// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/train/train_together.h"

#include <chrono>
#include <cstdio>
#include <thread>

#include "redrive/base/error.h"
#include "redrive/cli/failure.h"
#include "redrive/cli/train/line_prefix.h"
#include "redrive/cli/train/train_blocks.h"
#include "redrive/cli/train/training.h"
#include "redrive/train/distributed/job_queue.h"

namespace redrive {

void add_data_parallel_option(CLI::App& command, bool* data_parallel) {
  command
      .add_flag("--data-parallel", *data_parallel,
                "the processes of mpirun train one run together: each draws its own image of a "
                "step, and their gradients are averaged")
      ->group("Run");
}

void check_together(const ProcessGroup& processes, const Run& run) {
  const std::string what = std::to_string(processes.size()) + " processes";
  if (run.state.model->uses_error_map())
    throw UsageError("--data-parallel", what,
                     "is not for --method " + run.options.method +
                         " with rays drawn by their errors, which processes do not exchange");
}

int lead_together(ProcessGroup& processes, Run* run, const TrainingData& training,
                  kernels::Backend& backend) {
  std::printf("%d processes compute each step together\n", processes.size());
  std::fflush(stdout);
  start_together(processes);
  ExitCode failure = kExitOk;
  try {
    return train_to_end(run, training, backend, stop_on_signal(), nullptr, &processes);
  } catch (...) {
    failure = print_failure();
  }
  processes.abort(failure);  // they wait for this process
  return failure;            // for the compiler
}

void follow_together(ProcessGroup& processes, const std::filesystem::path& root) {
  PrefixedOutput::set_silent(true);
  try {
    Run run = open_run(root, /*to_resume=*/true);
    const auto [backend, training] = set_up_training(processes, run, true);
    train(&run, training, *backend, stop_on_signal(), nullptr, &processes);
  } catch (...) {
    PrefixedOutput::set_silent(false);
    std::this_thread::sleep_for(std::chrono::seconds(1));  // process 0 may be about to say the same
    processes.abort(print_failure());
  }
  PrefixedOutput::set_silent(false);
}

}  // namespace redrive
