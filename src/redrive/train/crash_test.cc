// SPDX-License-Identifier: Apache-2.0
// A training is killed, or its disk is full or fails, at each of its calls that change the file
// system: it reports that, and resumes to the same result as an uninterrupted one.
//
// The program's own functions of these names come before the C library's.
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstdarg>
#include <cstdio>
#include <set>

#include "redrive/base/error.h"
#include "redrive/train/train_testing.h"

namespace {

enum class Fault { kNone, kKill, kKillInTheMiddle, kNoSpace, kNoDevice };

/// What a process does at its call number `at`, from 1. The counter is shared with its parent.
struct Injection {
  Fault fault = Fault::kNone;
  int at = 0;
  int* calls = nullptr;  ///< null: calls are not counted
};
Injection injection;

/// Counts a call. Returns whether it has to fail, with errno; kills the process where that is due.
bool fails() {
  if (!injection.calls || ++*injection.calls != injection.at) return false;
  if (injection.fault == Fault::kKill) std::raise(SIGKILL);
  if (injection.fault == Fault::kNoSpace) errno = ENOSPC;
  if (injection.fault == Fault::kNoDevice) errno = EIO;
  return injection.fault == Fault::kNoSpace || injection.fault == Fault::kNoDevice;
}

}  // namespace

extern "C" {

ssize_t write(int file, const void* bytes, size_t size) {
  if (fails()) return -1;
  if (injection.fault == Fault::kKillInTheMiddle && injection.calls &&
      *injection.calls == injection.at) {
    syscall(SYS_write, file, bytes, size / 2);
    std::raise(SIGKILL);
  }
  return syscall(SYS_write, file, bytes, size);
}

int open(const char* path, int flags, ...) {
  va_list rest;
  va_start(rest, flags);
  const mode_t mode = (flags & O_CREAT) != 0 ? va_arg(rest, mode_t) : 0;
  va_end(rest);
  if ((flags & O_CREAT) != 0 && fails()) return -1;
  return static_cast<int>(syscall(SYS_openat, AT_FDCWD, path, flags, mode));
}

int fsync(int) { return fails() ? -1 : 0; }  // a kill loses nothing that was written

int mkdir(const char* path, mode_t mode) noexcept {
  return fails() ? -1 : static_cast<int>(syscall(SYS_mkdirat, AT_FDCWD, path, mode));
}

int rename(const char* from, const char* to) noexcept {
  return fails() ? -1 : static_cast<int>(syscall(SYS_renameat, AT_FDCWD, from, AT_FDCWD, to));
}

int unlink(const char* path) noexcept {
  return fails() ? -1 : static_cast<int>(syscall(SYS_unlinkat, AT_FDCWD, path, 0));
}

}  // extern "C"

namespace redrive {
namespace {

namespace fs = std::filesystem;

class Crash : public ::testing::Test {
 protected:
  Crash()
      : calls_(static_cast<int*>(mmap(nullptr, sizeof(int), PROT_READ | PROT_WRITE,
                                      MAP_SHARED | MAP_ANONYMOUS, -1, 0))) {
    options_.checkpoint_every = 7;
    fs::create_directory(folder_.path / "images");
    recording_ = make_test_recording(folder_.path / "images", 2);
    scene_ = make_scene(recording_, scene_options(options_));
  }
  ~Crash() override { munmap(calls_, sizeof(int)); }

  /// Begins or resumes the run in a process of its own and returns how it ended, as waitpid does.
  int train_in_process(const fs::path& root, Fault fault = Fault::kNone, int at = 0) {
    *calls_ = 0;
    const pid_t child = fork();
    if (child == 0) {
      if (!std::freopen("/dev/null", "w", stdout)) _exit(1);
      _exit(train_here(root, {fault, at, calls_}));
    }
    int status = 0;
    EXPECT_EQ(waitpid(child, &status, 0), child);
    return status;
  }

  void expect_end(const fs::path& root, const std::string& where) const {
    EXPECT_TRUE(same_weights(load_checkpoint(RunPaths{root}.checkpoint()),
                             load_checkpoint(RunPaths{whole_}.checkpoint())))
        << where;
    EXPECT_EQ(steps_of(root), steps_of(whole_)) << where;
    EXPECT_EQ(names_in(root), names_in(whole_)) << where;
    EXPECT_EQ(names_in(folder_.path), (std::set<std::string>{"images", "run", "whole"})) << where;
  }

  TemporaryFolder folder_;
  const fs::path whole_ = folder_.path / "whole", run_ = folder_.path / "run";
  int* const calls_;

 private:
  /// Returns the exit code of the command.
  int train_here(const fs::path& root, const Injection& what) const {
    try {
      redrive::Run run;
      run.options = options_;
      run.recording = recording_;
      run.scene = scene_;
      run.state = make_initial_state(options_, scene_);
      run.paths = {root};
      const auto backend = processor_backend(1);
      injection = what;
      if (!fs::exists(root)) create_run(root, options_);
      if (fs::exists(run.paths.checkpoint())) run.state = load_checkpoint(run.paths.checkpoint());
      train(&run, *backend, never_);
      return kExitOk;
    } catch (const IoError&) {
      return kExitIo;
    } catch (const std::exception& error) {
      std::fprintf(stderr, "%s\n", error.what());
      return kExitInternal;
    }
  }

  static std::vector<std::pair<std::int64_t, double>> steps_of(const fs::path& root) {
    std::vector<std::pair<std::int64_t, double>> steps;
    for (const MetricsRow& row : read_metrics({root})) steps.emplace_back(row.step, row.loss);
    return steps;
  }
  static std::set<std::string> names_in(const fs::path& folder) {
    std::set<std::string> names;
    for (const auto& entry : fs::directory_iterator(folder))
      names.insert(entry.path().filename().string());
    return names;
  }

  TrainOptions options_ = tiny_options(19);
  Recording recording_;
  Scene scene_;
  const std::atomic<bool> never_{false};
};

TEST_F(Crash, AtEachCallEndsAsUninterrupted) {
  ASSERT_EQ(train_in_process(whole_), 0);
  const int calls = *calls_;
  ASSERT_GT(calls, 30);  // calls for a configuration, four checkpoints and two rows of metrics
  for (const Fault fault :
       {Fault::kKill, Fault::kKillInTheMiddle, Fault::kNoSpace, Fault::kNoDevice})
    for (int at = 1; at <= calls; ++at) {
      const std::string where =
          "fault " + std::to_string(static_cast<int>(fault)) + " at call " + std::to_string(at);
      const int status = train_in_process(run_, fault, at);
      if (fault == Fault::kKill) {
        EXPECT_TRUE(WIFSIGNALED(status)) << where;
      } else if (!WIFSIGNALED(status)) {
        EXPECT_TRUE(WEXITSTATUS(status) == kExitIo || WEXITSTATUS(status) == kExitOk) << where;
      }
      const bool is_no_write = fault == Fault::kKillInTheMiddle && status == 0;
      ASSERT_EQ(is_no_write ? 0 : train_in_process(run_), 0) << where;
      expect_end(run_, where);
      fs::remove_all(run_);
    }
}

}  // namespace
}  // namespace redrive
