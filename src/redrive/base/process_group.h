// SPDX-License-Identifier: Apache-2.0
// The processes that a launcher (mpirun, srun) started together. MPI is in a library of its own,
// which is loaded only then, so the program runs without MPI.
#pragma once

#include <memory>
#include <optional>
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
  /// Number of the group's processes on this machine, and of those that run on the same of its
  /// processors, each with this one.
  virtual int on_machine() const { return 1; }
  virtual int on_processors() const { return 1; }
  /// Sends a message of 4000 bytes at most. Messages of one process arrive in order.
  virtual void send(int /*to*/, const std::string& /*text*/) {}
  /// Returns a message that has arrived, if any.
  virtual std::optional<GroupMessage> receive() { return std::nullopt; }
};

/// Joins the group of the launcher that the environment names, else returns a group of one.
/// UsageError where there is a launcher and MPI cannot be used.
std::unique_ptr<ProcessGroup> join_process_group();

}  // namespace redrive
