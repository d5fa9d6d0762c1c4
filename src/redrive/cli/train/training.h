// SPDX-License-Identifier: Apache-2.0
// Code that train and resume share: summaries before and after training, and the page of a run in
// training.
#pragma once

#include <atomic>
#include <memory>
#include <string>
#include <vector>

#include "redrive/base/processes/interruption.h"
#include "redrive/cli/view_server.h"
#include "redrive/kernels/backend.h"
#include "redrive/train/files/given_options.h"
#include "redrive/train/trainer.h"
#include "redrive/train/training_data.h"
#include "redrive/view/preparation.h"

namespace redrive {

/// Adds an option of train_fields() to a command. `given`: must outlive the command.
void add_field(CLI::App& command, const TrainField& field, GivenFields* given);
/// reserve_memory for a process of the group, which has its part of the machine's memory and of its
/// device's. Prints what is needed and allowed. Returns the bytes of a cache of images where not
/// all fit (train/training_data.h).
std::optional<std::uint64_t> check_run_memory(const Run& run, kernels::Backend& backend,
                                              const ProcessGroup& group = {},
                                              bool data_parallel = false);
/// kernels::devices_of_processes of the group's processes on this machine.
std::vector<std::string> devices_of_processes(const TrainOptions& options,
                                              const ProcessGroup& group);

/// Prints backend, cameras with their masks, frames, pixels, training and held-out views.
void print_summary(const Run& run, const TrainingData& training, const kernels::Backend& backend);

/// --view of train and resume.
struct LiveViewOptions {
  bool view = false;
  ViewServerOptions server;
};
void add_live_view_options(CLI::App& command, LiveViewOptions* options);

/// Throws UsageError where the page could not be served. Call it before anything is written.
void check_live_view(const LiveViewOptions& options);

/// The page of a run, from before its data is prepared.
struct LivePage {
  view::Preparation preparation;
  ViewServer started;
  explicit LivePage(const ViewServerOptions& options);
  ~LivePage() { preparation.end(); }
};

/// Returns null without --view.
std::unique_ptr<LivePage> start_live_page(const LiveViewOptions& options);

/// Trains, prints how it ended and how to resume, and returns the exit code. A `page` stays until
/// `stop`.
int train_to_end(Run* run, const TrainingData& training, kernels::Backend& backend,
                 const std::atomic<bool>& stop, std::unique_ptr<LivePage> page = nullptr,
                 ProcessGroup* processes = nullptr);

}  // namespace redrive
