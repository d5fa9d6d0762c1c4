// SPDX-License-Identifier: Apache-2.0
// A queue of jobs for the processes of a group. Process 0 hands them out. The main thread of each
// process exchanges messages while another thread works, so that no message waits for a job.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "redrive/base/processes/process_group.h"

namespace redrive {

enum class JobEnd { kFinished, kStopped, kFailed };

struct JobResult {
  JobEnd end = JobEnd::kFinished;
  int code = 0;         ///< exit code of a failed job
  std::string message;  ///< its message, without line breaks
};

/// What a process does with jobs. The main thread calls everything except `work`.
struct JobHandler {
  std::function<JobResult(int job)> work;  ///< on another thread; must not throw
  std::function<bool()> stopped;           ///< whether this process was asked to stop
  std::function<void()> stop;              ///< makes `work` end soon, with kStopped
  /// called by process 0 only, for the jobs of all processes
  std::function<void(int job)> finished;
  std::function<void()> together;  ///< other processes: their part of start_together
};

/// Hands jobs out in their order, as process 0, and works itself. A job that fails or is stopped
/// stops all others, and so does a process that is asked to stop. Returns the first failure, else
/// kStopped or kFinished. The other processes then wait for end_jobs.
JobResult lead_jobs(ProcessGroup& group, const std::vector<int>& jobs, const JobHandler& handler);

/// Works as a process other than 0 until end_jobs, and returns its code. A process that is asked to
/// stop stops all, even without a job or before its first one.
int follow_jobs(ProcessGroup& group, const JobHandler& handler);

/// Makes all other processes do JobHandler::together in follow_jobs, while this one does its part.
void start_together(ProcessGroup& group);

/// Ends follow_jobs of all other processes, with this exit code.
void end_jobs(ProcessGroup& group, int code);

}  // namespace redrive
