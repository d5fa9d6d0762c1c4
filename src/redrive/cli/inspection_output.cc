// SPDX-License-Identifier: Apache-2.0
// Findings of inspect, as JSON and as text.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include <nlohmann/json.hpp>

#include "redrive/cli/inspection.h"
#include "redrive/cli/json_output.h"
#include "redrive/math/angles.h"
#include "redrive/recording/parse/rigid_json.h"
#include "redrive/report/html.h"

namespace redrive {
namespace {

nlohmann::ordered_json structure_to_json(const ScanStructure& structure) {
  const LidarSensor& lidar = structure.sensor;
  nlohmann::ordered_json elevations = nlohmann::ordered_json::array(), azimuths = elevations, rate;
  for (const LidarBeam& beam : lidar.beams) {
    elevations.push_back(kDegreesPerRadian * beam.elevation_rad);
    azimuths.push_back(kDegreesPerRadian * beam.azimuth_rad);
  }
  if (lidar.rate_hz > 0) rate = lidar.rate_hz;
  return {{"azimuth_steps", lidar.azimuth_steps},
          {"rate_hz", rate},
          {"clockwise", lidar.clockwise},
          {"residual_deg", kDegreesPerRadian * structure.residual_rad},
          {"range_m", {lidar.min_range_m, lidar.max_range_m}},
          {"second_returns", structure.second_returns},
          {"intensity_scale", structure.intensity_scale},
          {"elevation_deg", elevations},
          {"azimuth_deg", azimuths}};
}

nlohmann::ordered_json preflight_to_json(const Preflight& preflight) {
  nlohmann::ordered_json cameras = nlohmann::ordered_json::array();
  for (const CameraCheck& c : preflight.cameras) {
    nlohmann::ordered_json tried = nlohmann::ordered_json::array(),
                           scan = nlohmann::ordered_json::array();
    for (const Hypothesis& h : c.tried)
      tried.push_back({{"fault", fault_name(h.fault)}, {"what", h.what}, {"error_px", h.error_px}});
    nlohmann::ordered_json contrast = nlohmann::ordered_json::array();
    for (const ScanPoint& p : c.scan)
      scan.push_back({{"time_offset_s", 1e-3 * p.offset_ms}, {"error_px", p.error_px}});
    for (const ContrastPoint& p : c.contrast)
      contrast.push_back({{"time_offset_s", 1e-3 * p.offset_ms}, {"correlation", p.correlation}});
    nlohmann::ordered_json camera = {{"name", c.name},
                                     {"verdict", verdict_name(c.verdict)},
                                     {"fault", fault_name(c.fault)},
                                     {"why", c.why},
                                     {"points", c.points},
                                     {"recorded_px_per_px", c.scale}};
    if (!c.tried.empty()) {
      camera["error_px"] = c.tried[0].error_px;
      camera["flow_px"] = c.flow_px;
    }
    if (c.offset_observable)
      camera["best_offset"] = {{"time_offset_s", 1e-3 * c.offset_ms},
                               {"sigma_s", 1e-3 * c.offset_sigma_ms},
                               {"error_px", c.offset_error_px}};
    camera["time_offset"] = nullptr;  // unobservable
    if (const auto offset = c.time_offset())
      camera["time_offset"] = {{"time_offset_s", 1e-3 * offset->offset_ms},
                               {"sigma_s", 1e-3 * offset->sigma_ms},
                               {"by", offset->by_lidar ? "lidar" : "images"}};
    camera["edge_score"] = nullptr;  // the LiDAR is too sparse
    if (c.edges) camera["edge_score"] = {{"score", c.edges->score()}, {"edges", c.edges->edges}};
    camera["odd_pairs"] = nlohmann::ordered_json::array();
    for (const OddPair& pair : c.odd_pairs)
      camera["odd_pairs"].push_back(
          {{"frames", {pair.first_id, pair.last_id}}, {"error_px", pair.error_px}});
    camera["tried"] = tried;
    camera["scan"] = scan;
    camera["contrast"] = contrast;
    cameras.push_back(camera);
  }
  nlohmann::ordered_json shared = nlohmann::ordered_json::object();
  for (const SharedCheck& check : preflight.shared)
    shared[check.name] = {{"verdict", verdict_name(check.verdict)}, {"why", check.why}};
  return {{"sensible", preflight.passes()},
          {"headline", preflight.headline()},
          {"clock",
           {{"verdict", verdict_name(preflight.clock.verdict)},
            {"frame_seconds_per_lidar_second", preflight.clock.frame_seconds_per_lidar_second},
            {"why", preflight.clock.why}}},
          {"shared", shared},
          {"cameras", cameras}};
}

nlohmann::ordered_json objects_to_json(const std::vector<ObjectSummary>& objects) {
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (const ObjectSummary& o : objects)
    list.push_back(
        {{"id", o.id},
         {"type", o.type},
         {"moves", o.moves},
         {"boxes", o.boxes},
         {"distance_m", o.driven_m},
         {"nearest_m", std::isfinite(o.nearest_m) ? nlohmann::json(o.nearest_m) : nullptr},
         {"images", o.images}});
  return list;
}

nlohmann::ordered_json lidars_to_json(const Inspection& result) {
  const Recording& recording = result.recording;
  nlohmann::ordered_json list = nlohmann::ordered_json::array();
  for (std::size_t k = 0; k < recording.lidars.size(); ++k) {
    const RecordedLidar& lidar = recording.lidars[k];
    nlohmann::ordered_json beams;  // null where they are not known
    if (k < result.lidars.size() && result.lidars[k]) beams = structure_to_json(*result.lidars[k]);
    list.push_back({{"name", lidar.name},
                    {"files", recording.scans_of(k).size()},
                    {"body_from_lidar", rigid_to_json(lidar.body_from_lidar)},
                    {"elevation_offset_deg", kDegreesPerRadian * lidar.elevation_rad},
                    {"beams", beams}});
  }
  return list;
}

void print_objects(const std::vector<ObjectSummary>& objects) {
  std::printf("%-12s %-20s %-8s %6s %9s %10s %7s\n", "object", "type", "", "boxes", "driven m",
              "nearest m", "images");
  for (const ObjectSummary& o : objects)
    std::printf("%-12lld %-20s %-8s %6zu %9.1f %10.1f %7zu\n", static_cast<long long>(o.id),
                o.type.c_str(), o.moves ? "moves" : "parked", o.boxes, o.driven_m, o.nearest_m,
                o.images);
}

}  // namespace

nlohmann::ordered_json inspection_to_json(const Inspection& result) {
  const Recording& recording = result.recording;
  nlohmann::ordered_json cameras = nlohmann::ordered_json::array();
  for (const CameraReport& report : result.cameras) {
    const CameraCalibration& c = report.recorded->calibration;
    const auto camera_position_m = c.body_from_sensor.translation();
    nlohmann::ordered_json camera = {
        {"name", c.name},
        {"model", c.model},
        {"width", c.width},
        {"height", c.height},
        {"focal_length_px", {c.fx(), c.fy()}},
        {"principal_point_px", {c.cx(), c.cy()}},
        {"distortion_coeffs", distortion(c)},
        {"horizontal_fov_deg", report.horizontal_fov_deg},
        {"percent_without_ray", report.percent_without_ray},
        {"grey", report.grey},
        {"position_in_body_m",
         {camera_position_m.x(), camera_position_m.y(), camera_position_m.z()}},
        {"images", report.recorded->images.size()},
        {"held_out", report.held_out},
        {"masks", report.masks},
        {"alpha", report.alpha},
        {"first_id", report.recorded->images.front().frame_id},
        {"last_id", report.recorded->images.back().frame_id}};
    for (const auto& [name, value] : other_parameters(c)) camera[name] = value;
    if (report.percent_masked) camera["percent_masked"] = *report.percent_masked;
    cameras.push_back(camera);
  }
  nlohmann::json novel = nlohmann::json::array();
  for (const NovelSet& set : recording.novel)
    novel.push_back({{"name", set.name}, {"poses_file", set.poses_file.string()}});
  nlohmann::json bounds, drive, rate_hz, duration_s;  // null for photographs or unbounded scenes
  if (recording.bounds) {
    const Eigen::Vector3d& center = recording.bounds->center;
    bounds = {{"center", {center.x(), center.y(), center.z()}},
              {"half_side", recording.bounds->half_side}};
  }
  if (result.drive) {
    rate_hz = result.drive->rate_hz;
    duration_s = result.drive->duration_s;
    drive = {{"length_m", result.drive->path_length_m},
             {"mean_speed_m_per_s", result.drive->mean_speed_m_per_s},
             {"max_speed_m_per_s", result.drive->max_speed_m_per_s}};
  }
  nlohmann::ordered_json preflight;  // null without --report
  if (result.preflight) preflight = preflight_to_json(*result.preflight);
  nlohmann::ordered_json objects;  // null without --actors
  if (result.objects) objects = objects_to_json(*result.objects);
  return {{"recording", recording.root.string()},
          {"format", recording.format},
          {"metric", recording.metric},
          {"usable", result.problems.empty()},
          {"cameras", cameras},
          {"frames",
           {{"count", recording.frames.size()},
            {"first_id", recording.frames.front().id},
            {"last_id", recording.frames.back().id},
            {"rate_hz", rate_hz},
            {"duration_s", duration_s}}},
          {"drive", drive},
          {"bounds", bounds},
          {"lidar_files", recording.lidar_files.size()},
          {"lidars", lidars_to_json(result)},
          {"box_files", recording.box_files.size()},
          {"other_sensors", recording.other_sensors},
          {"novel", novel},
          {"findings", findings_to_json(result.findings)},
          {"problems", findings_to_json(result.problems)},
          {"objects", objects},
          {"preflight", preflight}};
}

namespace {

void print_findings(const char* title, const std::vector<Finding>& findings) {
  std::printf("%s\n", title);
  for (const Finding& finding : findings)
    std::printf("  %s: %s\n", finding.subject.c_str(), finding.what.c_str());
}

void print_structure(const ScanStructure& structure) {
  const LidarSensor& lidar = structure.sensor;
  std::printf("               %zu beams from %.2f to %.2f degrees, %d steps a turn",
              lidar.beams.size(), kDegreesPerRadian * lidar.beams.front().elevation_rad,
              kDegreesPerRadian * lidar.beams.back().elevation_rad, lidar.azimuth_steps);
  if (lidar.rate_hz > 0)
    std::printf(", %.2f Hz %s", lidar.rate_hz, lidar.clockwise ? "clockwise" : "anticlockwise");
  std::printf("\n               residual of elevations %.3f degrees, ranges %.1f to %.1f m",
              kDegreesPerRadian * structure.residual_rad, lidar.min_range_m, lidar.max_range_m);
  if (structure.second_returns > 0.005)
    std::printf(", two returns for %.0f %% of the rays", 100 * structure.second_returns);
  std::printf("\n               intensities 0 to %d\n", structure.intensity_scale);
}

void print_lidars(const Inspection& result) {
  const Recording& recording = result.recording;
  if (recording.lidars.empty())
    std::printf("lidar          %zu files\n", recording.lidar_files.size());
  for (std::size_t k = 0; k < recording.lidars.size(); ++k) {
    const RecordedLidar& lidar = recording.lidars[k];
    const Eigen::Vector3d at = lidar.body_from_lidar.translation();
    std::printf("lidar          %zu files of %s, at %.2f %.2f %.2f m in the body\n",
                recording.scans_of(k).size(), lidar.name.c_str(), at.x(), at.y(), at.z());
    const bool known = k < result.lidars.size() && result.lidars[k];
    if (known) print_structure(*result.lidars[k]);
    if (known && lidar.elevation_rad != 0)
      std::printf("               elevations corrected by %+.3f degrees\n",
                  kDegreesPerRadian * lidar.elevation_rad);
  }
}

void print_preflight(const Preflight& preflight) {
  std::printf("%-24s %-12s %9s %8s %6s  %s\n", "preflight", "verdict", "error px", "points",
              "edges", "why");
  for (const CameraCheck& c : preflight.cameras)
    std::printf("%-24s %-12s %9.2f %8d %6s  %s\n", c.name.c_str(), verdict_name(c.verdict),
                c.tried.empty() ? 0 : c.tried[0].error_px, c.points,
                c.edges ? fixed(c.edges->score(), 3).c_str() : "-", c.why.c_str());
  std::printf("%-24s %-12s %9s %8s %6s  %s\n", "clock", verdict_name(preflight.clock.verdict), "",
              "", "", preflight.clock.why.c_str());
  for (const SharedCheck& check : preflight.shared)
    std::printf("%-24s %-12s %9s %8s %6s  %s\n", check.name.c_str(), verdict_name(check.verdict),
                "", "", "", check.why.c_str());
  std::printf("%s\n\n", preflight.headline().c_str());
}

}  // namespace

void print_inspection(const Inspection& result) {
  const Recording& recording = result.recording;
  std::printf("%s (%s)\n\n", recording.root.c_str(), recording.format.c_str());
  std::printf("%-24s %-14s %11s %8s %8s %9s %6s  %s\n", "camera", "model", "pixels", "fx px",
              "fy px", "h-fov deg", "images", "position in body m");
  for (const CameraReport& report : result.cameras) {
    const CameraCalibration& c = report.recorded->calibration;
    const auto camera_position_m = c.body_from_sensor.translation();
    const std::string size = std::to_string(c.width) + "x" + std::to_string(c.height);
    std::printf("%-24s %-14s %11s %8.1f %8.1f %9.1f %6zu  %.2f %.2f %.2f\n", c.name.c_str(),
                c.model.c_str(), size.c_str(), c.fx(), c.fy(), report.horizontal_fov_deg,
                report.recorded->images.size(), camera_position_m.x(), camera_position_m.y(),
                camera_position_m.z());
  }
  for (const CameraReport& report : result.cameras)
    if (report.percent_masked)
      std::printf("%smask of %s: %.1f %% of the pixels are masked\n",
                  &report == &result.cameras[0] ? "\n" : "",
                  report.recorded->calibration.name.c_str(), *report.percent_masked);
  std::printf("\nframes         %zu, ids %lld to %lld", recording.frames.size(),
              static_cast<long long>(recording.frames.front().id),
              static_cast<long long>(recording.frames.back().id));
  if (const auto& drive = result.drive) {
    std::printf(", %.2f Hz, %.2f s\ndriven         %.1f m, mean %.2f m/s, at most %.2f m/s\n",
                drive->rate_hz, drive->duration_s, drive->path_length_m, drive->mean_speed_m_per_s,
                drive->max_speed_m_per_s);
  } else {
    std::printf(" in file-name order; neither metric scale nor timestamps\n");
  }
  if (const auto& bounds = recording.bounds)
    std::printf("bounds         %g around %g %g %g along each axis\n", bounds->half_side,
                bounds->center.x(), bounds->center.y(), bounds->center.z());
  std::size_t held_out = 0, masks = 0;
  bool alpha = false;
  for (const CameraReport& report : result.cameras) {
    held_out += report.held_out;
    masks += report.masks;
    alpha |= report.alpha;
  }
  if (held_out > 0)
    std::printf("held out       %zu images by the recording's own split\n", held_out);
  if (masks > 0) std::printf("masks          %zu\n", masks);
  if (alpha) std::printf("alpha          yes: train takes --background white, black or random\n");
  if (!recording.points_file.empty())
    std::printf("points         %s\n", recording.points_file.c_str());
  print_lidars(result);
  std::printf("boxes          %zu files\n", recording.box_files.size());
  std::string others, novel;
  for (const std::string& sensor : recording.other_sensors)
    others += (others.empty() ? "" : ", ") + sensor;
  for (const NovelSet& set : recording.novel) novel += (novel.empty() ? "" : ", ") + set.name;
  std::printf("other sensors  %s\n", others.empty() ? "none" : others.c_str());
  std::printf("novel views    %s\n\n", novel.empty() ? "none" : novel.c_str());
  if (result.objects) print_objects(*result.objects);
  if (result.preflight) print_preflight(*result.preflight);
  if (!result.findings.empty()) print_findings("findings", result.findings);
  if (!result.problems.empty()) print_findings("NOT USABLE", result.problems);
  if (result.findings.empty() && result.problems.empty())
    std::printf("nothing missing, nothing odd\n");
}

nlohmann::ordered_json mapping_to_json(const Mapping& mapping) {
  nlohmann::ordered_json streams = nlohmann::ordered_json::array(), out;
  for (const Stream& stream : mapping.streams)
    streams.push_back({{"name", stream.name},
                       {"type", stream.type},
                       {"frame", stream.frame},
                       {"messages", stream.messages},
                       {"rate_hz", stream.rate_hz()},
                       {"first_ns", stream.first_ns},
                       {"last_ns", stream.last_ns}});
  out["file"] = mapping.file.string();
  out["is_there"] = mapping.is_there;
  out["proposed"] = mapping.text;
  out["questions"] = mapping.questions;
  out["streams"] = streams;
  return out;
}

void print_mapping(const Mapping& mapping) {
  std::printf("%-44s %-32s %8s %8s %9s %9s  %s\n", "topic", "type", "messages", "Hz", "first s",
              "last s", "frame");
  std::int64_t start_ns = std::numeric_limits<std::int64_t>::max();
  for (const Stream& stream : mapping.streams)
    if (stream.messages > 0) start_ns = std::min(start_ns, stream.first_ns);
  for (const Stream& stream : mapping.streams)
    if (stream.messages > 0)
      std::printf("%-44s %-32s %8llu %8.2f %9.3f %9.3f  %s\n", stream.name.c_str(),
                  stream.type.c_str(), static_cast<unsigned long long>(stream.messages),
                  stream.rate_hz(), 1e-9 * static_cast<double>(stream.first_ns - start_ns),
                  1e-9 * static_cast<double>(stream.last_ns - start_ns), stream.frame.c_str());
  if (mapping.is_there)
    std::printf("\nmapped by %s\n\n", mapping.file.c_str());
  else
    std::printf("\nproposed %s:\n\n%s\n", mapping.file.filename().c_str(), mapping.text.c_str());
  if (!mapping.questions.empty()) std::printf("to decide\n");
  for (const std::string& question : mapping.questions) std::printf("  %s\n", question.c_str());
}

}  // namespace redrive
