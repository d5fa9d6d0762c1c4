// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/processes/interruption.h"

#include <signal.h>
#include <unistd.h>

#include <mutex>
#include <string_view>

#include "redrive/base/error.h"
#include "redrive/base/files/unfinished.h"

namespace redrive {
namespace {

std::atomic<bool> stop{false}, caller_looks{false};
std::atomic<int> finished_before{0};  // the program's start
static_assert(std::atomic<bool>::is_always_lock_free);

bool has_finished() { return finished_count() > finished_before; }

/// Calls only functions that a signal handler may call.
void on_signal(int) {
  stop = true;
  if (caller_looks || has_unfinished() || has_finished()) return;
  constexpr std::string_view kMessage = "redrive: interrupted, nothing written\n";
  [[maybe_unused]] const ssize_t written = ::write(STDERR_FILENO, kMessage.data(), kMessage.size());
  ::_exit(kExitInterrupted);
}

}  // namespace

void handle_signals() {
  finished_before = finished_count();
  struct sigaction action {};
  action.sa_handler = on_signal;
  action.sa_flags = SA_RESTART | static_cast<int>(SA_RESETHAND);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
  action.sa_flags = SA_RESTART;
  sigaction(SIGUSR1, &action, nullptr);
  // A closing terminal sends SIGHUP twice: by the shell and by the kernel.
  struct sigaction before {};
  sigaction(SIGHUP, nullptr, &before);
  if (before.sa_handler != SIG_IGN) sigaction(SIGHUP, &action, nullptr);  // not under nohup
  signal(SIGPIPE, SIG_IGN);
  signal(SIGXFSZ, SIG_IGN);
}

const std::atomic<bool>& stop_on_signal() {
  caller_looks = true;
  return stop;
}

void request_stop() { stop = true; }

namespace {

std::mutex lending;
int calls = 0, lookers = 0;
struct sigaction lender {};

}  // namespace

InterruptibleCall::InterruptibleCall(bool looks) : looks_(looks) {
  const std::lock_guard lock(lending);
  lookers += looks;
  caller_looks = lookers > 0;
  if (calls++ > 0) return;
  stop = false;
  struct sigaction action {};
  action.sa_handler = [](int) { stop = true; };
  action.sa_flags = SA_RESTART;
  sigaction(SIGINT, &action, &lender);
}

InterruptibleCall::~InterruptibleCall() {
  const std::lock_guard lock(lending);
  lookers -= looks_;
  caller_looks = lookers > 0;
  if (--calls > 0) return;
  sigaction(SIGINT, &lender, nullptr);
  if (stop.exchange(false)) ::raise(SIGINT);
}

const std::atomic<bool>& InterruptibleCall::came() { return stop; }

void check_interruption() {
  if (!stop.load(std::memory_order_relaxed) || caller_looks) return;
  if (has_finished()) throw Interrupted("interrupted; what is written is whole");
  throw Interrupted();
}

}  // namespace redrive
