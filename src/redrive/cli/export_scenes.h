// SPDX-License-Identifier: Apache-2.0
// redrive export to the scenes of simulators: zips of several members, with a place on the Earth.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "redrive/kernels/backend.h"
#include "redrive/model/field.h"

namespace redrive {

struct ExportCommandOptions {
  std::string from, format, out, frames, poses;
  bool force = false, outside_files = false;
  ExportOptions encode;
  std::optional<std::int64_t> actor;
  std::optional<double> max_damaged;
  double voxel_m = 0;
  kernels::BackendChoice backend;
};

/// Throws UsageError if options for recordings are given.
void refuse_part_of_run(const ExportCommandOptions& options);

int export_scene_bundle(const ExportCommandOptions& options);
int export_splatsim(const ExportCommandOptions& options);

}  // namespace redrive
