// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/progress.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/base/wrapped_text.h"

namespace redrive {
namespace {

constexpr double kFirstLine_s = 2, kLine_s = 5;     // in a pipe
constexpr double kDrawn_s = 0.5, kRedrawn_s = 0.2;  // on a terminal

double now_s() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

std::string clock_text(double seconds) {
  const auto s = static_cast<long long>(std::ceil(std::clamp(seconds, 0.0, 1e9)));
  char text[40];
  if (s < 3600)
    std::snprintf(text, sizeof text, "%lld:%02lld", s / 60, s % 60);
  else
    std::snprintf(text, sizeof text, "%lld:%02lld:%02lld", s / 3600, s / 60 % 60, s % 60);
  return text;
}

void write_bytes(int to, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(to, bytes.data(), bytes.size());
    if (n <= 0) return;  // output that nobody reads ends no work
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
}

}  // namespace

std::string progress_text(const std::string& what, std::int64_t done, std::int64_t total,
                          double seconds, bool terminal) {
  constexpr int kBar = 20;
  constexpr double kLeast_s = 1;  // before that, a rate means little
  char text[120];
  if (total <= 0 || done <= 0) {
    std::snprintf(text, sizeof text, terminal ? "  %s" : ": %s so far",
                  clock_text(seconds).c_str());
    return what + text;
  }
  const double share = std::min(1.0, static_cast<double>(done) / static_cast<double>(total));
  std::string left;
  if (seconds >= kLeast_s) left = clock_text(seconds * (1 - share) / share) + " left";
  if (!terminal)
    return what + ": " + std::to_string(done) + " of " + std::to_string(total) +
           (left.empty() ? "" : ", " + left);
  const int full = static_cast<int>(share * kBar);
  std::snprintf(text, sizeof text, "  [%s%s] %3.0f %%  %s", std::string(full, '#').c_str(),
                std::string(kBar - full, '.').c_str(), std::floor(100 * share), left.c_str());
  return what + text;
}

bool progress_line_due(double now_s, double last_line_s, double began_s, bool announced) {
  return now_s - last_line_s >= kLine_s || (!announced && now_s - began_s >= kFirstLine_s);
}

namespace {

/// Returns the width of a terminal; 0: unknown.
std::size_t columns_of(int terminal) {
  winsize size{};
  return ioctl(terminal, TIOCGWINSZ, &size) == 0 ? size.ws_col : 0;
}

/// Breaks lines that are longer than a terminal is wide between words.
std::string short_lines(int terminal, std::string_view text) {
  constexpr std::size_t kLeastColumns = 40;
  const std::size_t columns = columns_of(terminal);
  return columns < kLeastColumns ? std::string(text) : with_short_lines(text, columns);
}

}  // namespace

/// The line on the terminal, and the thread that draws it.
class ProgressDisplay {
 public:
  static ProgressDisplay& get() {
    static ProgressDisplay* const display = new ProgressDisplay;  // outlives everything that prints
    return *display;
  }

  std::string prefix() {
    const std::lock_guard lock(mutex_);
    return prefix_ ? prefix_() : "";
  }

  void begin(Progress* progress) {
    const std::lock_guard lock(mutex_);
    if (alive_.empty()) last_line_s_ = progress->began_s_;
    alive_.push_back(progress);
    if (alive_.size() == 1) thread_ = std::thread([this, work = ++work_] { draw_until_end(work); });
  }

  void end(Progress* progress) {
    std::thread last;
    {
      const std::lock_guard lock(mutex_);
      std::erase(alive_, progress);
      erase_line();
      if (alive_.empty()) last = std::move(thread_);
    }
    if (!last.joinable()) return;
    changed_.notify_all();
    last.join();
  }

  void show(Progress* progress, std::string text) {
    const std::lock_guard lock(mutex_);
    progress->own_ = std::move(text);
  }

  void print(Progress* progress) {
    const std::lock_guard lock(mutex_);
    erase_line();
    if (progress->own_.empty()) return;
    if (terminal_)
      write_bytes(STDERR_FILENO, short_lines(STDERR_FILENO, progress->own_ + "\n"));
    else
      print_line(progress);
  }

  ProgressNews latest() {
    const std::lock_guard lock(mutex_);
    const double now = now_s();
    const Progress* const progress = latest_since(now - kDrawn_s);
    if (!progress) return {};
    return {progress->text(false, now), progress->share()};
  }

  void use_lines(std::string (*prefix)()) {
    const std::lock_guard lock(mutex_);
    terminal_ = false;
    prefix_ = prefix;
  }

  /// Writes stdio's output to a terminal.
  void write_to(int to, std::string_view bytes) {
    const std::lock_guard lock(mutex_);
    erase_line();
    write_bytes(to, line_is_open_ ? std::string(bytes) : short_lines(to, bytes));
    if (!bytes.empty()) line_is_open_ = bytes.back() != '\n';
  }

 private:
  void draw_until_end(int work) {
    std::unique_lock lock(mutex_);
    while (true) {
      if (alive_.empty() || work != work_) return;
      draw();
      changed_.wait_for(lock, std::chrono::duration<double>(kRedrawn_s));
    }
  }

  /// Returns the latest work that began before then, or null: short parts of longer work would
  /// only flicker.
  Progress* latest_since(double then_s) const {
    const auto found = std::find_if(alive_.rbegin(), alive_.rend(), [&](const Progress* progress) {
      return progress->began_s_ <= then_s;
    });
    return found == alive_.rend() ? nullptr : *found;
  }

  /// Draws the latest work that has taken some time.
  void draw() {
    const double now = now_s();
    Progress* const progress = latest_since(now - (terminal_ ? kDrawn_s : kFirstLine_s));
    if (!progress) return;
    if (!terminal_) {
      if (progress_line_due(now, last_line_s_, progress->began_s_, progress->announced_))
        print_line(progress);
    } else if (!line_is_open_) {
      std::string line = progress->text(true, now);
      if (const std::size_t columns = columns_of(STDERR_FILENO); columns > 1)
        line.resize(std::min(line.size(), columns - 1));
      write_bytes(STDERR_FILENO, "\r" + line + "\033[K");
      is_drawn_ = true;
    }
  }

  void print_line(Progress* progress) {
    last_line_s_ = now_s();
    progress->announced_ = true;
    std::fprintf(stderr, "%s%s\n", progress->prefix_.c_str(),
                 progress->text(false, last_line_s_).c_str());
    std::fflush(stderr);
  }

  void erase_line() {
    if (is_drawn_) write_bytes(STDERR_FILENO, "\r\033[K");
    is_drawn_ = false;
  }

  std::mutex mutex_;
  std::condition_variable changed_;
  std::thread thread_;
  std::vector<Progress*> alive_;
  int work_ = 0;  // counts the threads: one may end while the next begins
  bool terminal_ = isatty(STDERR_FILENO) == 1;
  bool is_drawn_ = false, line_is_open_ = false;
  double last_line_s_ = 0;
  std::string (*prefix_)() = nullptr;
};

Progress::Progress(std::string what, std::int64_t total)
    : what_(std::move(what)),
      prefix_(ProgressDisplay::get().prefix()),
      total_(total),
      began_s_(now_s()) {
  ProgressDisplay::get().begin(this);
}

Progress::~Progress() { ProgressDisplay::get().end(this); }

void Progress::show(std::string text) { ProgressDisplay::get().show(this, std::move(text)); }

void Progress::print() { ProgressDisplay::get().print(this); }

ProgressNews Progress::latest() { return ProgressDisplay::get().latest(); }

void Progress::use_lines(std::string (*prefix)()) { ProgressDisplay::get().use_lines(prefix); }

std::string Progress::text(bool terminal, double now_s) const {
  return own_.empty() ? progress_text(what_, done_, total_, now_s - began_s_, terminal) : own_;
}

std::optional<double> Progress::share() const {
  if (total_ <= 0 || !own_.empty()) return std::nullopt;
  return std::min(1.0, static_cast<double>(done_) / static_cast<double>(total_));
}

namespace {

/// Makes a stream of stdio that writes to a terminal through the display; elsewhere returns the
/// stream itself.
FILE* through_display(FILE* stream, int to) {
  if (isatty(to) != 1) return stream;
  std::fflush(stream);
  cookie_io_functions_t functions{};
  functions.write = [](void* fd, const char* bytes, std::size_t size) {
    ProgressDisplay::get().write_to(static_cast<int>(reinterpret_cast<std::intptr_t>(fd)),
                                    {bytes, size});
    return static_cast<ssize_t>(size);
  };
  FILE* const own = fopencookie(reinterpret_cast<void*>(std::intptr_t{to}), "w", functions);
  REDRIVE_CHECK(own != nullptr);
  std::setvbuf(own, nullptr, _IOLBF, BUFSIZ);
  return own;
}

}  // namespace

TerminalOutput::TerminalOutput() {
  stdout = through_display(stdout, STDOUT_FILENO);
  stderr = through_display(stderr, STDERR_FILENO);
}

TerminalOutput::~TerminalOutput() {
  std::fflush(stdout);
  std::fflush(stderr);
}

}  // namespace redrive
