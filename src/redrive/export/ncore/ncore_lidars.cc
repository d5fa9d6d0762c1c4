// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>

#include "redrive/base/error.h"
#include "redrive/base/evenly_spaced.h"
#include "redrive/base/progress.h"
#include "redrive/export/ncore/ncore_beams.h"
#include "redrive/export/ncore/ncore_sensors.h"
#include "redrive/recording/core/lidar_point.h"
#include "redrive/recording/core/wording.h"
#include "redrive/render/recorded_lidar.h"

namespace redrive::ncore {
namespace {

/// The arrays of a revolution, by ray. Each ray has one return.
struct RayBundle {
  std::vector<float> direction;  ///< [N, 3], unit, in the sensor's axes at the ray's time
  std::vector<std::uint64_t> t_us;
  std::vector<float> distance_m, intensity;
  std::vector<std::uint16_t> element;  ///< [N, 2], row and column; empty: not known
  std::int64_t start_us = 0, end_us = 0;
  std::size_t clamped = 0;  ///< intensities above full scale
  bool beyond_poses = false;

  std::size_t size() const { return t_us.size(); }
};

RayBundle ray_bundle(std::vector<LidarPoint> points, const Rigid3d& sensor_from_body,
                     const BeamModel* beams, float full_scale, const Recording& drive,
                     const Sequence& sequence) {
  RayBundle rays;
  std::erase_if(points, [&](const LidarPoint& point) {
    return !((sensor_from_body * point.in_body_m.cast<double>()).norm() > 0);
  });
  if (points.empty()) return rays;
  const auto [first, last] = std::ranges::minmax(points, {}, &LidarPoint::t_ns);
  rays.beyond_poses = is_beyond_poses(drive, first.t_ns) || is_beyond_poses(drive, last.t_ns);
  if (rays.beyond_poses) return rays;
  rays.start_us = sequence.us(first.t_ns);
  rays.end_us = sequence.us(last.t_ns);
  for (const LidarPoint& point : points) {
    const Eigen::Vector3d ray = sensor_from_body * point.in_body_m.cast<double>();
    const double distance_m = ray.norm();
    for (int k = 0; k < 3; ++k) rays.direction.push_back(static_cast<float>(ray[k] / distance_m));
    rays.t_us.push_back(static_cast<std::uint64_t>(sequence.us(point.t_ns)));
    rays.distance_m.push_back(static_cast<float>(distance_m));
    const float intensity = static_cast<float>(point.intensity) / full_scale;
    rays.intensity.push_back(std::min(intensity, 1.0f));
    rays.clamped += intensity > 1;
  }
  if (beams) rays.element = beams->elements(points);
  return rays;
}

void store_rays(const RayBundle& rays, const std::string& frame, ZarrStore* store) {
  const std::size_t n = rays.size();
  const std::string bundle = frame + "/ray_bundle", returns = frame + "/ray_bundle_returns";
  store->group(frame + "/generic_data", Json::object());
  store->group(bundle, {{"n_rays", n}});
  store->array(bundle + "/direction", "<f4", {n, 3}, rays.direction);
  store->array(bundle + "/timestamp_us", "<u8", {n}, rays.t_us);
  if (!rays.element.empty()) store->array(bundle + "/model_element", "<u2", {n, 2}, rays.element);
  store->group(returns, {{"n_returns", 1}});
  store->array(returns + "/distance_m", "<f4", {1, n}, rays.distance_m);
  store->array(returns + "/intensity", "<f4", {1, n}, rays.intensity);
  // numpy.packbits: the first bit is the highest of its byte.
  std::vector<std::uint8_t> valid((n + 7) / 8, 0xff);
  if (n % 8 > 0) valid.back() = static_cast<std::uint8_t>(0xff << (8 - n % 8));
  store->array(frame + "/ray_bundle_returns_valid_mask_packed", "|u1", {valid.size()}, valid,
               {{"n_returns", 1}, {"n_rays", n}});
}

/// Full scale of a LiDAR's intensities, by the largest of a few revolutions.
float full_scale_of(const Recording& drive, const std::vector<FrameFile>& files, ThreadPool& pool) {
  constexpr std::size_t kLooked = 8;
  const std::size_t looked = std::min(kLooked, files.size());
  std::uint16_t largest = 0;
  make_in_order(
      pool, looked,
      [&](std::size_t i) {
        std::uint16_t most = 0;
        for (const LidarPoint& point : drive.read_lidar(files[i * files.size() / looked]))
          most = std::max(most, point.intensity);
        return most;
      },
      [&](std::uint16_t most) { largest = std::max(largest, most); });
  return intensity_scale(largest);
}

/// The model of a LiDAR's beams; nothing, with a note, where scans do not tell.
std::optional<BeamModel> beam_model(const Recording& drive, std::size_t lidar,
                                    const std::string& id, DriveNotes* notes) {
  std::string why;
  const auto structure = recorded_structure(drive, &why, lidar);
  if (structure) why = misfit(*structure).value_or("");
  if (why.empty() && (structure->sensor.rate_hz <= 0 || structure->sensor.azimuth_steps < 2))
    why = "times of its returns do not tell how it turns";
  if (!why.empty()) {
    notes->left_out.push_back("rows and columns of the rays of " + id + ": " + why);
    return std::nullopt;
  }
  const std::vector<FrameFile> files = drive.scans_of(lidar);
  return BeamModel(structure->sensor, drive.lidars[lidar].body_from_lidar,
                   drive.read_lidar(files[files.size() / 2]));
}

}  // namespace

WrittenSensor write_lidar(const Recording& drive, std::size_t lidar, ThreadPool& pool,
                          const std::atomic<bool>& stop, Sequence* sequence, DriveNotes* notes) {
  const RecordedLidar& sensor = drive.lidars[lidar];
  const std::vector<FrameFile> files = drive.scans_of(lidar);
  WrittenSensor written{sequence->sensor_id(sensor.name), sensor.body_from_lidar, {}, {}};
  const std::string component = sequence->component("lidars", written.id);
  const float full_scale = full_scale_of(drive, files, pool);
  const std::optional<BeamModel> beams = beam_model(drive, lidar, written.id, notes);
  if (beams) written.model = beams->json();
  const Rigid3d sensor_from_body = sensor.body_from_lidar.inverse(Eigen::Isometry);
  FrameTimes times;
  std::size_t beyond = 0, empty = 0, overlapping = 0, clamped = 0;
  Progress progress("writing LiDAR " + written.id, std::ssize(files));
  const auto make = [&](std::size_t i) {
    if (stop) throw Interrupted();
    return ray_bundle(drive.read_lidar(files[i]), sensor_from_body, beams ? &*beams : nullptr,
                      full_scale, drive, *sequence);
  };
  make_in_order(pool, files.size(), make, [&](const RayBundle& rays) {
    progress.count();
    if (rays.beyond_poses) return void(++beyond);
    if (rays.size() == 0) return void(++empty);
    if (!times.add(rays.start_us, rays.end_us)) return void(++overlapping);
    sequence->cover(rays.start_us, rays.end_us);
    clamped += rays.clamped;
    store_rays(rays, component + "/frames/" + std::to_string(rays.end_us), &sequence->store());
  });
  sequence->store().group(component + "/frames", {{"frames_timestamps_us", times.json()}});
  const auto note = [&](std::size_t n, const char* why) {
    if (n > 0)
      notes->left_out.push_back(counted(n, "LiDAR revolution") + " of " + written.id + why);
  };
  note(beyond, " without a pose");
  note(empty, " without points");
  note(overlapping, " that begin or end in the time of another one");
  if (clamped > 0)
    notes->changed.push_back(counted(clamped, "intensity value") + " of " + written.id +
                             " above full scale as 1");
  return written;
}

}  // namespace redrive::ncore
