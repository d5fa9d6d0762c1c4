// SPDX-License-Identifier: Apache-2.0
// The page of inspect --report: verdicts, images with masks and LiDAR points, annotated objects,
// the cameras' extrinsics, the trajectory, errors over time offsets, exposure.
#pragma once

#include <filesystem>

#include "redrive/align/preflight/preflight.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {

/// Writes folder/index.html, folder/<CAM>.jpg, the files of objects_section and folder/figures with
/// its plots and their gnuplot scripts; the folder must exist. `images`: the checked ones; `lidar`:
/// in the world of their scene. InputError as load_view; IoError, also where gnuplot is missing.
void write_preflight_page(const std::filesystem::path& folder, const Recording& recording,
                          const RigImages& images, const LidarReturns& lidar,
                          const Preflight& preflight);

}  // namespace redrive
