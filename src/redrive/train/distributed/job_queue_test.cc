// SPDX-License-Identifier: Apache-2.0
// The queue over threads that stand for processes.
#include "redrive/train/distributed/job_queue.h"

#include <algorithm>
#include <atomic>
#include <chrono>
#include <deque>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

using ::testing::ElementsAre;

struct Mail {
  std::mutex mutex;
  std::vector<std::deque<GroupMessage>> boxes;
};

class MailGroup final : public ProcessGroup {
 public:
  MailGroup(Mail* mail, int rank) : mail_(*mail), rank_(rank) {}
  int rank() const override { return rank_; }
  int size() const override { return static_cast<int>(mail_.boxes.size()); }
  void send(int to, const std::string& text) override {
    const std::lock_guard lock(mail_.mutex);
    mail_.boxes[to].push_back({rank_, text});
  }
  std::optional<GroupMessage> receive() override {
    const std::lock_guard lock(mail_.mutex);
    if (mail_.boxes[rank_].empty()) return std::nullopt;
    GroupMessage message = mail_.boxes[rank_].front();
    mail_.boxes[rank_].pop_front();
    return message;
  }

 private:
  Mail& mail_;
  int rank_;
};

/// What one process does; `work` gets its flag to stop.
struct TestProcess {
  std::atomic<bool> stop{false};
  std::function<JobResult(int job, const std::atomic<bool>& stop)> work;
  JobHandler handler() {
    JobHandler handler;
    handler.work = [this](int job) { return work(job, stop); };
    handler.stopped = [this] { return stop.load(); };
    handler.stop = [this] { stop = true; };
    return handler;
  }
};

struct Outcome {
  JobResult result;
  std::vector<int> finished;  ///< in the order of their ends
  std::vector<int> codes;     ///< codes of the processes that follow
};

/// Runs jobs 0..jobs-1 on processes that all do `work`.
Outcome run_jobs(int processes, int jobs, const decltype(TestProcess::work)& work) {
  Mail mail;
  mail.boxes.resize(processes);
  std::vector<TestProcess> all(processes);
  for (TestProcess& process : all) process.work = work;
  Outcome outcome;
  outcome.codes.resize(processes - 1);
  std::vector<std::thread> followers;
  for (int rank = 1; rank < processes; ++rank)
    followers.emplace_back([&, rank] {
      MailGroup group(&mail, rank);
      outcome.codes[rank - 1] = follow_jobs(group, all[rank].handler());
    });
  MailGroup group(&mail, 0);
  JobHandler handler = all[0].handler();
  handler.finished = [&](int job) { outcome.finished.push_back(job); };
  std::vector<int> list(jobs);
  for (int i = 0; i < jobs; ++i) list[i] = i;
  outcome.result = lead_jobs(group, list, handler);
  end_jobs(group, outcome.result.code);
  for (std::thread& follower : followers) follower.join();
  return outcome;
}

void wait_for(const std::atomic<bool>& flag) {
  while (!flag) std::this_thread::sleep_for(std::chrono::milliseconds(1));
}

TEST(JobQueue, OneProcessDoesAllInOrder) {
  const Outcome outcome = run_jobs(1, 3, [](int, const auto&) { return JobResult{}; });
  EXPECT_EQ(outcome.result.end, JobEnd::kFinished);
  EXPECT_THAT(outcome.finished, ElementsAre(0, 1, 2));
}

TEST(JobQueue, EveryJobIsDoneOnce) {
  std::atomic<int> done{0};
  const Outcome outcome = run_jobs(3, 10, [&](int, const auto&) {
    ++done;
    return JobResult{};
  });
  EXPECT_EQ(outcome.result.end, JobEnd::kFinished);
  EXPECT_EQ(done, 10);
  EXPECT_EQ(std::set<int>(outcome.finished.begin(), outcome.finished.end()).size(), 10u);
  EXPECT_THAT(outcome.codes, ElementsAre(0, 0));
}

TEST(JobQueue, ALongJobDoesNotHoldUpTheOthers) {
  // Job 0 ends when the last of the others has begun.
  std::atomic<int> others{0};
  const Outcome outcome = run_jobs(2, 6, [&](int job, const auto&) {
    if (job == 0)
      while (others < 5) std::this_thread::sleep_for(std::chrono::milliseconds(1));
    else
      ++others;
    return JobResult{};
  });
  EXPECT_GE(std::ranges::find(outcome.finished, 0) - outcome.finished.begin(), 4);
}

TEST(JobQueue, AFailureStopsAllAndIsReturned) {
  const Outcome outcome = run_jobs(3, 9, [](int job, const std::atomic<bool>& stop) -> JobResult {
    if (job == 2) return {JobEnd::kFailed, 4, "block 2: disk full"};
    wait_for(stop);
    return {JobEnd::kStopped};
  });
  EXPECT_EQ(outcome.result.end, JobEnd::kFailed);
  EXPECT_EQ(outcome.result.code, 4);
  EXPECT_EQ(outcome.result.message, "block 2: disk full");
  EXPECT_THAT(outcome.finished, ElementsAre());
  EXPECT_THAT(outcome.codes, ElementsAre(4, 4));
}

TEST(JobQueue, AProcessThatIsStoppedStopsAll) {
  std::atomic<int> begun{0};
  const Outcome outcome = run_jobs(3, 9, [&](int job, const std::atomic<bool>& stop) -> JobResult {
    ++begun;
    if (job == 1) return {JobEnd::kStopped};  // a signal reached it alone
    wait_for(stop);
    return {JobEnd::kStopped};
  });
  EXPECT_EQ(outcome.result.end, JobEnd::kStopped);
  EXPECT_EQ(begun, 3) << "nothing is handed out any more";
}

TEST(JobQueue, AProcessWithoutAJobThatIsStoppedStopsAll) {
  Mail mail;
  mail.boxes.resize(2);
  TestProcess leader, follower;
  leader.work = [&](int, const std::atomic<bool>& stop) -> JobResult {
    follower.stop = true;  // a signal reaches it alone
    wait_for(stop);
    return {JobEnd::kStopped};
  };
  follower.work = [](int, const auto&) { return JobResult{}; };
  std::thread other([&] {
    MailGroup group(&mail, 1);
    EXPECT_EQ(follow_jobs(group, follower.handler()), 3);
  });
  MailGroup group(&mail, 0);
  JobHandler handler = leader.handler();
  handler.finished = [](int) { FAIL(); };
  EXPECT_EQ(lead_jobs(group, {0}, handler).end, JobEnd::kStopped);
  end_jobs(group, 3);
  other.join();
}

TEST(JobQueue, AnErrorOfTheLeaderStopsAll) {
  Mail mail;
  mail.boxes.resize(2);
  std::vector<TestProcess> all(2);
  for (TestProcess& process : all)
    process.work = [](int job, const std::atomic<bool>& stop) -> JobResult {
      if (job > 0) wait_for(stop);
      return {job > 0 ? JobEnd::kStopped : JobEnd::kFinished};
    };
  std::thread follower([&] {
    MailGroup group(&mail, 1);
    EXPECT_EQ(follow_jobs(group, all[1].handler()), 4);
  });
  MailGroup group(&mail, 0);
  JobHandler handler = all[0].handler();
  handler.finished = [](int) { throw std::runtime_error("cannot write"); };
  EXPECT_THROW(lead_jobs(group, {0, 1, 2}, handler), std::runtime_error);
  end_jobs(group, 4);
  follower.join();
}

}  // namespace
}  // namespace redrive
