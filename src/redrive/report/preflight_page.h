// SPDX-License-Identifier: Apache-2.0
// The page that shows what a colleague would look at before training: verdicts, images with masks and LiDAR, cameras on the car, the
// way driven, scans over time, exposure.
#pragma once

#include <filesystem>

#include "redrive/align/preflight.h"

namespace redrive {

/// Writes folder/index.html, folder/<CAM>.jpg and folder/figures with its plots and their gnuplot scripts; the folder must be there.
/// `images`: what was checked. InputError as load_view and load_lidar_returns, IoError, also where gnuplot is missing.
void write_preflight_page(const std::filesystem::path& folder, const Recording& recording, const RigImages& images,
                          const Preflight& preflight, ThreadPool& pool);

}  // namespace redrive
