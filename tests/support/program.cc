// SPDX-License-Identifier: Apache-2.0
#include "tests/support/program.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <stdexcept>

#include "redrive/base/files/files.h"

namespace redrive::testing {
namespace {

/// Runs between fork and exec, so it makes system calls only.
[[noreturn]] void run_child(const char* binary, char* const* arguments, const char* out,
                            const char* err, const std::optional<std::size_t>& file_limit_bytes) {
  dup2(open(out, O_WRONLY | O_CREAT | O_TRUNC, 0600), STDOUT_FILENO);
  dup2(open(err, O_WRONLY | O_CREAT | O_TRUNC, 0600), STDERR_FILENO);
  if (file_limit_bytes) {
    signal(SIGXFSZ, SIG_IGN);  // a write fails in place of the process
    const rlimit limit{*file_limit_bytes, *file_limit_bytes};
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  execv(binary, arguments);
  _exit(127);
}

}  // namespace

Program::Program(const std::filesystem::path& binary, const std::vector<std::string>& arguments,
                 std::optional<std::size_t> file_limit_bytes) {
  std::string folder = (std::filesystem::temp_directory_path() / "redrive-program-XXXXXX").string();
  if (!mkdtemp(folder.data())) throw std::runtime_error("mkdtemp");
  folder_ = folder;
  const std::string name = binary.string(), out = folder + "/out", err = folder + "/err";
  std::vector<char*> argv = {const_cast<char*>(name.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  pid_ = fork();
  if (pid_ == 0) run_child(name.c_str(), argv.data(), out.c_str(), err.c_str(), file_limit_bytes);
  if (pid_ < 0) throw std::runtime_error("fork");
}

Program::~Program() {
  if (pid_ > 0) {
    send(SIGKILL);
    wait();
  }
  std::filesystem::remove_all(folder_);
}

bool Program::wait_for_output(const std::string& text) const {
  for (int i = 0; i < 3000; ++i) {
    if (std::filesystem::exists(folder_ / "out") &&
        read_file(folder_ / "out").find(text) != std::string::npos)
      return true;
    usleep(20000);
  }
  return false;
}

void Program::send(int signal) { kill(pid_, signal); }

ProgramResult Program::wait() {
  int status = 0;
  if (waitpid(pid_, &status, 0) != pid_) throw std::runtime_error("waitpid");
  pid_ = -1;
  ProgramResult ended;
  if (WIFEXITED(status)) ended.exit_code = WEXITSTATUS(status);
  if (WIFSIGNALED(status)) ended.signal = WTERMSIG(status);
  ended.out = read_file(folder_ / "out");
  ended.err = read_file(folder_ / "err");
  return ended;
}

}  // namespace redrive::testing
