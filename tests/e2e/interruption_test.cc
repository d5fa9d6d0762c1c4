// SPDX-License-Identifier: Apache-2.0
// kill -9, Ctrl-C, a closed pipe and a full disk while the program trains.
#include <signal.h>

#include "tests/e2e/same_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

/// A second of training. The tests wait for its first quarter at most, so that the program still
/// trains when it is killed.
const std::vector<std::string> kLong = {"--epochs",           "1000", "--max-steps", "700",
                                        "--checkpoint-every", "70"};

TEST_F(EndToEnd, KilledAndResumedEndsAsUninterrupted) {
  const fs::path whole = folder_ / "whole", parts = folder_ / "parts";
  ASSERT_EQ(redrive(train_arguments(whole, kLong)).exit_code, kExitOk);

  // 0: before the first checkpoint, perhaps.
  expect_same_end_when_killed(whole, parts, train_arguments(parts, kLong), {0, 3, 7});

  const auto before = contents(parts);
  const ProgramResult again = redrive({"resume", parts.string(), "--threads", "1"});
  EXPECT_EQ(again.exit_code, kExitOk) << "nothing is left to do";
  EXPECT_THAT(again.out, HasSubstr("is finished: step 700"));
  EXPECT_EQ(contents(parts), before);
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
