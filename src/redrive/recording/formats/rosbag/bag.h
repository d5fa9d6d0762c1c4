// SPDX-License-Identifier: Apache-2.0
// A bag of ROS 2 (rosbag2): topics, and messages that are read when they are asked for. Storage is
// MCAP (mcap.h) or SQLite (sqlite_file.h), in one file or several.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "redrive/base/error.h"
#include "redrive/recording/core/recording.h"

namespace redrive::rosbag {

constexpr std::size_t kAllBytes = std::numeric_limits<std::size_t>::max();

/// A message by its place.
struct Message {
  std::int64_t log_ns = 0;   ///< when it was recorded
  std::uint64_t offset = 0;  ///< in its chunk or file, or a row's number
  std::uint32_t file = 0;    ///< index in the bag
  std::uint32_t chunk = 0;   ///< index in the file
};

struct Topic {
  std::string name, type;  ///< "/camera/image_raw", "sensor_msgs/msg/Image"
  std::string encoding;    ///< "cdr"
  std::string schema_encoding, schema;
  std::vector<Message> messages;
};

/// Receives a message's bytes and its index among the ones that were asked for.
using TakeMessage = std::function<void(std::size_t index, std::string_view bytes)>;

/// One file of a bag. Its topics' messages have file 0 and stand in any order. Usable from any
/// thread.
class BagFile {
 public:
  virtual ~BagFile() = default;
  const std::vector<Topic>& topics() const { return topics_; }
  const std::vector<Finding>& findings() const { return findings_; }
  /// Calls `take` with the first `most` bytes of messages of one chunk. InputError for damage.
  virtual void read(std::span<const Message> messages, std::size_t most,
                    const TakeMessage& take) const = 0;

 protected:
  std::vector<Topic> topics_;
  std::vector<Finding> findings_;
};

class Bag {
 public:
  /// Opens the folder's files, which metadata.yaml may name. Only indices are read. InputError: no
  /// file, a damaged one, compression by file.
  explicit Bag(const std::filesystem::path& folder);

  const std::filesystem::path& folder() const { return folder_; }
  /// Sorted by name; messages in order of log time.
  const std::vector<Topic>& topics() const { return topics_; }
  /// Returns null if there is no such topic.
  const Topic* find(const std::string& name) const;
  const std::vector<Finding>& findings() const { return findings_; }

  /// Returns a message's first `most` bytes. InputError for damage.
  std::string read(const Message& message, std::size_t most = kAllBytes) const;
  /// Reads messages chunk by chunk, on all cores; `take` is called from any thread. `fail`, if
  /// given, takes the index of a message that cannot be read.
  void read(std::span<const Message> messages, std::size_t most, const TakeMessage& take,
            const std::function<void(std::size_t index, const InputError& why)>& fail = {}) const;

 private:
  void add_file(const std::filesystem::path& path);
  void read_group(std::span<const Message> messages, std::size_t most,
                  const TakeMessage& take) const;

  std::filesystem::path folder_;
  std::vector<std::filesystem::path> paths_;
  std::vector<std::unique_ptr<BagFile>> files_;
  std::vector<Topic> topics_;
  std::vector<Finding> findings_;
  bool packed_messages_ = false;  ///< each message is Zstandard
};

}  // namespace redrive::rosbag
