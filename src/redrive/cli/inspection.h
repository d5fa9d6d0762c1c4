// SPDX-License-Identifier: Apache-2.0
// Findings of inspect.
#pragma once

#include <optional>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/align/preflight/preflight.h"
#include "redrive/edit/object_summary.h"
#include "redrive/recording/core/recording.h"
#include "redrive/recording/core/summary.h"
#include "redrive/recording/formats/mapping.h"
#include "redrive/recording/lidar/scan_structure.h"

namespace redrive {

struct CameraReport {
  const RecordedCamera* recorded = nullptr;
  double horizontal_fov_deg = 0;
  double percent_without_ray = 0;        ///< pixels outside the model's valid region
  std::optional<double> percent_masked;  ///< with --masks-out
  bool grey = false;                     ///< whether its images are grey
  bool alpha = false;                    ///< whether a decoded image has an alpha channel
  std::size_t held_out = 0, masks = 0;
};

struct Inspection {
  Recording recording;
  std::optional<DriveSummary> drive;  ///< nothing for photographs
  std::vector<CameraReport> cameras;
  /// beams of Recording::lidars; nothing where they are not known
  std::vector<std::optional<ScanStructure>> lidars;
  std::vector<Finding> findings;       ///< oddities with which the recording can be used
  std::vector<Finding> problems;       ///< reasons for which training would reject the recording
  std::optional<Preflight> preflight;  ///< with --report
  std::optional<std::vector<ObjectSummary>> objects;  ///< with --actors
};

nlohmann::ordered_json inspection_to_json(const Inspection& inspection);
void print_inspection(const Inspection& inspection);

nlohmann::ordered_json mapping_to_json(const Mapping& mapping);
void print_mapping(const Mapping& mapping);

}  // namespace redrive
