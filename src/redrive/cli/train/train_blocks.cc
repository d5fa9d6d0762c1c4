// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/train/train_blocks.h"

#include <algorithm>
#include <cstdio>
#include <optional>

#include "redrive/base/cpu_features.h"
#include "redrive/base/memory_limit.h"
#include "redrive/cli/failure.h"
#include "redrive/cli/train/line_prefix.h"
#include "redrive/cli/train/train_together.h"
#include "redrive/cli/train/training.h"
#include "redrive/train/distributed/job_queue.h"
#include "redrive/train/files/run_lock.h"

namespace redrive {
namespace {

/// Trains blocks of a run in this process.
class BlockTrainer {
 public:
  /// `whole`: null: is opened when the first block is trained.
  BlockTrainer(const ProcessGroup& group, const std::filesystem::path& root,
               const DividedRun* whole)
      : group_(group), root_(root), whole_(whole), stop_(stop_on_signal()) {}

  JobHandler handler() {
    JobHandler handler;
    handler.work = [this](int block) { return train(block); };
    handler.stopped = [this] { return stop_.load(); };
    handler.stop = request_stop;
    return handler;
  }

 private:
  JobResult train(int index) {
    std::string which;
    try {
      if (!whole_) whole_ = &own_.emplace(open_divided_run(root_));
      const Block& block = whole_->blocks.at(static_cast<std::size_t>(index));
      which = "block " + block.name + ": ";
      PrefixedOutput::set_prefix(block.name + ": ");
      return {train_block(block) == TrainEnd::kFinished ? JobEnd::kFinished : JobEnd::kStopped};
    } catch (...) {
      const Failure failure = current_failure();
      return {JobEnd::kFailed, failure.code, which + failure.message};
    }
  }

  TrainEnd train_block(const Block& block) {
    std::printf("block %s: frames %lld to %lld, %.1f m to %.1f m of %.1f m\n", block.name.c_str(),
                static_cast<long long>(block.first_frame), static_cast<long long>(block.last_frame),
                block.start_m, block.end_m, whole_->blocks.back().end_m);
    create_block(*whole_, block);
    const RunLock lock(whole_->folder(block));
    Run run = open_block(*whole_, block);
    const auto [backend, training] = set_up_training(group_, run, false);
    print_summary(run, training, *backend);
    const TrainEnd end = redrive::train(&run, training, *backend, stop_);
    std::printf("block %s %s: step %lld after %.1f s of training\n", block.name.c_str(),
                end == TrainEnd::kFinished ? "finished" : "stopped, saved",
                static_cast<long long>(run.state.step), run.state.seconds);
    std::fflush(stdout);
    return end;
  }

  const ProcessGroup& group_;
  const std::filesystem::path root_;
  std::optional<DividedRun> own_;
  const DividedRun* whole_;
  const std::atomic<bool>& stop_;
};

std::size_t count_finished(const std::vector<Block>& blocks) {
  return static_cast<std::size_t>(std::ranges::count(blocks, true, &Block::finished));
}

int report_blocks(const DividedRun& whole, const JobResult& result) {
  const std::string root = whole.paths.root.string(),
                    so_far = std::to_string(count_finished(whole.blocks)) + " of " +
                             std::to_string(whole.blocks.size()) + " blocks are finished",
                    how = "go on with: redrive resume " + root;
  if (result.end == JobEnd::kFailed) {
    std::fprintf(stderr, "redrive: %s\nredrive: %s; %s\n", result.message.c_str(), so_far.c_str(),
                 how.c_str());
    return result.code;
  }
  if (result.end == JobEnd::kStopped) {
    std::fprintf(stderr, "redrive: stopped, saved; %s; %s\n", so_far.c_str(), how.c_str());
    return kExitInterrupted;
  }
  std::printf("finished: %zu blocks; %s\n", whole.blocks.size(), root.c_str());
  return kExitOk;
}

}  // namespace

BlockResources block_resources(const ProcessGroup& group, const TrainOptions& options) {
  return {options.threads > 0 ? options.threads
                              : std::max(1, hardware_threads() / group.on_processors()),
          allowed_memory(options, memory_bytes()) / static_cast<std::uint64_t>(group.on_machine())};
}

TrainOptions options_here(const ProcessGroup& group, const TrainOptions& options) {
  TrainOptions here = options;
  here.threads = block_resources(group, options).threads;
  here.device =
      devices_of_processes(options, group)[static_cast<std::size_t>(group.rank_on_machine())];
  return here;
}

TrainingSetup set_up_training(const ProcessGroup& group, Run& run, bool data_parallel) {
  std::unique_ptr<kernels::Backend> backend = make_backend(options_here(group, run.options));
  const auto cache = check_run_memory(run, *backend, group, data_parallel);
  TrainingData data = load_training_data(run, backend->pool(), cache);
  return {std::move(backend), std::move(data)};
}

int with_processes(const std::filesystem::path& root,
                   const std::function<int(ProcessGroup&)>& lead) {
  const std::unique_ptr<ProcessGroup> group = join_process_group();
  std::optional<PrefixedOutput> prefixed;
  if (group->size() > 1) prefixed.emplace();
  if (group->rank() > 0) {
    BlockTrainer trainer(*group, root, nullptr);
    JobHandler handler = trainer.handler();
    handler.together = [&] { follow_together(*group, root); };
    return follow_jobs(*group, handler);
  }
  try {
    const int code = lead(*group);
    end_jobs(*group, code);
    return code;
  } catch (...) {
    // Printed now: mpirun may kill this process when another one has ended with the same code.
    const ExitCode code = print_failure();
    end_jobs(*group, code);
    return code;
  }
}

void check_one_process(const ProcessGroup& group) {
  if (group.size() > 1)
    throw UsageError("mpirun", std::to_string(group.size()) + " processes",
                     "train a drive in several blocks: --blocks METRES divides it; or one run "
                     "together: --data-parallel");
}

int train_blocks(ProcessGroup& group, DividedRun* whole) {
  for (Block& block : whole->blocks)  // its folder was removed by somebody, since it was damaged
    block.finished &= std::filesystem::exists(RunPaths{whole->folder(block)}.checkpoint());
  std::vector<int> jobs;
  for (const int block : longest_first(whole->blocks, whole->scene.posed_frames()))
    if (!whole->blocks[block].finished) jobs.push_back(block);
  if (const int threads = block_resources(group, whole->options).threads; group.size() > 1)
    std::printf("%d processes, %d on this machine, %d thread%s each\n", group.size(),
                group.on_machine(), threads, threads == 1 ? "" : "s");
  std::printf("%zu blocks, %zu of them finished\n", whole->blocks.size(),
              count_finished(whole->blocks));
  std::fflush(stdout);
  std::error_code error;  // a missing one is made at the end, however often the process is killed
  if (!jobs.empty() && !std::filesystem::remove(exposure_file(whole->paths.root), error) && error)
    throw IoError(exposure_file(whole->paths.root), error.message());
  BlockTrainer trainer(group, whole->paths.root, whole);
  JobHandler handler = trainer.handler();
  std::vector<Block> blocks = whole->blocks;  // the trainer reads the blocks of `whole` meanwhile
  handler.finished = [&](int block) {
    blocks[block].finished = true;
    write_blocks(whole->paths.root, blocks);
  };
  const JobResult result = lead_jobs(group, jobs, handler);
  whole->blocks = blocks;
  if (result.end == JobEnd::kFinished &&
      !std::filesystem::exists(exposure_file(whole->paths.root), error))
    match_exposures(*whole);
  return report_blocks(*whole, result);
}

}  // namespace redrive
