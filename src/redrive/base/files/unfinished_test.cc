// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/unfinished.h"

#include <csignal>

#include <sys/wait.h>
#include <unistd.h>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/base/parallel.h"
#include "redrive/base/processes/interruption.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Unfinished : public ::testing::Test {
 protected:
  std::ptrdiff_t entries() const {
    return std::distance(fs::directory_iterator(folder_.path), fs::directory_iterator());
  }
  /// Runs `body` in a process of its own and returns how it ended, as waitpid does.
  template <class Body>
  static int status_of_process(const Body& body) {
    const pid_t child = fork();
    if (child == 0) {
      body();
      _exit(0);
    }
    int status = 0;
    EXPECT_EQ(waitpid(child, &status, 0), child);
    return status;
  }

  TemporaryFolder folder_;
  const fs::path place_ = folder_.path / "out";
};

TEST_F(Unfinished, TwoFilesForOnePlaceAreBothWhole) {
  UnfinishedFile first(place_), second(place_);
  EXPECT_NE(first.path(), second.path());
  first.write("1");
  second.write("2");
  first.write("1");
  second.finish();
  EXPECT_EQ(read_file(place_), "2");
  first.finish();
  EXPECT_EQ(read_file(place_), "11");
  EXPECT_EQ(entries(), 1);
}

TEST_F(Unfinished, NoLinkLeadsAFileOut) {
  const fs::path victim = folder_.path / "victim", temporary = UnfinishedFile(place_).path();
  write_file(victim, "precious");
  fs::create_symlink(victim, temporary);
  write_file(place_, "new");
  EXPECT_EQ(read_file(victim), "precious");
  EXPECT_EQ(read_file(place_), "new");
  EXPECT_FALSE(fs::is_symlink(place_));
  EXPECT_EQ(entries(), 2);
}

TEST_F(Unfinished, OneOfTwoFoldersIsRefusedWhileTheOtherIsWritten) {
  write_folder(place_, false, [&](const fs::path& folder) {
    write_file(folder / "a", "first");
    try {
      write_folder(place_, true, [](const fs::path&) { FAIL(); });
      ADD_FAILURE();
    } catch (const UsageError& error) {
      EXPECT_THAT(error.what(), HasSubstr("is being written by another process"));
    }
    EXPECT_TRUE(fs::exists(folder / "a"));
  });
  EXPECT_EQ(read_file(place_ / "a"), "first");
  EXPECT_EQ(entries(), 1);
}

TEST_F(Unfinished, AFolderThatAppearsMeanwhileIsKept) {
  EXPECT_THROW(write_folder(place_, false,
                            [&](const fs::path& folder) {
                              write_file(folder / "a", "late");
                              folder_.write("out/a", "early");
                            }),
               UsageError);
  EXPECT_EQ(read_file(place_ / "a"), "early");
  EXPECT_EQ(entries(), 1);
}

TEST_F(Unfinished, ReplacesAFolderOrALinkToOne) {
  const fs::path elsewhere = folder_.path / "elsewhere";
  folder_.write("elsewhere/a", "kept");
  folder_.write("out/b", "old");
  const auto fill = [](const fs::path& folder) { write_file(folder / "a", "new"); };
  write_folder(place_, true, fill);
  EXPECT_FALSE(fs::exists(place_ / "b"));
  fs::remove_all(place_);
  fs::create_directory_symlink(elsewhere, place_);
  write_folder(place_, true, fill);
  EXPECT_FALSE(fs::is_symlink(place_));
  EXPECT_EQ(read_file(place_ / "a"), "new");
  EXPECT_EQ(read_file(elsewhere / "a"), "kept");
  EXPECT_EQ(entries(), 2);
}

TEST_F(Unfinished, LinksAndLeftoversAreNoFolders) {
  const fs::path elsewhere = folder_.path / "elsewhere";
  folder_.write("elsewhere/a", "kept");
  const auto fill = [](const fs::path& folder) { write_file(folder / "a", "new"); };
  fs::path temporary;
  EXPECT_THROW(write_folder(place_, false,
                            [&](const fs::path& folder) {
                              temporary = folder;
                              throw Interrupted();
                            }),
               Interrupted);
  EXPECT_EQ(entries(), 1);
  fs::create_directory_symlink(elsewhere, temporary);
  write_folder(place_, false, fill);
  EXPECT_EQ(read_file(elsewhere / "a"), "kept");
  folder_.write(temporary / "b", "half");
  write_folder(place_, true, fill);
  EXPECT_FALSE(fs::exists(place_ / "b"));
  EXPECT_EQ(entries(), 2);
}

TEST_F(Unfinished, WhatAKilledProcessLeftIsRemoved) {
  const int status = status_of_process([&] {
    const UnfinishedFile file(folder_.path / "file");
    write_folder(place_, false, [](const fs::path&) { std::raise(SIGKILL); });
  });
  EXPECT_TRUE(WIFSIGNALED(status));
  EXPECT_EQ(entries(), 2);
  write_file(folder_.path / "file", "");
  write_folder(place_, false, [](const fs::path&) {});
  EXPECT_EQ(entries(), 2);
  EXPECT_TRUE(fs::exists(folder_.path / "file") && fs::exists(place_));
}

TEST_F(Unfinished, CtrlCEndsTheProcessAtOnce) {
  const int status = status_of_process([] {
    handle_signals();
    std::raise(SIGINT);
  });
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), kExitInterrupted);
}

TEST_F(Unfinished, CtrlCLeavesNoHalfFolder) {
  const int status = status_of_process([&] {
    handle_signals();
    try {
      write_folder(place_, false, [](const fs::path& folder) {
        ThreadPool pool(1);
        pool.run(2, [&](int chunk) {
          write_file(folder / std::to_string(chunk), "");
          std::raise(SIGINT);
        });
      });
    } catch (const Interrupted&) {
      _exit(7);
    }
  });
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 7);
  EXPECT_EQ(entries(), 0);
}

TEST_F(Unfinished, CtrlCAfterAFolderIsInItsPlaceEndsFurtherWorkAlone) {
  const int status = status_of_process([&] {
    handle_signals();
    write_folder(place_, false, [](const fs::path& folder) { write_file(folder / "a", ""); });
    std::raise(SIGINT);  // nothing but printing may be left
    try {
      ThreadPool(1).run(1, [](int) { _exit(8); });
    } catch (const Interrupted& error) {
      _exit(error.what() == std::string("interrupted; what is written is whole") ? 7 : 9);
    }
  });
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 7);
  EXPECT_EQ(entries(), 1);
}

TEST_F(Unfinished, ACallerMayLookAtTheFlag) {
  const int status = status_of_process([] {
    handle_signals();
    const std::atomic<bool>& stop = stop_on_signal();
    std::raise(SIGTERM);
    ThreadPool(1).run(1, [&](int) { _exit(stop ? 7 : 8); });
  });
  EXPECT_TRUE(WIFEXITED(status));
  EXPECT_EQ(WEXITSTATUS(status), 7);
}

}  // namespace
}  // namespace redrive
