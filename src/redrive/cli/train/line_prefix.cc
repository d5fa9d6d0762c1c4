// SPDX-License-Identifier: Apache-2.0
#include "redrive/cli/train/line_prefix.h"

#include <fcntl.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <mutex>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"

namespace redrive {
namespace {

std::string& prefix_of_thread() {
  thread_local std::string prefix;
  return prefix;
}

std::atomic<bool> silent_output{false};

}  // namespace

struct PrefixedOutput::Stream {
  Stream(FILE** stream, int to) : stream_(stream), before_(*stream), to_(to) {
    std::fflush(before_);
    cookie_io_functions_t functions{};
    functions.write = [](void* self, const char* bytes, std::size_t size) {
      return static_cast<Stream*>(self)->write({bytes, size});
    };
    FILE* const own = fopencookie(this, "w", functions);
    REDRIVE_CHECK(own != nullptr);
    std::setvbuf(own, nullptr, _IOLBF, BUFSIZ);
    *stream_ = own;
  }
  ~Stream() {
    std::fclose(*stream_);
    *stream_ = before_;
    if (!rest_.empty()) write("\n");
    ::close(to_);
  }

  /// Writes the complete lines, each by one call, so that lines of several processes do not mix.
  ssize_t write(std::string_view bytes) {
    const std::lock_guard lock(mutex_);
    rest_ += bytes;
    for (std::size_t end; (end = rest_.find('\n')) != std::string::npos; rest_.erase(0, end + 1)) {
      if (silent_output) continue;
      const std::string line = prefix_of_thread() + rest_.substr(0, end + 1);
      for (std::size_t at = 0; at < line.size();) {
        const ssize_t n = ::write(to_, line.data() + at, line.size() - at);
        if (n <= 0) break;  // a closed pipe ends no training
        at += static_cast<std::size_t>(n);
      }
    }
    return static_cast<ssize_t>(bytes.size());
  }

 private:
  FILE** stream_;
  FILE* before_;
  int to_;
  std::mutex mutex_;
  std::string rest_;
};

PrefixedOutput::PrefixedOutput()
    : out_(std::make_unique<Stream>(&stdout, ::dup(STDOUT_FILENO))),
      err_(std::make_unique<Stream>(&stderr, ::dup(STDERR_FILENO))) {
  Progress::use_lines([] { return prefix_of_thread(); });
  // A check whether standard output is a terminal gets the right answer.
  const int nothing = ::open("/dev/null", O_WRONLY | O_CLOEXEC);
  if (nothing >= 0) {
    standard_output_ = ::dup(STDOUT_FILENO);
    ::dup2(nothing, STDOUT_FILENO);
    ::close(nothing);
  }
}

PrefixedOutput::~PrefixedOutput() {
  if (standard_output_ >= 0) {
    ::dup2(standard_output_, STDOUT_FILENO);
    ::close(standard_output_);
  }
  out_.reset();
  err_.reset();
}

void PrefixedOutput::set_prefix(const std::string& prefix) { prefix_of_thread() = prefix; }

void PrefixedOutput::set_silent(bool silent) { silent_output = silent; }

}  // namespace redrive
