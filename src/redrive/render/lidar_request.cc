// SPDX-License-Identifier: Apache-2.0
#include "redrive/render/lidar_request.h"

#include <algorithm>
#include <charconv>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/recording/core/wording.h"
#include "redrive/render/recorded_lidar.h"

namespace redrive {
namespace {

void parse_range(const std::string& text, ScanOptions* scan) {
  const char* const end = text.data() + text.size();
  const auto [colon, error] = std::from_chars(text.data(), end, scan->min_range_m);
  bool valid = error == std::errc{} && colon != end && *colon == ':';
  if (valid) {
    const auto [last, failed] = std::from_chars(colon + 1, end, scan->max_range_m);
    valid = failed == std::errc{} && last == end;
  }
  if (!valid || !(scan->min_range_m >= 0 && scan->min_range_m < scan->max_range_m &&
                  scan->max_range_m <= kMaxLidarRange_m))
    throw UsageError("--range", text, "must be MIN:MAX in metres, 0 <= MIN < MAX <= 1e4");
}

PointAxes point_axes(const std::string& name) {
  if (name == "sensor") return PointAxes::kSensor;
  if (name == "body") return PointAxes::kBody;
  if (name == "world") return PointAxes::kWorld;
  throw UsageError("--points-in", name, "must be sensor, body or world");
}

template <class Number>
void check_within(const char* option, const std::optional<Number>& value, Number least, Number most,
                  const char* rule) {
  if (value && !(*value >= least && *value <= most))
    throw UsageError(option, std::to_string(*value), rule);
}

}  // namespace

LidarRequest parse_lidar_request(const LidarOptions& options) {
  LidarRequest request{options};
  request.recorded = options.sensor == "recorded";
  if (!request.recorded && options.sensor != "estimated") {
    request.sensor = parse_lidar_sensor(options.sensor);
    if (!request.sensor) throw UsageError("--sensor", options.sensor, lidar_sensor_rule());
  }
  check_within("--azimuth-steps", options.azimuth_steps, 1, 36000, "must be in 1..36000");
  check_within("--rate", options.rate_hz, 0.1, 1000.0, "must be in 0.1..1000");
  const bool turns = !request.recorded && !(request.sensor && request.sensor->beams.empty());
  if (!turns && (options.azimuth_steps || options.rate_hz))
    throw UsageError("--sensor", options.sensor,
                     "has its own --azimuth-steps and --rate: leave them out");
  if (!options.mount.empty()) {
    request.mount = parse_mount(options.mount);
    if (!request.mount) throw UsageError("--mount", options.mount, kMountRule);
  }
  if (!options.range.empty()) parse_range(options.range, &request.scan);
  request.scan.seed = options.seed;
  request.scan.axes = point_axes(options.points_in);
  return request;
}

std::size_t lidar_index(const LidarRequest& request, const Recording& recording) {
  const std::string& name = request.options.lidar;
  if (name.empty()) return 0;
  const auto found = std::ranges::find(recording.lidars, name, &RecordedLidar::name);
  if (found != recording.lidars.end())
    return static_cast<std::size_t>(found - recording.lidars.begin());
  std::vector<std::string> names;
  for (const RecordedLidar& lidar : recording.lidars) names.push_back(lidar.name);
  throw UsageError("--lidar", name,
                   names.empty() ? "the recording has no LiDAR" : "must be " + first_few(names, 9));
}

namespace {

/// Returns for each beam the gain of the recorded beam with the nearest elevation: estimated beams
/// are ordered by elevation, rings are not.
std::vector<BeamGain> gains_by_elevation(const std::vector<BeamGain>& recorded,
                                         const std::vector<LidarBeam>& beams) {
  std::vector<BeamGain> gains;
  for (const LidarBeam& beam : beams) {
    if (recorded.empty()) break;
    const auto elevation_rad = static_cast<float>(beam.elevation_rad);
    gains.push_back(*std::ranges::min_element(recorded, {}, [&](const BeamGain& other) {
      return std::abs(other.elevation_rad - elevation_rad);
    }));
  }
  return gains;
}

}  // namespace

bool complete_sensor(const Recording& recording, LidarRequest* request) {
  const std::size_t lidar = lidar_index(*request, recording);
  if (request->is_of_recording() && lidar < recording.lidars.size())
    request->scan.gain = static_cast<float>(recording.lidars[lidar].gain);
  if (!request->mount && lidar < recording.lidars.size())
    request->scan.blind = recording.lidars[lidar].blind;
  if (request->recorded) {
    if (lidar < recording.lidars.size())
      request->scan.beam_gains = recording.lidars[lidar].beam_gains;
    return false;
  }
  const LidarOptions& options = request->options;
  const bool estimates = !request->sensor;
  if (estimates) {
    std::string why;
    const auto found = recorded_structure(recording, &why, lidar);
    if (found) why = misfit(*found).value_or("");
    if (!why.empty()) throw UsageError("--sensor", options.sensor, "cannot be estimated: " + why);
    request->sensor = found->sensor;
    request->scan.beam_gains =
        gains_by_elevation(recording.lidars[lidar].beam_gains, found->sensor.beams);
  }
  LidarSensor& sensor = *request->sensor;
  sensor.azimuth_steps = options.azimuth_steps.value_or(sensor.azimuth_steps);
  sensor.rate_hz = options.rate_hz.value_or(sensor.rate_hz);
  if (options.range.empty()) {
    request->scan.min_range_m = sensor.min_range_m;
    request->scan.max_range_m = sensor.max_range_m;
  }
  return estimates;
}

SensorMotion sensor_motion(const LidarRequest& request, const Recording& recording,
                           const Scene& scene, const SensorShift& shift) {
  if (!recording.metric)
    throw UsageError("RUN", recording.root.string(),
                     "must be of a drive: photographs have neither metres nor times");
  if (recording.lidars.empty() && (!request.mount || request.is_of_recording()))
    throw UsageError("--sensor", request.options.sensor,
                     request.is_of_recording() ? "the recording has no LiDAR"
                                               : "needs --mount: the recording has no LiDAR");
  const Rigid3d camera_from_lidar = camera_from_lidar_axes();
  const Rigid3d body_from_camera =
      request.mount ? request.mount->body_from_sensor()
                    : recording.lidars[lidar_index(request, recording)].body_from_lidar *
                          camera_from_lidar.inverse(Eigen::Isometry);
  return {scene,
          turned_sensor(body_from_camera, kRadiansPerDegree * shift.yaw_deg,
                        kRadiansPerDegree * shift.pitch_deg) *
              camera_from_lidar,
          shift.axes, shift.shift_m};
}

std::optional<LidarFirings> firings_of(const LidarRequest& request, const Recording& recording,
                                       const Scene& scene, std::int64_t frame_id,
                                       std::int64_t frame_ns, ThreadPool& pool) {
  return request.sensor
             ? std::optional(request.sensor->revolution(frame_ns))
             : recorded_firings(recording, scene, frame_id, pool, lidar_index(request, recording));
}

}  // namespace redrive
