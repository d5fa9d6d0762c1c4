// SPDX-License-Identifier: Apache-2.0
#include "redrive/train/files/gains_json.h"

#include <cmath>

#include <nlohmann/json.hpp>

#include "redrive/recording/formats/recording_json.h"

namespace redrive {
namespace {

float gain_from_json(const JsonField& gain, double value) {
  constexpr double kMost = 1e4;
  const auto single = static_cast<float>(value);
  if (!(single > 0 && value <= kMost)) gain.fail("must be a number above 0, 1e4 at most");
  return single;
}

}  // namespace

nlohmann::json gains_to_json(const std::vector<LidarGains>& lidars) {
  nlohmann::json json = nlohmann::json::array();
  for (const LidarGains& lidar : lidars) {
    nlohmann::json beams = nlohmann::json::array();
    for (const BeamGain& beam : lidar.beams) beams.push_back({beam.elevation_rad, beam.gain});
    json.push_back(
        {{"gain", lidar.gain}, {"beams", std::move(beams)}, {"blind", lidar.blind.runs()}});
  }
  return json;
}

std::vector<LidarGains> gains_from_json(const JsonField& lidars) {
  constexpr std::size_t kMostBeams = kNoRing;
  if (!lidars.json().is_array()) lidars.fail("must be a list of LiDARs");
  std::vector<LidarGains> out;
  for (std::size_t k = 0; k < lidars.size(); ++k) {
    const JsonField gain = lidars.at(k).at("gain"), beams = lidars.at(k).at("beams");
    LidarGains& lidar = out.emplace_back(LidarGains{gain_from_json(gain, gain.number()), {}});
    if (!beams.json().is_array() || beams.size() > kMostBeams)
      beams.fail("must be a list of at most " + std::to_string(kMostBeams) + " beams");
    lidar.blind = blind_from_json(lidars.at(k).at("blind"));
    for (std::size_t b = 0; b < beams.size(); ++b) {
      const std::vector<double> two = beams.at(b).numbers(2);
      if (std::abs(two[0]) > 4) beams.at(b).fail("must begin with an elevation in rad");
      lidar.beams.push_back({static_cast<float>(two[0]), gain_from_json(beams.at(b), two[1])});
    }
  }
  return out;
}

}  // namespace redrive
