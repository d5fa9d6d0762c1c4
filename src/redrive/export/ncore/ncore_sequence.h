// SPDX-License-Identifier: Apache-2.0
// A sequence of NVIDIA's NCore, version 4, while it is written: one store with components, each
// {kind}/{instance}, and the JSON file that lists them. Layout: NVIDIA/ncore, docs/data/formats.rst
// and conventions.rst. Times are microseconds.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "redrive/base/files/zarr_store.h"

namespace redrive::ncore {

using Json = nlohmann::ordered_json;

/// Start and end of a sensor's frames. Both must increase from frame to frame.
class FrameTimes {
 public:
  /// Returns false, and adds nothing, where that does not hold with the frames so far.
  bool add(std::int64_t start_us, std::int64_t end_us);
  /// [N][2], ascending.
  Json json() const;

 private:
  std::map<std::int64_t, std::int64_t> start_of_end_;
};

class Sequence {
 public:
  /// earlier_ns: subtracted from all times. IoError.
  Sequence(const std::filesystem::path& folder, const std::string& id, std::int64_t earlier_ns);

  ZarrStore& store() { return store_; }
  /// Makes a component; returns its path.
  std::string component(const std::string& kind, const std::string& instance);
  /// Returns the nearest microsecond.
  std::int64_t us(std::int64_t t_ns) const;
  /// Returns a time of the recording.
  std::int64_t ns(std::int64_t t_us) const { return 1000 * t_us + earlier_ns_; }
  /// Returns the name of a sensor as a path and Python's text have it, unlike all before.
  std::string sensor_id(const std::string& name);

  /// Widens the interval of the sequence.
  void cover(std::int64_t start_us, std::int64_t end_us);
  std::int64_t first_us() const { return first_us_; }
  std::int64_t last_us() const { return last_us_; }

  /// Completes the store and writes the JSON file. IoError.
  void finish();

 private:
  std::filesystem::path folder_;
  std::string id_;
  std::int64_t earlier_ns_ = 0, first_us_ = 0, last_us_ = -1;
  ZarrStore store_;
  Json components_ = Json::object();
  std::set<std::string> sensors_{"rig", "world", "world_global"};  ///< names of frames
};

}  // namespace redrive::ncore
