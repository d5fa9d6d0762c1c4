// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/scan_windows.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>

#include "redrive/kernels/gaussian/gaussian_stages.h"

namespace redrive {
namespace {

constexpr std::size_t kLeastParts = 4;           // number of windows of a scan
constexpr std::size_t kMostRays = 32768;         // rays of a window, about
constexpr std::int64_t kOneTime_ns = 1'000'000;  // shorter scans have one time

/// A ray in the sensor's axes.
struct FiredRay {
  Eigen::Vector3f direction;
  float log_range, intensity;
  std::int64_t t_ns;
};

}  // namespace

ScanWindows::ScanWindows(const Scene& scene, const LidarReturns& lidar,
                         std::function<bool(std::int64_t)> drawn)
    : scene_(scene),
      lidar_(lidar),
      drawn_(std::move(drawn)),
      full_intensities_(lidar.full_intensities()) {
  LidarReturns::ScanEnd begin;
  for (const LidarReturns::ScanEnd& end : lidar.scan_ends) {
    Scan scan{begin, end, std::numeric_limits<std::int64_t>::max(),
              std::numeric_limits<std::int64_t>::min()};
    const auto count = [&](std::int64_t t_ns) {
      scan.first_ns = std::min(scan.first_ns, t_ns);
      scan.last_ns = std::max(scan.last_ns, t_ns);
    };
    for (std::size_t i = begin.returns; i < end.returns; ++i) count(lidar.t_ns[i]);
    for (std::size_t i = begin.lost; i < end.lost; ++i) count(lidar.lost[i].t_ns);
    const std::size_t rays = end.returns - begin.returns + end.lost - begin.lost,
                      parts = std::max(kLeastParts, (rays + kMostRays - 1) / kMostRays);
    std::vector<bool> used(parts);
    const auto use = [&](std::int64_t t_ns, const Eigen::Vector3f& direction) {
      used[static_cast<std::size_t>(part_of(scan, t_ns, direction) * static_cast<float>(parts))] =
          true;
    };
    for (std::size_t i = begin.returns; i < end.returns; ++i)
      use(lidar.t_ns[i], lidar.direction_in_sensor(i).cast<float>());
    for (std::size_t i = begin.lost; i < end.lost; ++i)
      use(lidar.lost[i].t_ns, lidar.lost[i].direction);
    for (std::size_t part = 0; part < parts; ++part)
      if (used[part])
        windows_.push_back({scans_.size(), static_cast<int>(part), static_cast<int>(parts)});
    scans_.push_back(scan);
    begin = end;
  }
}

float ScanWindows::part_of(const Scan& scan, std::int64_t t_ns,
                           const Eigen::Vector3f& direction) const {
  const std::int64_t lasts_ns = scan.last_ns - scan.first_ns;
  if (lasts_ns > kOneTime_ns)
    return 0.999999f * static_cast<float>(double(t_ns - scan.first_ns) / double(lasts_ns));
  return 0.5f + std::atan2(direction.y(), direction.x()) * 0.4999999f / std::numbers::pi_v<float>;
}

ScanWindow ScanWindows::operator[](std::size_t which) const {
  const Window& window = windows_[which];
  const Scan& scan = scans_[window.scan];
  std::vector<FiredRay> rays;
  const LidarReturns::Sensor& sensor = lidar_.sensors[scan.end.sensor];
  const float full = full_intensities_[scan.end.sensor];
  const auto add = [&](const Eigen::Vector3f& direction, float range_m, std::uint16_t intensity,
                       std::uint8_t ring, std::int64_t t_ns) {
    const float part = part_of(scan, t_ns, direction) * static_cast<float>(window.parts);
    if (static_cast<int>(part) != window.part) return;
    rays.push_back({direction, range_m > 0 ? std::log(range_m) : kernels::kNoRange,
                    static_cast<float>(intensity) / (full * gain_of_ring(sensor.beam_gains, ring)),
                    t_ns});
  };
  for (std::size_t i = scan.begin.returns; i < scan.end.returns;) {
    const LidarReturns::Ray ray = lidar_.ray_at(i, scan.end.returns);
    add(lidar_.direction_in_sensor(i).cast<float>(), lidar_.range_m[ray.strongest],
        lidar_.intensity[ray.strongest], lidar_.ring_of(ray.strongest), lidar_.t_ns[i]);
    i = ray.end;
  }
  for (std::size_t i = scan.begin.on_objects; i < scan.end.on_objects; ++i) {
    const LidarReturns::OnObject& at = lidar_.on_objects[i];
    if (at.range_m > 0 && drawn_(at.id))
      add(at.direction, at.range_m, at.intensity, at.ring, at.t_ns);
  }
  for (std::size_t i = scan.begin.lost; i < scan.end.lost; ++i)
    if (!sensor.is_blind(lidar_.lost[i].direction.cast<double>()))
      add(lidar_.lost[i].direction, 0, 0, kNoRing, lidar_.lost[i].t_ns);
  std::ranges::stable_sort(rays, {}, &FiredRay::t_ns);  // a pose is evaluated once for each time

  ScanWindow out;
  for (const FiredRay& ray : rays) {
    out.log_range.push_back(ray.log_range);
    out.intensity.push_back(ray.intensity);
    out.t_ns.push_back(ray.t_ns);
  }
  LidarRays in_world = fire(
      out.t_ns, [&](std::size_t i) { return rays[i].direction.cast<double>(); },
      [&, &sensor = lidar_.sensors[scan.end.sensor]](std::int64_t t_ns) {
        return scene_.world_from_body(t_ns) * sensor.body_from_sensor;
      });
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  for (std::size_t i = 0; i < rays.size(); ++i) middle += in_world.direction_at(i).cast<double>();
  out.origin = std::move(in_world.origin);
  out.direction = std::move(in_world.direction);
  middle.z() = 0;
  out.world_from_axes.col(2) =
      middle.norm() > 1e-6 ? middle.normalized().eval() : Eigen::Vector3d::UnitX().eval();
  out.world_from_axes.col(1) = -Eigen::Vector3d::UnitZ();
  out.world_from_axes.col(0) = out.world_from_axes.col(1).cross(out.world_from_axes.col(2));
  return out;
}

}  // namespace redrive
