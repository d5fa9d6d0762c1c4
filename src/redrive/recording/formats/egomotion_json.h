// SPDX-License-Identifier: Apache-2.0
// Trajectories as JSON, by frame id:
//   {"9": {"RT_ECEF_body": 4x4 (or "ECEF_RT_body"), "time_host": s (or "time")}}
#pragma once

#include <filesystem>
#include <optional>
#include <string_view>
#include <vector>

#include "redrive/base/json_field.h"
#include "redrive/recording/core/damaged_text.h"
#include "redrive/recording/core/recording.h"

namespace redrive {

/// Returns poses sorted by id. InputError: ids with leading zeros, no pose at all. Impossible poses
/// and times, times that do not increase and more than 150 m/s go to `damaged`; without it they are
/// errors.
std::vector<FramePose> parse_egomotion(std::string_view text, const std::filesystem::path& file,
                                       const DamagedList* damaged = nullptr);

nlohmann::json egomotion_to_json(const std::vector<FramePose>& frames);

/// RT_ECEF_body or ECEF_RT_body of an entry, at most 1e7 m from the origin; nothing if it has
/// neither.
std::optional<Rigid3d> global_from_body_from_json(const JsonField& entry);

}  // namespace redrive
