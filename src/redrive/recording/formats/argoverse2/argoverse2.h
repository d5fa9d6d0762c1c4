// SPDX-License-Identifier: Apache-2.0
// The Sensor Dataset of Argoverse 2 (Wilson et al.: "Argoverse 2: Next Generation Datasets for
// Self-Driving Perception and Forecasting", NeurIPS Datasets and Benchmarks 2021), the folder of a
// log: tables as Feather files, sensors/cameras/<name>/<ns>.jpg, sensors/lidar/<ns>.feather.
#pragma once

#include <filesystem>

#include "redrive/recording/core/recording.h"

namespace redrive::argoverse2 {

bool looks_like(const std::filesystem::path& root);
/// Scans are read when they are asked for, but for the first one, whose times tell when boxes hold.
/// InputError where poses or calibration are missing or malformed.
Recording open(const std::filesystem::path& root, PoseSource source);

}  // namespace redrive::argoverse2
