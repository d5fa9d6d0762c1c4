// SPDX-License-Identifier: Apache-2.0
// Gains of LiDARs as JSON, in checkpoints and exposure.json: a list of the recording's LiDARs, each
//   {"gain": number, "beams": [[elevation, rad, gain], ...], "blind": [[cell, number], ...]}
#pragma once

#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/base/json_field.h"
#include "redrive/scene/lidar/lidar_gains.h"

namespace redrive {

nlohmann::json gains_to_json(const std::vector<LidarGains>& lidars);
/// Gains must be above 0 and at most 1e4. InputError naming the field.
std::vector<LidarGains> gains_from_json(const JsonField& lidars);

}  // namespace redrive
