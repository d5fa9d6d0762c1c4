// SPDX-License-Identifier: Apache-2.0
// Progress of work that may take seconds, on standard error: on a terminal one line that is
// updated, with a bar and the time left; elsewhere a line every 5 s.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

namespace redrive {

/// What is being done.
struct ProgressNews {
  std::string text;             ///< the line of a pipe; empty where nothing takes time
  std::optional<double> share;  ///< the share that is done, where it is known
};

/// Shows work while it lives: the latest Progress alive. A thread of its own prints, so that there
/// is output however long a part takes.
class Progress {
 public:
  /// `what`: the work, "decoding images". `total`: number of its parts, which are counted; 0: shows
  /// the elapsed time instead.
  explicit Progress(std::string what, std::int64_t total = 0);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  void count(std::int64_t parts = 1) { done_ += parts; }  ///< from any thread
  void show(std::string text);  ///< shows the caller's own line in place of the parts
  void print();                 ///< prints that line, if any, permanently

  static ProgressNews latest();  ///< returns the work that a terminal would show

  /// From now on output is lines only, as into a pipe. `prefix`: returns the beginning of the
  /// calling thread's lines.
  static void use_lines(std::string (*prefix)());

 private:
  friend class ProgressDisplay;
  std::string text(bool terminal, double now_s) const;
  std::optional<double> share() const;

  const std::string what_, prefix_;
  const std::int64_t total_;
  std::atomic<std::int64_t> done_{0};
  std::string own_;
  double began_s_ = 0;
  bool announced_ = false;
};

/// While it lives, output of stdio on a terminal replaces a line of progress there.
class TerminalOutput {
 public:
  TerminalOutput();
  ~TerminalOutput();
  TerminalOutput(const TerminalOutput&) = delete;
  TerminalOutput& operator=(const TerminalOutput&) = delete;
};

/// Returns "decoding images  [######..............]  30 %  0:14 left" for a terminal, "decoding
/// images: 30 of 100, 0:14 left" elsewhere; with the time so far where total is 0 or nothing is
/// done.
std::string progress_text(const std::string& what, std::int64_t done, std::int64_t total,
                          double seconds, bool terminal);
/// Whether a line is due in a pipe: 2 s after work began without one, and 5 s after the last.
bool progress_line_due(double now_s, double last_line_s, double began_s, bool announced);

}  // namespace redrive
