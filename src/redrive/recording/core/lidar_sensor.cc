// SPDX-License-Identifier: Apache-2.0
#include "redrive/recording/core/lidar_sensor.h"

#include <algorithm>
#include <charconv>
#include <numbers>

#include "redrive/math/angles.h"
#include "redrive/recording/core/lidar_point.h"

namespace redrive {
namespace {

constexpr std::size_t kMostBeams = kNoRing;

/// Returns numbers separated by `separator`; nothing for other text.
std::optional<std::vector<double>> numbers_in(std::string_view text, char separator) {
  std::vector<double> numbers;
  const char *at = text.data(), *const end = at + text.size();
  while (true) {
    double number = 0;
    const auto [next, error] = std::from_chars(at, end, number);
    if (error != std::errc{} || !std::isfinite(number)) return std::nullopt;
    numbers.push_back(number);
    if (next == end) return numbers;
    if (*next != separator) return std::nullopt;
    at = next + 1;
  }
}

/// Returns the lowest and highest elevation of common sensors with this many beams, degrees:
/// Velodyne VLP-16, HDL-32E, HDL-64E and Alpha Prime (VLS-128).
std::pair<double, double> usual_elevations(double beams) {
  if (beams <= 16) return {-15, 15};
  if (beams <= 32) return {-30.67, 10.67};
  if (beams <= 64) return {-24.8, 2};
  return {-25, 15};
}

std::optional<std::vector<LidarBeam>> spaced(double count, double low_deg, double high_deg) {
  if (count != std::floor(count) || count < 2 || count > kMostBeams || !(low_deg < high_deg) ||
      low_deg < -90 || high_deg > 90)
    return std::nullopt;
  return evenly_spaced_beams(static_cast<int>(count), low_deg, high_deg);
}

std::optional<std::vector<LidarBeam>> parse_beams(std::string_view text) {
  const bool range = text.find(':') != std::string_view::npos,
             is_count = text.find_first_not_of("0123456789") == std::string_view::npos;
  auto numbers = numbers_in(text, range ? ':' : ',');
  if (!numbers) return std::nullopt;
  if (is_count) {
    const auto [low_deg, high_deg] = usual_elevations(numbers->front());
    return spaced(numbers->front(), low_deg, high_deg);
  }
  if (range) {
    if (numbers->size() != 3) return std::nullopt;
    return spaced((*numbers)[0], (*numbers)[1], (*numbers)[2]);
  }
  std::ranges::sort(*numbers);
  if (numbers->size() > kMostBeams || numbers->front() < -90 || numbers->back() > 90)
    return std::nullopt;
  std::vector<LidarBeam> beams;
  for (const double elevation_deg : *numbers) beams.push_back({kRadiansPerDegree * elevation_deg});
  return beams;
}

}  // namespace

std::vector<LidarBeam> evenly_spaced_beams(int count, double low_deg, double high_deg) {
  std::vector<LidarBeam> beams;
  for (int i = 0; i < count; ++i)
    beams.push_back({kRadiansPerDegree * (low_deg + (high_deg - low_deg) * i / (count - 1))});
  return beams;
}

std::optional<LidarSensor> parse_lidar_sensor(std::string_view text) {
  const auto& known = known_lidar_sensors();
  if (const auto at = std::ranges::find(known, text, &LidarSensor::name); at != known.end())
    return *at;
  const auto beams = parse_beams(text);
  if (!beams) return std::nullopt;
  LidarSensor sensor;
  sensor.name = text;
  sensor.beams = *beams;
  return sensor;
}

std::string lidar_sensor_rule() {
  return "must be recorded, estimated, " + known_lidar_names() +
         ", N beams, N:MIN:MAX (N beams from MIN to MAX degrees) or elevations E1,E2,.. in "
         "degrees; "
         "at most 255 within -90..90, e.g. 64 or 64:-24.8:2";
}

LidarFirings LidarSensor::revolution(std::int64_t t_ns) const {
  LidarFirings out;
  const double period_ns = rate_hz > 0 ? 1e9 / rate_hz : 0;
  const auto fire = [&](const Eigen::Vector3d& direction, double at, std::size_t ring) {
    out.direction.push_back(direction);
    out.t_ns.push_back(t_ns + std::llround((at - 0.5) * period_ns));
    out.ring.push_back(static_cast<std::uint8_t>(ring));
  };
  for (const LidarPulse& pulse : pattern) fire(pulse.direction, pulse.at, pulse.ring);
  for (int step = 0; step < azimuth_steps; ++step) {
    const double at = (step + 0.5) / azimuth_steps,
                 turned_rad = std::numbers::pi * (clockwise ? 1 - 2 * at : 2 * at - 1);
    for (std::size_t b = 0; b < beams.size(); ++b)
      fire(beam_direction(beams[b].elevation_rad, turned_rad + beams[b].azimuth_rad), at, b);
  }
  return out;
}

}  // namespace redrive
