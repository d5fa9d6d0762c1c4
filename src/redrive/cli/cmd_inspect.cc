// SPDX-License-Identifier: Apache-2.0
// redrive inspect: contents of a recording, and findings about what is missing or odd.
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include <nlohmann/json.hpp>

#include "redrive/align/preflight/preflight.h"
#include "redrive/align/tracks/patch.h"
#include "redrive/base/error.h"
#include "redrive/camera/camera.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/image/image_io.h"
#include "redrive/recording/recording.h"
#include "redrive/recording/summary.h"
#include "redrive/report/html.h"
#include "redrive/report/preflight_page.h"
#include "redrive/scene/find_moving.h"
#include "redrive/scene/lidar_returns.h"
#include "redrive/scene/load_views.h"
#include "redrive/scene/masks.h"
#include "redrive/scene/moving_file.h"
#include "redrive/scene/object_summary.h"

namespace redrive {
namespace {

struct CameraReport {
  const RecordedCamera* recorded = nullptr;
  double horizontal_fov_deg = 0;
  double percent_without_ray = 0;        ///< pixels outside the model's valid region
  std::optional<double> percent_masked;  ///< with --masks
  bool alpha = false;                    ///< whether a decoded image has an alpha channel
  std::size_t held_out = 0, masks = 0;
};

struct Inspection {
  Recording recording;
  std::optional<DriveSummary> drive;  ///< nothing for photographs
  std::vector<CameraReport> cameras;
  std::vector<Finding> findings;                      ///< odd, but the recording can be used
  std::vector<Finding> problems;                      ///< training would reject the recording
  std::optional<Preflight> preflight;                 ///< with --report
  std::optional<std::vector<ObjectSummary>> objects;  ///< with --objects
};

/// Returns the angle between the optical axis and the direction at column u of the principal row,
/// or at the nearest column towards the principal point that is in the valid region.
double angle_at_column(const Camera& camera, double u) {
  const double step = u < camera.cx ? 0.5 : -0.5;
  for (; (camera.cx - u) * step > 0; u += step) {
    if (const auto direction = camera.unproject({u, camera.cy}))
      return std::atan2(direction->head<2>().norm(), direction->z());
  }
  return 0;
}

/// Sums the angles of the two sides, so fields of view may exceed 180 degrees.
double horizontal_fov_deg(const Camera& camera) {
  const double left = angle_at_column(camera, -0.5),
               right = angle_at_column(camera, camera.width - 0.5);
  // Principal point outside the image: both edges are on the same side of the axis.
  const bool same_side = camera.cx < -0.5 || camera.cx > camera.width - 0.5;
  return (same_side ? std::abs(left - right) : left + right) * 180 / std::numbers::pi;
}

double percent_without_ray(const Camera& camera) {
  const int step = std::max(1, camera.width / 160);  // about 10^4 pixels
  int all = 0, without = 0;
  for (int v = 0; v < camera.height; v += step) {
    for (int u = 0; u < camera.width; u += step, ++all)
      without += !camera.unproject({double(u), double(v)});
  }
  return 100.0 * without / all;
}

/// Decodes the first and the last image with their masks. Training reads the others.
void check_images(const RecordedCamera& camera, CameraReport* report,
                  std::vector<Finding>* problems) {
  const CameraCalibration& calibration = camera.calibration;
  const auto size = [](const auto& of) {
    return std::to_string(of.width) + "x" + std::to_string(of.height);
  };
  const auto check = [&](const std::filesystem::path& path) {
    try {
      const Image8 image = read_image(path);
      if (image.width != calibration.width || image.height != calibration.height)
        problems->push_back({calibration.name, path.filename().string() + " has " + size(image) +
                                                   " pixels, the calibration has " +
                                                   size(calibration)});
      return !image.alpha.empty();
    } catch (const InputError& error) {
      problems->push_back({calibration.name, error.what()});
      return false;
    }
  };
  std::vector<ImageFile> images = {camera.images.front()};
  if (camera.images.size() > 1) images.push_back(camera.images.back());
  for (const ImageFile& image : images) {
    report->alpha |= check(image.path);
    if (!image.mask.path.empty()) check(image.mask.path);
  }
}

Inspection inspect(const std::string& root, const std::string& frames) {
  Inspection result;
  result.recording = open_recording(root);
  keep_frames(parse_frame_range(frames), &result.recording);
  result.findings = result.recording.findings;
  if (result.recording.metric) {
    result.drive = summarize_drive(result.recording.frames);
    result.findings.insert(result.findings.end(), result.drive->findings.begin(),
                           result.drive->findings.end());
  }
  try {
    ThreadPool pool(static_cast<int>(std::max(1u, std::thread::hardware_concurrency())));
    if (const auto lost = lost_returns_of_sample(result.recording, pool))
      result.findings.push_back(*lost);
  } catch (const InputError& error) {
    result.problems.push_back({"lidar", error.what()});
  }
  for (const RecordedCamera& recorded : result.recording.cameras) {
    const Camera camera = make_camera(recorded.calibration);
    CameraReport report{&recorded, horizontal_fov_deg(camera), percent_without_ray(camera)};
    if (report.percent_without_ray > 0) {
      char what[160];
      std::snprintf(what, sizeof what,
                    "%.1f %% of the pixels lie outside the radius where the distortion is "
                    "one-to-one; they are not used",
                    report.percent_without_ray);
      result.findings.push_back({recorded.calibration.name, what});
    }
    check_images(recorded, &report, &result.problems);
    for (const ImageFile& image : recorded.images) {
      report.held_out += image.held_out;
      report.masks += !image.mask.path.empty();
    }
    result.cameras.push_back(report);
  }
  return result;
}

/// Returns objects that move and that nobody annotated.
std::vector<MovingObject> search_moving(const Recording& recording, const Scene& scene,
                                        const MovingObjects& annotated, ThreadPool& pool) {
  if (recording.lidar_files.empty()) return {};
  return find_moving_objects(load_lidar_returns(recording, scene, annotated, pool), annotated,
                             pool);
}

/// Writes <CAM>.png and moving.json, to be edited, and <CAM>_overlay.png, to be inspected: the
/// middle image with masked pixels in red.
void write_masks(const std::filesystem::path& folder, Inspection* result) {
  std::error_code error;
  if (!std::filesystem::create_directory(folder, error)) {
    if (error) throw IoError(folder, error.message());
    throw UsageError("--masks", folder.string(),
                     "exists already; nothing is overwritten, choose another name");
  }
  ThreadPool pool(static_cast<int>(std::max(1u, std::thread::hardware_concurrency())));
  for (CameraReport& report : result->cameras) {  // one at a time, to save memory
    const CameraCalibration& calibration = report.recorded->calibration;
    SceneOptions options;
    options.cameras = {calibration.name};
    options.downscale = std::max(1, calibration.width / 640);
    const Scene scene = make_scene(result->recording, options);
    const std::vector<Image8> images = load_views(scene, pool);
    const Mask mask = find_static_mask(scene, 0, images, result->recording.metric);
    report.percent_masked =
        100.0 * static_cast<double>(mask.left_out()) / static_cast<double>(mask.used.size());
    write_mask(mask_file(folder, scene.rig[0]), mask, scene.rig[0], options.downscale);
    const std::size_t middle = images.size() / 2;
    const Mask of_view =
        view_mask(scene, scene.views[middle], mask, read_moving_objects(result->recording, scene));
    write_image(folder / (calibration.name + "_overlay.png"), overlay(images[middle], of_view));
  }
  const Scene scene = make_scene(result->recording, {});
  const std::vector<MovingObject> found =
      search_moving(result->recording, scene, read_moving_objects(result->recording, scene), pool);
  if (!found.empty()) write_moving_file(moving_file(folder), found);
}

constexpr int kPreflightMaxWidth = 640;  // pixels; wider images are downscaled

/// UsageError if the folder exists and is not empty.
void require_empty_folder(const std::filesystem::path& folder) {
  std::error_code error;
  const bool exists = std::filesystem::exists(folder, error);
  if (exists &&
      !(std::filesystem::is_directory(folder, error) && std::filesystem::is_empty(folder, error)))
    throw UsageError("--report", folder.string(),
                     "exists already; nothing is overwritten, choose another name");
}

void write_report(const std::filesystem::path& folder, Inspection* result) {
  ThreadPool pool(static_cast<int>(std::max(1u, std::thread::hardware_concurrency())));
  RigImages images = downscaled_to_width(load_rig_images(result->recording, {}, kPatchHalf, pool),
                                         kPreflightMaxWidth, kPatchHalf, pool);
  const LidarReturns lidar =
      load_lidar_returns(result->recording, images.scene, images.moving, pool);
  std::vector<LidarSample> samples;
  if (result->recording.metric && result->recording.body_from_lidar)
    samples = lidar_samples(result->recording, images.scene, lidar);
  result->preflight = check_recording(result->recording, images, samples, pool);
  if (!result->recording.lidar_files.empty()) {
    const std::vector<MovingObject> found = find_moving_objects(lidar, images.moving, pool);
    if (!found.empty())
      result->findings.push_back(
          {"moving objects", std::to_string(found.size()) +
                                 " that nobody annotated, by the LiDAR; --method splat draws them, "
                                 "other methods mask them"});
    images.moving = images.moving.with(found);
  }
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw IoError(folder, error.message());
  write_preflight_page(folder, result->recording, images, lidar, *result->preflight);
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
      scan.push_back({{"offset_ms", p.offset_ms}, {"error_px", p.error_px}});
    for (const ContrastPoint& p : c.contrast)
      contrast.push_back({{"offset_ms", p.offset_ms}, {"correlation", p.correlation}});
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
      camera["best_offset"] = {{"offset_ms", c.offset_ms},
                               {"sigma_ms", c.offset_sigma_ms},
                               {"error_px", c.offset_error_px}};
    camera["clock"] = nullptr;  // unobservable
    if (const auto offset = c.time_offset())
      camera["clock"] = {{"offset_ms", offset->offset_ms},
                         {"sigma_ms", offset->sigma_ms},
                         {"by", offset->by_lidar ? "lidar" : "images"}};
    camera["edge_score"] = nullptr;  // the LiDAR is too sparse
    if (c.edges) camera["edge_score"] = {{"score", c.edges->score()}, {"edges", c.edges->edges}};
    camera["tried"] = tried;
    camera["scan"] = scan;
    camera["contrast"] = contrast;
    cameras.push_back(camera);
  }
  return {{"sensible", preflight.passes()},
          {"headline", preflight.headline()},
          {"clock",
           {{"verdict", verdict_name(preflight.clock.verdict)},
            {"frame_seconds_per_lidar_second", preflight.clock.frame_seconds_per_lidar_second},
            {"why", preflight.clock.why}}},
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
         {"driven_m", o.driven_m},
         {"nearest_m", std::isfinite(o.nearest_m) ? nlohmann::json(o.nearest_m) : nullptr},
         {"images", o.images}});
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

nlohmann::json findings_to_json(const std::vector<Finding>& findings) {
  nlohmann::json list = nlohmann::json::array();
  for (const Finding& finding : findings)
    list.push_back({{"subject", finding.subject}, {"what", finding.what}});
  return list;
}

nlohmann::ordered_json to_json(const Inspection& result) {
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
  nlohmann::ordered_json objects;  // null without --objects
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
          {"box_files", recording.box_files.size()},
          {"other_sensors", recording.other_sensors},
          {"novel", novel},
          {"findings", findings_to_json(result.findings)},
          {"problems", findings_to_json(result.problems)},
          {"objects", objects},
          {"preflight", preflight}};
}

void print_findings(const char* title, const std::vector<Finding>& findings) {
  std::printf("%s\n", title);
  for (const Finding& finding : findings)
    std::printf("  %s: %s\n", finding.subject.c_str(), finding.what.c_str());
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
  std::printf("%s\n\n", preflight.headline().c_str());
}

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
  std::printf("lidar          %zu files\nboxes          %zu files\n", recording.lidar_files.size(),
              recording.box_files.size());
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

/// Returns annotated objects, and those that move and that nobody annotated.
std::vector<ObjectSummary> list_objects(const Recording& recording) {
  const Scene scene = make_scene(recording, {});
  const MovingObjects annotated = read_moving_objects(recording, scene);
  ThreadPool pool(static_cast<int>(std::max(1u, std::thread::hardware_concurrency())));
  return summarize_objects(scene, annotated.with(search_moving(recording, scene, annotated, pool)));
}

struct InspectOptions {
  std::string recording, frames, masks, report;
  bool json = false, objects = false;
};

int run_inspect(const InspectOptions& options) {
  const auto& [root, frames, masks, report, json, objects] = options;
  if (!report.empty()) require_empty_folder(report);
  Inspection result = inspect(root, frames);
  if (objects && result.problems.empty()) result.objects = list_objects(result.recording);
  if (!masks.empty() && result.problems.empty()) write_masks(masks, &result);
  if (!report.empty() && result.problems.empty()) write_report(report, &result);
  if (json) {
    // JSON must be UTF-8; file names need not be.
    std::printf(
        "%s\n",
        to_json(result).dump(2, ' ', false, nlohmann::json::error_handler_t::replace).c_str());
  } else {
    print_inspection(result);
  }
  if (!result.problems.empty()) return kExitBadInput;
  return !result.preflight || result.preflight->passes() ? kExitOk : kExitPreflightFailed;
}

}  // namespace

Action configure_inspect(CLI::App& command) {
  auto options = std::make_shared<InspectOptions>();
  command.add_option("RECORDING", options->recording, "folder of the recording")->required();
  add_frames_option(command, &options->frames);
  command.add_flag("--json", options->json, "JSON on standard output instead of the table");
  command.add_flag("--objects", options->objects,
                   "lists annotated objects, and ones that move by the LiDAR: type, moving or "
                   "parked, boxes, metres driven, least distance, images");
  command.add_option(
      "--masks", options->masks,
      "new folder for masks of pixels that training ignores: CAM.png and, where the LiDAR finds "
      "moving objects that nobody annotated, moving.json, to be edited, and CAM_overlay.png, to "
      "inspect them");
  command.add_option(
      "--report", options->report,
      "new folder for a page (index.html) that checks calibration, poses and time offsets "
      "against the images");
  return [options] { return run_inspect(*options); };
}

}  // namespace redrive
