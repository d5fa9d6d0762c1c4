// SPDX-License-Identifier: Apache-2.0
// The stores of a sequence and what they hold: components, each of a kind (poses, intrinsics,
// cameras, ...) with a name.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "redrive/base/files/zarr_reader.h"
#include "redrive/base/json_field.h"
#include "redrive/recording/core/recording.h"

namespace redrive::ncore {

/// Latest time in microseconds: nanoseconds fit into 63 bits.
constexpr std::int64_t kMaxTime_us = 9'000'000'000'000'000;

struct Component {
  std::shared_ptr<const ZarrReader> store;
  std::string path;  ///< its group in the store
  std::string name;  ///< a sensor, or "default"

  /// Attributes of a group or array in it, as `file` names them in messages.
  nlohmann::json attributes(const std::string& below) const {
    return store->attributes(path + "/" + below);
  }
  std::filesystem::path file(const std::string& below) const {
    return store->path() / path / below / ".zattrs";
  }
};

/// Components by kind.
using Components = std::map<std::string, std::vector<Component>>;

/// Whether the name is a store's.
bool is_store_name(const std::filesystem::path& path);

/// Opens all stores of a sequence. InputError: none, of several sequences, another version,
/// damaged. A store outside the folder becomes recording->outside_file, one that is missing a
/// finding.
Components open_components(Recording* recording);

/// Returns the component of a kind that is used where there may be several: "default", or the first
/// by name, with a finding about the others. Nothing where there is none.
std::optional<Component> choose(const Components& components, const std::string& kind,
                                std::vector<Finding>* findings);

/// Begin and end of a frame of a sensor.
struct FrameSpan {
  std::int64_t start_us = 0, end_us = 0;
  std::string group;  ///< path of its group in the store
};

/// Returns the frames of a sensor by end, those that have a group. Others, and those whose times
/// cannot be, go to `damaged`.
std::vector<FrameSpan> read_spans(const Component& sensor, std::vector<DamagedRecord>* damaged);

}  // namespace redrive::ncore
