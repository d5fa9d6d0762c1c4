// SPDX-License-Identifier: Apache-2.0
// Images, masks and scans of a sequence as files: ROOT/CAMERA/END_US.jpg or .png,
// ROOT/CAMERA/ego.png, ROOT/LIDAR/END_US.rays.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "redrive/base/files/file_container.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/formats/ncore/ncore_stores.h"

namespace redrive::ncore {

class Contents : public FileContainer {
 public:
  explicit Contents(std::filesystem::path root) : root_(std::move(root)) {}

  /// Adds the images of a camera and returns them by time, with the middle of their exposure in ns
  /// as frame id. Sets the readout of a rolling shutter. Those without an image go to `damaged`.
  std::vector<FrameFile> add_images(const Component& sensor, bool rolling, std::int64_t* readout_ns,
                                    std::vector<DamagedRecord>* damaged);
  /// Adds a mask of a camera, an array of `masks`.
  MaskFile add_mask(const Component& masks, const std::string& array, const std::string& camera);
  /// Adds the scans of a LiDAR, likewise.
  std::vector<FrameFile> add_scans(const Component& sensor, std::size_t lidar,
                                   std::vector<DamagedRecord>* damaged);

  /// A scan in its store.
  struct Scan {
    std::shared_ptr<const ZarrReader> store;
    std::string group;
    std::int64_t end_us = 0;
  };
  const Scan& scan(const std::filesystem::path& path) const;

  std::optional<std::uint64_t> size(const std::filesystem::path& path) const override;
  std::string read(const std::filesystem::path& path, std::size_t most) const override;

 private:
  struct Entry {
    std::shared_ptr<const ZarrReader> store;
    std::string array;
    std::uint64_t size = 0;
  };

  std::filesystem::path root_;
  std::unordered_map<std::string, Entry> files_;
  std::unordered_map<std::string, Scan> scans_;
};

}  // namespace redrive::ncore
