// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/lidar_sensor.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <numbers>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/trajectory.h"
#include "redrive/scene/lidar/lidar_returns.h"

namespace redrive {
namespace {

constexpr std::size_t kMaxBeams = 256;

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

/// Returns the lowest and highest elevation of common sensors with this many beams, degrees, from
/// their data sheets: Velodyne VLP-16, HDL-32E, HDL-64E and Alpha Prime (VLS-128).
std::pair<double, double> usual_elevations(int beams) {
  if (beams <= 16) return {-15, 15};
  if (beams <= 32) return {-30.67, 10.67};
  if (beams <= 64) return {-24.8, 2};
  return {-25, 15};
}

/// Returns `count` elevations from low to high; nothing for less than two.
std::optional<std::vector<double>> spaced(double count, double low, double high) {
  if (count != std::floor(count) || count < 2 || count > kMaxBeams || !(low < high))
    return std::nullopt;
  std::vector<double> elevations;
  for (int i = 0; i < static_cast<int>(count); ++i)
    elevations.push_back(low + (high - low) * i / (count - 1));
  return elevations;
}

/// Returns the file of the frame's revolution whose middle is nearest to the frame; null if there
/// is none.
const FrameFile* nearest_revolution(const Recording& recording, std::int64_t frame_id) {
  const auto frame = std::ranges::lower_bound(recording.frames, frame_id, {}, &FramePose::id);
  if (frame == recording.frames.end() || frame->id != frame_id) return nullptr;
  std::vector<const FrameFile*> files;
  for (const FrameFile& file : recording.lidar_files)
    if (file.frame_id == frame_id) files.push_back(&file);
  if (files.size() < 2) return files.empty() ? nullptr : files[0];
  const FrameFile* nearest = nullptr;
  std::int64_t least_ns = 0;
  for (const FrameFile* file : files) {
    const auto middle = middle_ns(recording.reader->read_lidar(*file));
    if (!middle) continue;
    const std::int64_t off_ns = std::abs(*middle - frame->t_ns);
    if (!nearest || off_ns < least_ns) nearest = file, least_ns = off_ns;
  }
  return nearest;
}

}  // namespace

std::optional<std::vector<double>> parse_beams(std::string_view text) {
  const bool range = text.find(':') != std::string_view::npos,
             is_count = text.find_first_not_of("0123456789") == std::string_view::npos;
  auto numbers = numbers_in(text, range ? ':' : ',');
  if (!numbers) return std::nullopt;
  if (is_count) {
    const auto [low, high] = usual_elevations(static_cast<int>(std::min(numbers->front(), 1e6)));
    return spaced(numbers->front(), low, high);
  }
  if (range) {
    if (numbers->size() != 3) return std::nullopt;
    numbers = spaced((*numbers)[0], (*numbers)[1], (*numbers)[2]);
    if (!numbers) return std::nullopt;
  }
  if (numbers->size() > kMaxBeams) return std::nullopt;
  for (const double elevation_deg : *numbers)
    if (!(std::abs(elevation_deg) <= 90)) return std::nullopt;
  return numbers;
}

LidarFirings SpinningLidar::revolution(std::int64_t t_ns) const {
  LidarFirings out;
  const double period_ns = 1e9 / rate_hz;
  for (int step = 0; step < azimuth_steps; ++step) {
    const double fraction = (step + 0.5) / azimuth_steps,
                 azimuth_rad = std::numbers::pi * (1 - 2 * fraction);  // to the left
    for (const double elevation : elevation_deg) {
      const double up_rad = kRadiansPerDegree * elevation;
      out.direction.emplace_back(std::cos(up_rad) * std::cos(azimuth_rad),
                                 std::cos(up_rad) * std::sin(azimuth_rad), std::sin(up_rad));
      out.t_ns.push_back(t_ns + std::llround((fraction - 0.5) * period_ns));
    }
  }
  return out;
}

std::optional<LidarFirings> recorded_firings(const Recording& recording, const Scene& scene,
                                             std::int64_t frame_id, ThreadPool& pool) {
  const FrameFile* const file = nearest_revolution(recording, frame_id);
  if (!file) return std::nullopt;
  Recording revolution;
  revolution.frames = recording.frames;
  revolution.body_from_lidar = recording.body_from_lidar;
  revolution.reader = recording.reader;
  revolution.lidar_files = {*file};
  const LidarReturns returns = load_lidar_returns(
      revolution, scene, MovingObjects({}, recording.frames, scene.global_from_world), pool,
      {{}, /*repeated=*/true});
  if (returns.n == 0) return std::nullopt;
  LidarFirings out;
  out.t_ns = returns.t_ns;
  for (std::size_t i = 0; i < returns.n; ++i)
    out.direction.push_back(returns.direction_in_sensor(i).normalized());
  return out;
}

Rigid3d camera_from_lidar_axes() {
  Rigid3d axes = Rigid3d::Identity();
  axes.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return axes;
}

}  // namespace redrive
