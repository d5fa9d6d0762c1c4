// SPDX-License-Identifier: Apache-2.0
// A queue of jobs for the processes of a group. Process 0 hands them out, the main thread of each
// process exchanges messages, and a thread beside it works, so that no message waits for a job.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "redrive/base/process_group.h"

namespace redrive {

enum class JobEnd { kFinished, kStopped, kFailed };

struct JobResult {
  JobEnd end = JobEnd::kFinished;
  int code = 0;         ///< where it failed: exit code
  std::string message;  ///< likewise, without line breaks
};

/// What a process does with jobs. All but `work` are called by its main thread.
struct JobHandler {
  std::function<JobResult(int job)> work;  ///< on another thread; must not throw
  std::function<bool()> stopped;           ///< whether somebody asked this process to stop
  std::function<void()> stop;              ///< makes `work` end soon, with kStopped
  std::function<void(int job)> finished;   ///< process 0 alone, of the jobs of all processes
  std::function<void()> together;          ///< other processes: their part of start_together
};

/// Hands jobs out in their order, as process 0, and works itself. A job that fails or is stopped
/// stops all others; a process that is asked to stop stops all. Returns the first failure, else
/// kStopped or kFinished. The other processes wait for end_jobs then.
JobResult lead_jobs(ProcessGroup& group, const std::vector<int>& jobs, const JobHandler& handler);

/// Works as another process than 0 until end_jobs, and returns its code. A process without a job
/// that is asked to stop stops all, too: also one that waits for the first job.
int follow_jobs(ProcessGroup& group, const JobHandler& handler);

/// Makes all other processes do JobHandler::together in follow_jobs, while this one does its part.
void start_together(ProcessGroup& group);

/// Ends follow_jobs of all other processes, with this exit code.
void end_jobs(ProcessGroup& group, int code);

}  // namespace redrive
