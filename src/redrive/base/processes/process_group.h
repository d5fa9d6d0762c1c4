// SPDX-License-Identifier: Apache-2.0
// The processes that a launcher (mpirun, srun) started together. MPI is in a separate library that
// is loaded only then, so the program runs without MPI.
#pragma once

#include <algorithm>
#include <cstdlib>
#include <memory>
#include <optional>
#include <span>
#include <string>

namespace redrive {

struct GroupMessage {
  int from = 0;  ///< rank of the process
  std::string text;
};

/// This class itself is a group of one. Only the thread that joined the group may use it.
class ProcessGroup {
 public:
  virtual ~ProcessGroup() = default;  ///< waits for the other processes' groups to end
  virtual int rank() const { return 0; }
  virtual int size() const { return 1; }
  /// Number of the group's processes on this machine, and of those on the same processors, each
  /// including this one.
  virtual int on_machine() const { return 1; }
  virtual int on_processors() const { return 1; }
  virtual int rank_on_machine() const { return 0; }
  /// Sends a message of 4000 bytes at most. Messages of one process arrive in order.
  virtual void send(int /*to*/, const std::string& /*text*/) {}
  /// Returns a message that has arrived, if any.
  virtual std::optional<GroupMessage> receive() { return std::nullopt; }

  // Collectives: all processes call them in the same order, with arrays of the same sizes, and wait
  // for each other.
  /// Sets `all` to the numbers of all processes, in the order of ranks.
  virtual void all_gather(std::span<const double> own, std::span<double> all) {
    std::copy(own.begin(), own.end(), all.begin());
  }
  /// Replaces each number by its mean over the processes. Sums are in the order of ranks, so that
  /// all have the same bits.
  virtual void mean(std::span<float> /*numbers*/) {}
  /// Ends all processes at once, including those that wait in a collective.
  [[noreturn]] virtual void abort(int code) { std::_Exit(code); }
};

/// Returns this process's rank from the environment, without joining the group; 0 without a
/// launcher.
int launched_rank();

/// Joins the group of the launcher that the environment names; without one, returns a group of one.
/// UsageError where there is a launcher and MPI cannot be used.
std::unique_ptr<ProcessGroup> join_process_group();

}  // namespace redrive
