// SPDX-License-Identifier: Apache-2.0
// The page that shows what a colleague would look at before training: verdicts, images with masks
// and LiDAR, cameras on the car, the way driven, scans over time, exposure.
#pragma once

#include <filesystem>

#include "redrive/align/preflight/preflight.h"
#include "redrive/scene/lidar_returns.h"

namespace redrive {

/// Writes folder/index.html, folder/<CAM>.jpg and folder/figures with its plots and their gnuplot
/// scripts; the folder must be there. `images`: what was checked; `lidar`: in the world of their
/// scene. InputError as load_view, IoError, also where gnuplot is missing.
void write_preflight_page(const std::filesystem::path& folder, const Recording& recording,
                          const RigImages& images, const LidarReturns& lidar,
                          const Preflight& preflight);

}  // namespace redrive
