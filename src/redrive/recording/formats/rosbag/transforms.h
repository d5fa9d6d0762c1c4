// SPDX-License-Identifier: Apache-2.0
// The tree of frames that tf messages span (tf2: each frame has one parent).
#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/rosbag/messages.h"

namespace redrive::rosbag {

/// Sorts poses by their time. Of several at one time the first stays.
void sort_by_time(std::vector<FramePose>* poses);

class TransformTree {
 public:
  /// Adds a transform; a later parent of the same frame replaces the one before.
  void add(const Transform& transform, bool is_static);
  /// Sorts by time and joins equal times. What never changes becomes static. Call after the last
  /// add.
  void finish();

  bool has(const std::string& frame) const { return frames_.contains(frame) || is_parent(frame); }
  /// Returns a_from_b where only static transforms lead from one to the other.
  std::optional<Rigid3d> fixed(const std::string& a, const std::string& b) const;
  /// Returns poses of `child` in `parent`, an ancestor that moves against it, at the times of the
  /// transform that comes most often; others are interpolated, and hold at their ends. Empty
  /// without such a chain.
  std::vector<FramePose> poses(const std::string& parent, const std::string& child) const;
  /// Frames above a frame, the nearest first.
  std::vector<std::string> ancestors(const std::string& frame) const;
  /// Frames whose chain moves against one above them: candidates for the body.
  std::vector<std::string> moving() const;

 private:
  struct Link {
    std::string parent;
    std::vector<FramePose> poses;  ///< parent from child, by time
    bool is_static = true;
  };
  bool is_parent(const std::string& frame) const;
  const Link* link(const std::string& frame) const;

  std::map<std::string, Link> frames_;  ///< key: child
};

}  // namespace redrive::rosbag
