// SPDX-License-Identifier: Apache-2.0
// Drives divided into blocks: trained by one process and by the processes of mpirun, killed and
// resumed.
#include <signal.h>
#include <unistd.h>

#include <charconv>
#include <random>

#include "redrive/train/files/blocks.h"
#include "redrive/train/files/seam_exposure.h"
#include "tests/e2e/same_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

/// The tiny drive is 0.6 m long.
constexpr const char* kTwoBlocks = "0.35";
constexpr const char* kFourBlocks = "0.11";

class BlocksEndToEnd : public EndToEnd {
 protected:
  std::vector<std::string> block_arguments(const fs::path& run, const std::string& blocks,
                                           int steps = 200) const {
    return train_arguments(run, {"--epochs", "1000", "--max-steps", std::to_string(steps),
                                 "--checkpoint-every", "50", "--blocks", blocks});
  }

  /// Arguments of mpirun for `processes` that run `arguments`.
  static std::vector<std::string> launched(int processes,
                                           const std::vector<std::string>& arguments) {
    std::vector<std::string> all = {"--allow-run-as-root", "--oversubscribe", "-n",
                                    std::to_string(processes), REDRIVE_BINARY};
    all.insert(all.end(), arguments.begin(), arguments.end());
    return all;
  }

  static void expect_same_blocks(const fs::path& a, const fs::path& b) {
    const std::vector<Block> blocks = read_blocks(a);
    EXPECT_EQ(blocks_text(blocks), blocks_text(read_blocks(b)));
    EXPECT_EQ(read_file(a / "config.json"), read_file(b / "config.json"));
    EXPECT_EQ(read_file(exposure_file(a)), read_file(exposure_file(b)));
    for (const Block& block : blocks) {
      EXPECT_TRUE(block.finished) << block.name;
      EXPECT_EQ(read_file(block_folder(a, block) / "config.json"),
                read_file(block_folder(b, block) / "config.json"));
      expect_same_end(block_folder(a, block), block_folder(b, block));
    }
  }
};

TEST_F(BlocksEndToEnd, EachBlockIsTheRunOfItsFrames) {
  const fs::path run = folder_ / "run";
  const ProgramResult ended = redrive(block_arguments(run, kTwoBlocks));
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("finished: 2 blocks; " + run.string()));
  EXPECT_EQ(read_json(run / "blocks/000/config.json").at("frames"), "100:101");
  EXPECT_EQ(read_json(run / "blocks/001/config.json").at("frames"), "101:103");
  EXPECT_EQ(read_json(run / "config.json").at("frames"), "");
  EXPECT_EQ(fs::read_symlink(run / "blocks/000/masks"), "../../masks");
  EXPECT_EQ(read_seam_exposure(run, 2).cameras.size(), 3u);

  const fs::path alone = folder_ / "alone";
  const ProgramResult trained =
      redrive(train_arguments(alone, {"--epochs", "1000", "--max-steps", "200", "--frames",
                                      "101:103", "--checkpoint-every", "50"}));
  ASSERT_EQ(trained.exit_code, kExitOk) << trained.err;
  expect_same_end(run / "blocks/001", alone);

  fs::copy(run / "blocks/001", folder_ / "copied",
           fs::copy_options::copy_symlinks | fs::copy_options::recursive);
  const ProgramResult copied = redrive({"eval", (folder_ / "copied").string()});
  EXPECT_EQ(copied.exit_code, kExitBadInput);
  EXPECT_THAT(copied.err, HasSubstr("copied/masks: links to a folder that is not there"));

  fs::rename(run, folder_ / "moved");
  EXPECT_EQ(redrive({"resume", (folder_ / "moved/blocks/001").string()}).exit_code, kExitOk);
}

TEST_F(BlocksEndToEnd, AShortDriveIsOneRunAsWithoutTheOption) {
  const fs::path divided = folder_ / "divided", plain = trained("plain", 30);
  const ProgramResult ended = redrive(
      train_arguments(divided, {"--epochs", "1000", "--max-steps", "30", "--blocks", "auto"}));
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  expect_same_end(divided, plain);
  EXPECT_EQ(read_file(divided / "config.json"), read_file(plain / "config.json"));
  std::vector<std::string> names[2];
  for (const auto& entry : fs::directory_iterator(divided))
    names[0].push_back(entry.path().filename());
  for (const auto& entry : fs::directory_iterator(plain))
    names[1].push_back(entry.path().filename());
  EXPECT_THAT(names[0], ::testing::UnorderedElementsAreArray(names[1]));
}

TEST_F(BlocksEndToEnd, KilledAndResumedEndsAsUninterrupted) {
  const fs::path whole = folder_ / "whole", parts = folder_ / "parts";
  ASSERT_EQ(redrive(block_arguments(whole, kTwoBlocks)).exit_code, kExitOk);
  // Killed in the block that is trained first, the longer one, and in the other.
  for (const char* block : {"001", "000"}) {
    Program program(REDRIVE_BINARY, fs::exists(parts)
                                        ? std::vector<std::string>{"resume", parts.string()}
                                        : block_arguments(parts, kTwoBlocks));
    ASSERT_TRUE(wait_for_rows(parts / "blocks" / block, 3));
    program.send(SIGKILL);
    EXPECT_EQ(program.wait().signal, SIGKILL);
  }
  const ProgramResult ended = redrive({"resume", parts.string()});
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.err;
  expect_same_blocks(whole, parts);

  const ProgramResult again = redrive({"resume", parts.string()});
  EXPECT_EQ(again.exit_code, kExitOk) << "nothing is left to do";
  EXPECT_THAT(again.out, HasSubstr("2 blocks, 2 of them finished"));
  expect_same_blocks(whole, parts);

  Program more(REDRIVE_BINARY, {"resume", parts.string(), "--max-steps", "100000"});
  for (int i = 0; i < 1000 && fs::exists(exposure_file(parts)); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  more.send(SIGKILL);
  more.wait();
  EXPECT_FALSE(fs::exists(exposure_file(parts))) << "it is that of other fields";
  EXPECT_EQ(redrive({"resume", parts.string(), "--max-steps", "210"}).exit_code, kExitOk);
  EXPECT_TRUE(fs::exists(exposure_file(parts)));
  for (const char* block : {"000", "001"})
    EXPECT_GE(load_checkpoint(parts / "blocks" / block / "checkpoint.safetensors").step, 210);
}

TEST_F(BlocksEndToEnd, CtrlCSavesAndPrintsHowToGoOn) {
  const fs::path whole = folder_ / "whole", parts = folder_ / "parts";
  ASSERT_EQ(redrive(block_arguments(whole, kTwoBlocks)).exit_code, kExitOk);
  Program program(REDRIVE_BINARY, block_arguments(parts, kTwoBlocks));
  ASSERT_TRUE(wait_for_rows(parts / "blocks/001", 2));
  program.send(SIGINT);
  const ProgramResult ended = program.wait();
  EXPECT_EQ(ended.exit_code, kExitInterrupted);
  EXPECT_THAT(ended.err, HasSubstr("0 of 2 blocks are finished; go on with: redrive resume " +
                                   parts.string()));
  EXPECT_EQ(redrive({"resume", parts.string()}).exit_code, kExitOk);
  expect_same_blocks(whole, parts);
}

TEST_F(BlocksEndToEnd, AnErrorNamesItsBlock) {
  std::vector<std::string> arguments = block_arguments(folder_ / "run", kTwoBlocks);
  arguments.insert(arguments.end(), {"--masks", "none"});
  const ProgramResult ended = redrive(arguments, /*file_limit_bytes=*/20'000);  // no checkpoint
  EXPECT_EQ(ended.exit_code, kExitIo) << ended.out;
  EXPECT_THAT(ended.err, HasSubstr("redrive: block 00"));
  EXPECT_THAT(ended.err, HasSubstr("0 of 2 blocks are finished"));
}

TEST_F(BlocksEndToEnd, RefusesWhatCannotBeDivided) {
  const auto refusal = [&](const std::vector<std::string>& more) {
    const ProgramResult ended = redrive(train_arguments(folder_ / "run", more));
    EXPECT_EQ(ended.exit_code, kExitUsage) << ended.out;
    EXPECT_FALSE(fs::exists(folder_ / "run"));
    return ended.err;
  };
  EXPECT_THAT(refusal({"--blocks", "0"}), HasSubstr("--blocks 0: must be auto, or metres above 0"));
  EXPECT_THAT(refusal({"--blocks", "8m"}), HasSubstr("--blocks 8m"));
  EXPECT_THAT(refusal({"--blocks", kTwoBlocks, "--refine-poses", "on"}),
              HasSubstr("--refine-poses on"));
  EXPECT_THAT(refusal({"--blocks", kTwoBlocks, "--view"}), HasSubstr("--view"));
  EXPECT_THAT(refusal({"--blocks", kTwoBlocks, "--memory", "1"}), HasSubstr("--memory 1"));
}

#ifdef REDRIVE_MPIRUN

bool has_mpirun() { return ::access(REDRIVE_MPIRUN, X_OK) == 0; }

/// Processes of the program whose arguments hold `text`, without mpirun.
std::vector<pid_t> processes_with(const std::string& text) {
  std::vector<pid_t> found;
  for (const auto& entry : fs::directory_iterator("/proc")) {
    const std::string name = entry.path().filename();
    pid_t pid = 0;
    if (std::from_chars(name.data(), name.data() + name.size(), pid).ec != std::errc()) continue;
    std::error_code error;
    if (fs::read_symlink(entry.path() / "exe", error) != fs::canonical(REDRIVE_BINARY)) continue;
    try {
      if (read_file(entry.path() / "cmdline").find(text) != std::string::npos) found.push_back(pid);
    } catch (const InputError&) {  // has ended
    }
  }
  return found;
}

TEST_F(BlocksEndToEnd, TwoProcessesOfMpirunTrainTheSame) {
  if (!has_mpirun()) GTEST_SKIP() << "there is no mpirun";
  const fs::path one = folder_ / "one", two = folder_ / "two";
  ASSERT_EQ(redrive(block_arguments(one, kFourBlocks)).exit_code, kExitOk);
  const ProgramResult ended =
      Program(REDRIVE_MPIRUN, launched(2, block_arguments(two, kFourBlocks))).wait();
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  expect_same_blocks(one, two);
  EXPECT_THAT(ended.out, HasSubstr("2 processes, 2 on this machine"));
  for (const char* block : {"000", "001", "002", "003"})
    EXPECT_THAT(ended.out, HasSubstr(std::string(block) + ": block " + block + " finished"));
  EXPECT_THAT(ended.out, Not(HasSubstr("\033"))) << "progress as lines";
}

TEST_F(BlocksEndToEnd, AKilledProcessCostsNothingButItsLastSteps) {
  if (!has_mpirun()) GTEST_SKIP() << "there is no mpirun";
  const fs::path one = folder_ / "one", four = folder_ / "four";
  ASSERT_EQ(redrive(block_arguments(one, kFourBlocks)).exit_code, kExitOk);
  Program program(REDRIVE_MPIRUN, launched(4, block_arguments(four, kFourBlocks)));
  ASSERT_TRUE(wait_for_rows(four / "blocks/002", 3));
  const std::vector<pid_t> processes = processes_with(four.string());
  ASSERT_FALSE(processes.empty());
  kill(processes[std::random_device()() % processes.size()], SIGKILL);
  EXPECT_NE(program.wait().exit_code, kExitOk);
  const ProgramResult ended =
      Program(REDRIVE_MPIRUN, launched(2, {"resume", four.string()})).wait();
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  expect_same_blocks(one, four);
}

TEST_F(BlocksEndToEnd, TwoProcessesTrainOneRunTogether) {
  if (!has_mpirun()) GTEST_SKIP() << "there is no mpirun";
  const fs::path whole = folder_ / "whole", again = folder_ / "again";
  const auto arguments = [&](const fs::path& run, int max_steps) {
    return launched(
        2, train_arguments(run, {"--epochs", "1000", "--max-steps", std::to_string(max_steps),
                                 "--checkpoint-every", "50", "--data-parallel"}));
  };
  // Long enough to be killed while it trains.
  const int steps = 500;
  const ProgramResult ended = Program(REDRIVE_MPIRUN, arguments(whole, steps)).wait();
  ASSERT_EQ(ended.exit_code, kExitOk) << ended.out << ended.err;
  EXPECT_THAT(ended.out, HasSubstr("2 processes compute each step together"));
  const std::size_t first = ended.out.find("finished: step 500");
  ASSERT_NE(first, std::string::npos) << ended.out;
  EXPECT_EQ(ended.out.find("finished: step", first + 1), std::string::npos) << "it is one run";

  Program killed(REDRIVE_MPIRUN, arguments(again, steps));
  ASSERT_TRUE(wait_for_rows(again, 3));
  const std::vector<pid_t> processes = processes_with(again.string());
  ASSERT_FALSE(processes.empty());
  kill(processes[0], SIGKILL);
  EXPECT_NE(killed.wait().exit_code, kExitOk);
  const ProgramResult resumed =
      Program(REDRIVE_MPIRUN, launched(2, {"resume", again.string(), "--data-parallel"})).wait();
  ASSERT_EQ(resumed.exit_code, kExitOk) << resumed.out << resumed.err;
  expect_same_end(whole, again);

  // Twice the rays of a step make other steps than one process.
  const fs::path alone = trained("alone", steps);
  EXPECT_FALSE(bit_equal(load_checkpoint(alone / "checkpoint.safetensors").model->parameters,
                         load_checkpoint(whole / "checkpoint.safetensors").model->parameters));
}

TEST_F(BlocksEndToEnd, ArgumentsThatCannotBeParsedAreSaidOnce) {
  if (!has_mpirun()) GTEST_SKIP() << "there is no mpirun";
  for (const auto& [argument, message] :
       {std::pair<const char*, const char*>{"train", "RECORDING is required"},
        {"no-such-command", "redrive no-such-command: is not a command"}}) {
    const ProgramResult ended = Program(REDRIVE_MPIRUN, launched(3, {argument})).wait();
    EXPECT_EQ(ended.exit_code, kExitUsage) << ended.err;
    const std::size_t first = ended.err.find(message);
    ASSERT_NE(first, std::string::npos) << ended.err;
    EXPECT_EQ(ended.err.find(message, first + 1), std::string::npos) << ended.err;
  }
}

TEST_F(BlocksEndToEnd, AnErrorEndsAllProcessesWithOneMessage) {
  if (!has_mpirun()) GTEST_SKIP() << "there is no mpirun";
  const ProgramResult ended =
      Program(REDRIVE_MPIRUN, launched(3, block_arguments(folder_ / "run", "0"))).wait();
  EXPECT_EQ(ended.exit_code, kExitUsage);
  const std::size_t first = ended.err.find("redrive: --blocks 0");
  ASSERT_NE(first, std::string::npos) << ended.err;
  EXPECT_EQ(ended.err.find("redrive: --blocks 0", first + 1), std::string::npos);

  const ProgramResult one_run =
      Program(REDRIVE_MPIRUN, launched(2, train_arguments(folder_ / "run"))).wait();
  EXPECT_EQ(one_run.exit_code, kExitUsage);
  EXPECT_THAT(one_run.err, HasSubstr("--blocks METRES divides it; or one run together"));
  EXPECT_FALSE(fs::exists(folder_ / "run"));
}

#else

TEST_F(BlocksEndToEnd, TwoProcessesOfMpirunTrainTheSame) {
  GTEST_SKIP() << "built without MPI (libopenmpi-dev)";
}

#endif

}  // namespace
}  // namespace redrive::testing
