// SPDX-License-Identifier: Apache-2.0
// The format of the messages that the viewer sends to a page (viewer.h).
#pragma once

#include <string>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "redrive/train/run.h"
#include "redrive/view/overlay.h"

namespace redrive::view {

/// Returns JSON as text; file names in it need not be UTF-8.
std::string text_message(const nlohmann::json& json);

/// Returns a binary message: the size of the header, the header, then the parts that it counts.
std::string bytes_message(const nlohmann::json& header, const std::string& jpeg,
                          const std::string& points = "", const std::string& mask = "");

nlohmann::json lines_to_json(const std::vector<OverlayLine>& lines);

/// Returns {"kind": "curve", "steps", "psnr_db", "loss"} with at most 300 of the rows.
nlohmann::json curve_to_json(const std::vector<MetricsRow>& rows);

double rounded(double value, double step);

}  // namespace redrive::view
