// SPDX-License-Identifier: Apache-2.0
// kill -9, Ctrl-C, a closed pipe and a full disk while the program trains.
#include <signal.h>

#include <chrono>
#include <cstring>
#include <thread>

#include "redrive/train/run.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

bool bit_equal(std::span<const float> a, std::span<const float> b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size_bytes()) == 0;
}

void expect_same_end(const fs::path& a, const fs::path& b) {
  const TrainState x = load_checkpoint(a / "checkpoint.safetensors"),
                   y = load_checkpoint(b / "checkpoint.safetensors");
  EXPECT_EQ(x.step, y.step);
  EXPECT_TRUE(bit_equal(x.model->parameters, y.model->parameters));
  EXPECT_TRUE(bit_equal(x.adam.first_moment, y.adam.first_moment));
  EXPECT_TRUE(bit_equal(x.adam.second_moment, y.adam.second_moment));
  const std::vector<MetricsRow> p = read_metrics({a}), q = read_metrics({b});
  ASSERT_EQ(p.size(), q.size());
  for (std::size_t i = 0; i < p.size(); ++i) {
    EXPECT_EQ(p[i].step, q[i].step);
    EXPECT_EQ(p[i].loss, q[i].loss);
    EXPECT_EQ(p[i].psnr_db, q[i].psnr_db);
  }
}

/// Waits until the run has written `rows` rows of metrics; false if it takes a minute.
bool wait_for_rows(const fs::path& run, std::size_t rows) {
  for (int i = 0; i < 6000; ++i) {
    if (fs::exists(run / "config.json") && read_metrics({run}).size() >= rows) return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return false;
}

/// A second of training. The tests wait for its first quarter at most, so that the program still
/// trains when it is killed.
const std::vector<std::string> kLong = {"--epochs",           "1000", "--max-steps", "700",
                                        "--checkpoint-every", "70"};

TEST_F(EndToEnd, KilledAndResumedEndsAsUninterrupted) {
  const fs::path whole = folder_ / "whole", parts = folder_ / "parts";
  ASSERT_EQ(redrive(train_arguments(whole, kLong)).exit_code, kExitOk);

  for (const std::size_t rows : {0u, 3u, 7u}) {  // 0: before the first checkpoint, perhaps
    Program program(REDRIVE_BINARY, fs::exists(parts)
                                        ? std::vector<std::string>{"resume", parts.string()}
                                        : train_arguments(parts, kLong));
    ASSERT_TRUE(wait_for_rows(parts, rows));
    program.send(SIGKILL);
    EXPECT_EQ(program.wait().signal, SIGKILL);
  }
  const ProgramResult ended = redrive({"resume", parts.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  expect_same_end(whole, parts);

  EXPECT_EQ(redrive({"resume", parts.string()}).exit_code, kExitOk) << "nothing is left to do";
  expect_same_end(whole, parts);
}

TEST_F(EndToEnd, CtrlCSavesAndPrintsHowToResume) {
  const fs::path whole = folder_ / "whole", parts = folder_ / "parts";
  ASSERT_EQ(redrive(train_arguments(whole, kLong)).exit_code, kExitOk);
  Program program(REDRIVE_BINARY, train_arguments(parts, kLong));
  ASSERT_TRUE(wait_for_rows(parts, 2));
  program.send(SIGINT);
  const ProgramResult ended = program.wait();
  EXPECT_EQ(ended.exit_code, kExitInterrupted);
  EXPECT_THAT(ended.err, HasSubstr("redrive resume " + parts.string()));
  EXPECT_EQ(redrive({"resume", parts.string()}).exit_code, kExitOk);
  expect_same_end(whole, parts);
}

TEST_F(EndToEnd, SighupSavesAsCtrlCDoes) {
  const fs::path run = folder_ / "run";
  Program program(REDRIVE_BINARY, train_arguments(run, kLong));
  ASSERT_TRUE(wait_for_rows(run, 2));
  program.send(SIGHUP);
  EXPECT_EQ(program.wait().exit_code, kExitInterrupted);
  EXPECT_GE(load_checkpoint(run / "checkpoint.safetensors").step, 50);
}

TEST_F(EndToEnd, AClosedPipeDoesNotEndTraining) {
  const fs::path run = folder_ / "run";
  std::string command = "(sleep 0.2; '" REDRIVE_BINARY "'";
  for (const std::string& argument :
       train_arguments(run, {"--max-steps", "30", "--epochs", "1000"}))
    command += " '" + argument + "'";
  command += "; echo $? > '" + (folder_ / "code").string() + "') | true";
  Program("/bin/sh", {"-c", command}).wait();
  EXPECT_EQ(read_file(folder_ / "code"), "0\n");
  EXPECT_EQ(load_checkpoint(run / "checkpoint.safetensors").step, 30);
}

TEST_F(EndToEnd, RefusesToResumeARunningTraining) {
  const fs::path run = folder_ / "run";
  Program program(REDRIVE_BINARY, train_arguments(run, kLong));
  ASSERT_TRUE(wait_for_rows(run, 2));
  const ProgramResult ended = redrive({"resume", run.string()});
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr(run.string() + ": is being trained by another process"));
}

TEST_F(EndToEnd, ResumeRaisesTheNumberOfSteps) {
  const fs::path run = trained("run", 30);
  const ProgramResult ended = redrive({"resume", run.string(), "--max-steps", "50"});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  EXPECT_EQ(load_checkpoint(run / "checkpoint.safetensors").step, 50);
  EXPECT_THAT(read_file(run / "config.json"), HasSubstr("\"max-steps\": 50"));
}

TEST_F(EndToEnd, FullDiskIsReportedAndKeepsTheLastCheckpoint) {
  const fs::path run = trained("run", 30);
  const std::string checkpoint = read_file(run / "checkpoint.safetensors");
  ASSERT_GT(checkpoint.size(), 100'000u);
  const ProgramResult ended = redrive({"resume", run.string(), "--max-steps", "60"}, 50'000);
  EXPECT_EQ(ended.exit_code, kExitIo) << ended.out << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("checkpoint.safetensors"));
  EXPECT_EQ(read_file(run / "checkpoint.safetensors"), checkpoint);
  for (const auto& entry : fs::directory_iterator(run))
    EXPECT_THAT(
        entry.path().filename().string(),
        ::testing::AnyOf("config.json", "masks", "metrics.jsonl", "checkpoint.safetensors"));
  EXPECT_EQ(redrive({"resume", run.string()}).exit_code, kExitOk)
      << "and goes on once there is room";
  EXPECT_EQ(load_checkpoint(run / "checkpoint.safetensors").step, 60);
}

TEST_F(EndToEnd, FullDiskAtTheStartLeavesNoRun) {
  const ProgramResult ended = redrive(train_arguments(folder_ / "run", kLong), 10);
  EXPECT_EQ(ended.exit_code, kExitIo) << ended.err;
  for (const auto& entry : fs::directory_iterator(folder_)) EXPECT_EQ(entry.path(), drive_);
}

}  // namespace
}  // namespace redrive::testing
