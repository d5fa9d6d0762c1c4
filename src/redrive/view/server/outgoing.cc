// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/server/outgoing.h"

#include <cmath>

#include <nlohmann/json.hpp>

namespace redrive::view {

std::string text_message(const nlohmann::json& json) {
  return json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string bytes_message(const nlohmann::json& header, const std::string& jpeg,
                          const std::string& points, const std::string& mask) {
  const std::string text = text_message(header);
  std::string message;
  message.reserve(4 + text.size() + jpeg.size() + points.size() + mask.size());
  for (int shift = 0; shift < 32; shift += 8)
    message += static_cast<char>((text.size() >> shift) & 255);
  return message += text + jpeg + points + mask;
}

nlohmann::json lines_to_json(const std::vector<OverlayLine>& lines) {
  nlohmann::json all = nlohmann::json::array();
  for (const OverlayLine& line : lines) {
    nlohmann::json points = nlohmann::json::array();
    for (const Eigen::Vector2d& point : line.points) {
      points.push_back(rounded(point.x(), 1e-4));
      points.push_back(rounded(point.y(), 1e-4));
    }
    all.push_back({{"kind", line.kind}, {"label", line.label}, {"points", std::move(points)}});
  }
  return all;
}

nlohmann::json curve_to_json(const std::vector<MetricsRow>& rows) {
  constexpr std::size_t kMost = 300;
  nlohmann::json steps = nlohmann::json::array(), psnr_db = steps, loss = steps;
  const std::size_t stride = (rows.size() + kMost - 1) / kMost;
  for (std::size_t i = 0; i < rows.size(); ++i) {
    // The last row is always included.
    if ((rows.size() - 1 - i) % stride != 0) continue;
    if (!std::isfinite(rows[i].psnr_db) || !std::isfinite(rows[i].loss)) continue;
    steps.push_back(rows[i].step);
    psnr_db.push_back(rounded(rows[i].psnr_db, 0.01));
    loss.push_back(rows[i].loss);
  }
  return {{"kind", "curve"}, {"steps", steps}, {"psnr_db", psnr_db}, {"loss", loss}};
}

double rounded(double value, double step) { return std::round(value / step) * step; }

}  // namespace redrive::view
