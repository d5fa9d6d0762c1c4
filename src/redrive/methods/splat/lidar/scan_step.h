// SPDX-License-Identifier: Apache-2.0
// Working memory of SplatModel::step_scan.
#pragma once

#include <optional>
#include <vector>

#include "redrive/methods/splat/lidar/scan_loss.h"
#include "redrive/methods/splat/lidar/scan_windows.h"

namespace redrive {

struct ScanBuffers {
  std::optional<ScanWindows> windows;  ///< made by the first step
  ScanTarget target;
  ScanGradient gradient;
  std::vector<float> error;  ///< 0: Gaussians are split where images are wrong
};

}  // namespace redrive
