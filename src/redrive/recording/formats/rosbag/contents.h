// SPDX-License-Identifier: Apache-2.0
// Images and scans of a bag as files: ROOT/CAMERA/NS.jpg, .png or .ppm, ROOT/LIDAR/NS.cloud.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "redrive/base/files/file_container.h"
#include "redrive/recording/formats/rosbag/bag.h"
#include "redrive/recording/formats/rosbag/messages.h"
#include "redrive/recording/formats/rosbag/rig.h"

namespace redrive::rosbag {

class Contents : public FileContainer {
 public:
  explicit Contents(std::shared_ptr<const Bag> bag) : bag_(std::move(bag)) {}

  const Bag& bag() const { return *bag_; }
  /// A topic with images or scans.
  struct Sensor {
    const Topic* topic = nullptr;
    std::string name;
  };
  /// Adds the messages of the topics in one pass over the bag. Returns each sensor's by time, with
  /// the time in ns as frame id. Messages that are damaged or without a stamp go to
  /// `recording->damaged`.
  std::vector<std::vector<FrameFile>> add(const std::vector<Sensor>& sensors, Clock clock,
                                          Recording* recording);

  /// Returns a scan. InputError for damage.
  std::vector<LidarPoint> read_scan(const std::filesystem::path& path, const ScanFields& fields,
                                    const Rigid3d& body_from_lidar, std::size_t* left_out) const;
  std::uint64_t points(const std::filesystem::path& path) const;

  std::optional<std::uint64_t> size(const std::filesystem::path& path) const override;
  std::string read(const std::filesystem::path& path, std::size_t most) const override;

 private:
  struct Entry {
    Message message;
    const Topic* topic = nullptr;
    std::int64_t t_ns = 0;
    std::uint64_t size = 0, points = 0;
    std::uint32_t row_bytes = 0, step = 0;  ///< a raw image's rows: as PPM, in the message
  };
  struct Named {
    Entry entry;
    std::string extension;
  };
  static Named entry_of(const Topic& topic, std::string_view head, const std::filesystem::path& bag,
                        std::int64_t* stamp_ns);

  std::shared_ptr<const Bag> bag_;
  std::unordered_map<std::string, Entry> entries_;
};

}  // namespace redrive::rosbag
