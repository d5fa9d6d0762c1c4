// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/distributed/job_queue.h"

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <optional>
#include <string_view>
#include <thread>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr auto kPoll = std::chrono::milliseconds(10);  // short against a job, which takes minutes
constexpr std::size_t kMaxMessage = 2000;  // bytes; longer ones might wait for their receiver
constexpr std::string_view kDo = "do ", kStop = "stop", kEnd = "end ", kFinished = "finished",
                           kStopped = "stopped", kFailed = "failed ", kAsked = "asked to stop",
                           kTogether = "together";

/// Works on one job at a time.
class Worker {
 public:
  explicit Worker(const JobHandler& handler) : handler_(handler) {}
  ~Worker() {
    if (thread_.joinable()) thread_.join();
  }

  bool busy() const { return thread_.joinable(); }
  void start(int job) {
    done_ = false;
    thread_ = std::thread([this, job] {
      result_ = handler_.work(job);
      done_ = true;
    });
  }
  /// Returns the result once the job has ended.
  std::optional<JobResult> poll() {
    if (!busy() || !done_) return std::nullopt;
    thread_.join();
    return result_;
  }

 private:
  const JobHandler& handler_;
  std::thread thread_;
  std::atomic<bool> done_{false};
  JobResult result_;
};

std::string text_of(const JobResult& result) {
  if (result.end == JobEnd::kFinished) return std::string(kFinished);
  if (result.end == JobEnd::kStopped) return std::string(kStopped);
  return (std::string(kFailed) + std::to_string(result.code) + " " + result.message)
      .substr(0, kMaxMessage);
}

int number_in(std::string_view text) { return std::atoi(std::string(text).c_str()); }

JobResult result_of(std::string_view text) {
  if (text == kFinished) return {};
  if (text == kStopped) return {JobEnd::kStopped};
  REDRIVE_CHECK(text.starts_with(kFailed));
  text.remove_prefix(kFailed.size());
  return {JobEnd::kFailed, number_in(text), std::string(text.substr(text.find(' ') + 1))};
}

/// State of lead_jobs.
class Leader {
 public:
  Leader(ProcessGroup& group, const std::vector<int>& jobs, const JobHandler& handler)
      : group_(group),
        jobs_(jobs),
        handler_(handler),
        worker_(handler),
        job_of_(static_cast<std::size_t>(group.size())) {}

  JobResult run() {
    while (true) {
      if (!stopping_ && handler_.stopped()) stop({JobEnd::kStopped});
      hand_out();
      if (busy() == 0) return end_;
      bool heard = false;
      if (const auto result = worker_.poll()) {
        take(0, *result);
        heard = true;
      }
      while (const auto message = group_.receive()) {
        if (message->text == kAsked)
          stop({JobEnd::kStopped});
        else
          take(message->from, result_of(message->text));
        heard = true;
      }
      if (!heard) std::this_thread::sleep_for(kPoll);
    }
  }

  /// Stops all processes; the first failure is why.
  void stop(const JobResult& why) {
    if (end_.end != JobEnd::kFailed && (why.end == JobEnd::kFailed || !stopping_)) end_ = why;
    if (stopping_) return;
    stopping_ = true;
    handler_.stop();
    for (int rank = 1; rank < group_.size(); ++rank) group_.send(rank, std::string(kStop));
  }

 private:
  int busy() const {
    int n = 0;
    for (const auto& job : job_of_) n += job.has_value();
    return n;
  }

  void hand_out() {
    for (int rank = 0; rank < group_.size() && !stopping_ && next_ < jobs_.size(); ++rank) {
      if (job_of_[rank]) continue;
      const int job = jobs_[next_++];
      job_of_[rank] = job;
      if (rank == 0)
        worker_.start(job);
      else
        group_.send(rank, std::string(kDo) + std::to_string(job));
    }
  }

  void take(int rank, const JobResult& result) {
    REDRIVE_CHECK(job_of_[rank].has_value());
    const int job = *job_of_[rank];
    job_of_[rank].reset();
    if (result.end == JobEnd::kFinished)
      handler_.finished(job);
    else
      stop(result);
  }

  ProcessGroup& group_;
  const std::vector<int>& jobs_;
  const JobHandler& handler_;
  Worker worker_;
  std::vector<std::optional<int>> job_of_;  // one per process
  std::size_t next_ = 0;
  bool stopping_ = false;
  JobResult end_;
};

}  // namespace

JobResult lead_jobs(ProcessGroup& group, const std::vector<int>& jobs, const JobHandler& handler) {
  Leader leader(group, jobs, handler);
  try {
    return leader.run();
  } catch (...) {
    leader.stop({JobEnd::kStopped});  // otherwise their jobs would run to their ends
    throw;
  }
}

int follow_jobs(ProcessGroup& group, const JobHandler& handler) {
  Worker worker(handler);
  bool stopping = false;
  while (true) {
    bool heard = false;
    if (!stopping && !worker.busy() && handler.stopped()) {  // a job would report that itself
      group.send(0, std::string(kAsked));
      stopping = true;
    }
    if (const auto result = worker.poll()) {
      group.send(0, text_of(*result));
      heard = true;
    }
    while (const auto message = group.receive()) {
      const std::string_view text = message->text;
      heard = true;
      if (text.starts_with(kDo)) worker.start(number_in(text.substr(kDo.size())));
      if (text == kTogether) handler.together();
      if (text == kStop) {
        stopping = true;
        handler.stop();
      }
      if (text.starts_with(kEnd)) return number_in(text.substr(kEnd.size()));
    }
    if (!heard) std::this_thread::sleep_for(kPoll);
  }
}

void start_together(ProcessGroup& group) {
  for (int rank = 1; rank < group.size(); ++rank) group.send(rank, std::string(kTogether));
}

void end_jobs(ProcessGroup& group, int code) {
  for (int rank = 1; rank < group.size(); ++rank)
    group.send(rank, std::string(kEnd) + std::to_string(code));
}

}  // namespace redrive
