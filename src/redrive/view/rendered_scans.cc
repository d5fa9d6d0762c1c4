// SPDX-License-Identifier: Apache-2.0
#include "redrive/view/rendered_scans.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/model/method.h"
#include "redrive/render/lidar_scan.h"
#include "redrive/render/recorded_lidar.h"

namespace redrive::view {
namespace {

using Colour = ScanRequest::Colour;

std::uint8_t colour_of(double share) {
  return static_cast<std::uint8_t>(std::lround(255 * std::clamp(share, 0.0, 1.0)));
}

/// Returns 0 for `first` to 255 for `last`, by the logarithm.
std::uint8_t logarithmic(double value, double first, double last) {
  return colour_of(std::log(std::max(value, 1e-6) / first) / std::log(last / first));
}

std::uint8_t error_colour(double error_m) { return logarithmic(error_m, 1, 0.01); }

/// Keeps every n-th ray, so that at most `most` are left.
void thin(std::size_t most, LidarFirings* firings) {
  const std::size_t step = (firings->size() + most - 1) / most;
  if (step <= 1) return;
  const auto thinned = [step](auto* values) {
    std::size_t n = 0;
    for (std::size_t i = 0; i < values->size(); i += step) (*values)[n++] = (*values)[i];
    values->resize(n);
  };
  thinned(&firings->direction);
  thinned(&firings->t_ns);
  thinned(&firings->ring);
  thinned(&firings->range_m);
}

/// Returns the distance to the nearest of the surfaces that the sensor reports along ray i.
double error_m(const LidarFirings& recorded, std::size_t i, double range_m) {
  double least = std::abs(recorded.range_m[i] - range_m);
  for (const std::size_t k : {i - 1, i + 1})
    if (k < recorded.size() && recorded.t_ns[k] == recorded.t_ns[i] &&
        (recorded.direction[k] - recorded.direction[i]).norm() < kSameRay_rad)
      least = std::min(least, std::abs(recorded.range_m[k] - range_m));
  return least;
}

nlohmann::json median(std::vector<double> values) {
  if (values.empty()) return nullptr;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

[[noreturn]] void refuse_scan(const char* field, const std::string& value,
                              const std::string& rule) {
  throw InputError("message", field, value, rule);
}

}  // namespace

std::uint8_t range_colour(double range_m) { return logarithmic(range_m, 1, 100); }

std::vector<std::string> RenderedScans::sensors() const {
  std::vector<std::string> names;
  if (!run_.field() || run_.recording.lidars.empty()) return names;
  if (!run_.recording.lidar_files.empty()) names = {"recorded", "estimated"};
  for (const LidarSensor& sensor : known_lidar_sensors()) names.push_back(sensor.name);
  return names;
}

const LidarSensor& RenderedScans::estimated() {
  if (!estimated_ && not_estimated_.empty()) {
    if (const auto found = recorded_structure(run_.recording, &not_estimated_)) {
      not_estimated_ = misfit(*found).value_or("");
      estimated_ = found->sensor;
    }
  }
  if (!not_estimated_.empty())
    refuse_scan("scan.sensor", "estimated", "cannot be estimated: " + not_estimated_);
  return *estimated_;
}

LidarFirings RenderedScans::firings(const ScanRequest& request, std::int64_t frame,
                                    std::int64_t t_ns, double* max_range_m) {
  if (request.sensor == "recorded") {
    auto recorded = recorded_firings(run_.recording, run_.scene, frame, backend_.pool());
    if (!recorded)
      refuse_scan("frame", std::to_string(frame), "the run has no LiDAR revolution of this frame");
    return *std::move(recorded);
  }
  const LidarSensor sensor =
      request.sensor == "estimated" ? estimated() : *parse_lidar_sensor(request.sensor);
  *max_range_m = sensor.max_range_m;
  return sensor.revolution(t_ns);
}

void RenderedScans::update(const ScanRequest& request, std::int64_t frame, const Scene& traffic,
                           std::optional<RenderedScan>* scan) {
  if (*scan && (*scan)->request == request && (*scan)->frame == frame) return;
  scan->reset();
  if (!run_.field()) refuse_scan("scan", request.sensor, "there is no run");
  if (run_.recording.lidars.empty())
    refuse_scan("scan.sensor", request.sensor, "the recording has no LiDAR, whose place it takes");
  const auto posed = std::ranges::find(run_.recording.frames, frame, &FramePose::id);
  if (posed == run_.recording.frames.end())
    refuse_scan("frame", std::to_string(frame), "the recording has no such frame");
  ScanOptions options{.axes = PointAxes::kWorld, .blind = run_.recording.lidars[0].blind};
  LidarFirings rays = firings(request, frame, posed->t_ns, &options.max_range_m);
  thin(find_method(run_.options.method)->rasterises ? kMostRays : kMostMarchedRays, &rays);
  Scene edited;
  if (&traffic != &run_.scene) {
    edited = run_.scene;
    edited.actors = traffic.actors;
  }
  const Scene& scene = &traffic == &run_.scene ? run_.scene : edited;
  const SensorMotion motion{scene, run_.recording.lidars[0].body_from_lidar};
  const LidarScan rendered = render_scan(backend_, *run_.field(), rays, motion, options);
  if (request.colour == Colour::kIntensity && !rendered.has_intensity)
    refuse_scan("scan.colour", "intensity", "the run's method has no intensities");
  RenderedScan made{request, frame};
  std::vector<double> errors_m;
  for (std::size_t i = 0; i < rendered.points.size(); ++i) {
    const LidarRecord& point = rendered.points[i];
    if (!rays.range_m.empty()) errors_m.push_back(error_m(rays, rendered.firing[i], point.range_m));
    made.in_world.push_back(point.position_m.cast<float>());
    made.colour.push_back(request.colour == Colour::kRange ? range_colour(point.range_m)
                          : request.colour == Colour::kIntensity
                              ? colour_of(1 - std::sqrt(point.intensity))
                              : error_colour(errors_m[i]));
  }
  if (request.colour == Colour::kError)
    for (std::size_t i = 0, next = 0; i < rays.size(); ++i) {
      if (next < rendered.firing.size() && rendered.firing[next] == i) {
        ++next;
        continue;
      }
      made.in_world.push_back(
          (motion.world_from_sensor(rays.t_ns[i]) * (double(rays.range_m[i]) * rays.direction[i]))
              .cast<float>());
      made.colour.push_back(0);
    }
  made.described = {{"rays", rays.size()},
                    {"returns", rendered.points.size()},
                    {"error_m", median(std::move(errors_m))}};
  *scan = std::move(made);
}

}  // namespace redrive::view
