// SPDX-License-Identifier: Apache-2.0
// redrive inspect: contents of a recording, and findings about what is missing or odd.
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <vector>

#include "redrive/align/preflight/drive_checks.h"
#include "redrive/align/tracks/patch.h"
#include "redrive/base/cpu_features.h"
#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/unfinished.h"
#include "redrive/camera/camera.h"
#include "redrive/camera/ray_share.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/inspection.h"
#include "redrive/cli/json_output.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/export/bundle/check_bundle.h"
#include "redrive/image/image_io.h"
#include "redrive/perception/find_moving.h"
#include "redrive/perception/masks.h"
#include "redrive/perception/moving_file.h"
#include "redrive/recording/core/camera_choice.h"
#include "redrive/recording/core/wording.h"
#include "redrive/recording/formats/damaged_records.h"
#include "redrive/recording/formats/recording_reader.h"
#include "redrive/render/open_to_render.h"
#include "redrive/render/recorded_lidar.h"
#include "redrive/report/preflight_page.h"
#include "redrive/scene/lidar/lidar_returns.h"
#include "redrive/scene/load_views.h"

namespace redrive {
namespace {

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

/// Decodes the first and the last image with their masks. Training reads all.
void check_images(const RecordedCamera& camera, CameraReport* report, Inspection* result) {
  std::vector<Finding>* const problems = &result->problems;
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
      if (is_black(image))
        result->findings.push_back({calibration.name, path.filename().string() + " is black"});
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

/// Adds what contradicts the calibration: a large part of the image without a ray, and the file's
/// own words.
void check_calibration(const RecordedCamera& camera, double percent, Inspection* result) {
  const std::string& name = camera.calibration.name;
  if (percent > kMostWithoutRay)
    result->problems.push_back(
        {name, without_ray_text(percent) + ": that is no calibration of a lens"});
  else if (percent > 0)
    result->findings.push_back({name, without_ray_text(percent) + "; they are not used"});
  if (const auto focal = contradicted_focal_length(camera)) result->findings.push_back(*focal);
}

/// Reads the middle scan and looks for its returns in the images.
void check_lidar(const Scene& scene, ThreadPool& pool, Inspection* result) {
  const Recording& recording = result->recording;
  const std::vector<FrameFile> scans = recording.scans_of(recording.lidar_files[0].lidar);
  const std::int64_t middle = scans[scans.size() / 2].frame_id;
  const LidarReturns lidar = load_lidar_returns(recording, scene, {}, pool,
                                                {[&](std::int64_t id) { return id == middle; }});
  if (const SharedCheck check = check_lidar_in_images(scene, lidar);
      check.verdict == Verdict::kWrong)
    result->findings.push_back({"lidar of frame " + std::to_string(middle), check.why});
}

/// Estimates the LiDARs' beams and adds a finding where they do not fit the returns.
void find_beams(Inspection* result) {
  const Recording& recording = result->recording;
  result->lidars.resize(recording.lidars.size());
  for (std::size_t k = 0; k < recording.lidars.size(); ++k) {
    if (recording.scans_of(k).empty()) continue;
    const std::string name = recording.lidars.size() > 1 ? recording.lidars[k].name : "lidar";
    std::string why;
    const auto structure = result->lidars[k] = recorded_structure(recording, &why, k);
    if (structure) why = misfit(*structure).value_or("");
    if (!why.empty()) result->findings.push_back({name, why});
  }
}

struct InspectOptions {
  std::string recording, frames, actors, masks, report;
  std::vector<std::string> cameras;
  double max_damaged = kMostDamagedPercent;
  int threads = 0;
  bool json = false, outside_files = false, write_rig = false;
};

Inspection inspect(const InspectOptions& options, ThreadPool& pool) {
  constexpr std::size_t kWhole = 8;  // records of each sensor that are read from end to end
  Inspection result;
  result.recording =
      open_recording(options.recording, PoseSource::kRecorded, options.outside_files);
  keep_frames(parse_frame_range(options.frames), &result.recording);
  keep_cameras(options.cameras, &result.recording);
  result.problems =
      leave_out_damaged({.most_percent = options.max_damaged,
                         .whole = options.report.empty() ? kWhole : DamageCheck::kAll},
                        &result.recording);
  if (result.recording.cameras.empty())
    throw InputError(options.recording, result.problems[0].subject, "", result.problems[0].what);
  result.findings = result.recording.findings;
  if (result.recording.metric) {
    result.drive = summarize_drive(result.recording.frames);
    result.findings.insert(result.findings.end(), result.drive->findings.begin(),
                           result.drive->findings.end());
  }
  const std::vector<std::string> grey = grey_cameras(result.recording);
  std::optional<Scene> scene;  // only where there are scans
  try {
    if (result.recording.lidar_files.empty() && !result.recording.points_file.empty())
      result.recording.reader->read_points(result.recording);
  } catch (const InputError& error) {
    result.problems.push_back({"points", error.what()});
  }
  try {
    if (!result.recording.lidars.empty() && !result.recording.lidar_files.empty())
      scene = make_scene(result.recording, {});
    const LidarReturns sample =
        scene ? sample_returns(result.recording, *scene, pool) : LidarReturns();
    if (const auto lost = lost_returns(sample)) result.findings.push_back(*lost);
    if (const auto unusable = unusable_returns(sample); unusable && options.report.empty())
      result.findings.push_back(*unusable);
    find_beams(&result);
  } catch (const InputError& error) {
    result.problems.push_back({"lidar", error.what()});
  }
  for (const RecordedCamera& recorded : result.recording.cameras) {
    const Camera camera = make_camera(recorded.calibration);
    CameraReport report{&recorded, horizontal_fov_deg(camera), percent_without_ray(camera)};
    check_calibration(recorded, report.percent_without_ray, &result);
    check_images(recorded, &report, &result);
    for (const ImageFile& image : recorded.images) {
      report.held_out += image.held_out;
      report.masks += !image.mask.path.empty();
    }
    report.grey = std::ranges::find(grey, recorded.calibration.name) != grey.end();
    result.cameras.push_back(report);
  }
  if (!grey.empty() && grey.size() < result.cameras.size())
    result.findings.push_back({first_few(grey),
                               "grey: train leaves them out beside colour cameras "
                               "unless --cameras names them"});
  if (result.problems.empty() && scene) check_lidar(*scene, pool, &result);
  return result;
}

/// Returns moving objects that nobody annotated.
std::vector<MovingObject> search_moving(const Recording& recording, const Scene& scene,
                                        const MovingObjects& annotated, ThreadPool& pool) {
  if (recording.lidar_files.empty()) return {};
  return find_moving_objects(scene, load_lidar_returns(recording, scene, annotated, pool),
                             annotated, pool);
}

/// Writes <CAM>.png and moving.json, to be edited, and <CAM>_overlay.png, to be inspected: the
/// middle image with masked pixels in red.
void write_masks(const std::filesystem::path& folder, ThreadPool& pool, Inspection* result) {
  for (CameraReport& report : result->cameras) {  // one at a time, to save memory
    const CameraCalibration& calibration = report.recorded->calibration;
    SceneOptions options;
    options.cameras = {calibration.name};
    options.downscale = std::max(1, calibration.width / 640);
    const Scene scene = make_scene(result->recording, options);
    DamagedViews damaged;
    const std::vector<Image8> images = load_views(scene, pool, &damaged);
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
void require_empty_folder(const char* option, const std::filesystem::path& folder) {
  std::error_code error;
  const bool exists = std::filesystem::exists(folder, error);
  if (exists &&
      !(std::filesystem::is_directory(folder, error) && std::filesystem::is_empty(folder, error)))
    throw UsageError(option, folder.string(),
                     "exists already; nothing is overwritten, choose another name");
}

void write_report(const std::filesystem::path& folder, ThreadPool& pool, Inspection* result) {
  RigImages images = downscaled_to_width(load_rig_images(result->recording, {}, kPatchHalf, pool),
                                         kPreflightMaxWidth, kPatchHalf, pool);
  const LidarReturns lidar =
      load_lidar_returns(result->recording, images.scene, images.moving, pool);
  if (lidar.damaged) result->findings.push_back(*lidar.damaged);
  if (const auto unusable = unusable_returns(lidar)) result->findings.push_back(*unusable);
  std::vector<LidarSample> samples;
  if (result->recording.metric && !result->recording.lidars.empty())
    samples = lidar_samples(result->recording, lidar);
  result->preflight = check_recording(result->recording, images, samples, pool);
  if (lidar.n > 0) result->preflight->shared.push_back(check_lidar_in_images(images.scene, lidar));
  const std::vector<Finding> black = find_black_images(images);
  result->findings.insert(result->findings.end(), black.begin(), black.end());
  if (!result->recording.lidar_files.empty()) {
    const std::vector<MovingObject> found =
        find_moving_objects(images.scene, lidar, images.moving, pool);
    if (!found.empty())
      result->findings.push_back(
          {"moving objects", std::to_string(found.size()) +
                                 " that nobody annotated, by the LiDAR; --method splat draws them, "
                                 "other methods mask them"});
    images.moving = images.moving.with(found);
  }
  write_folder(folder, /*replace=*/false, [&](const std::filesystem::path& made) {
    write_preflight_page(made, result->recording, images, lidar, *result->preflight);
  });
}

/// Returns the annotated objects, and moving ones that nobody annotated, that --actors chooses.
std::vector<ObjectSummary> list_objects(const Recording& recording, const std::string& chosen,
                                        ThreadPool& pool) {
  const Scene scene = make_scene(recording, {});
  const MovingObjects annotated = read_moving_objects(recording, scene);
  std::vector<ObjectSummary> objects =
      summarize_objects(scene, annotated.with(search_moving(recording, scene, annotated, pool)));
  Scene listed;
  for (const ObjectSummary& object : objects) listed.actors.emplace_back().id = object.id;
  select_actors(chosen, &listed);
  std::erase_if(objects, [&](const ObjectSummary& object) {
    return std::ranges::find(listed.actors, object.id, &MovingObject::id) == listed.actors.end();
  });
  return objects;
}

/// Shows the streams of a recording that needs a mapping, and the proposed one, which --write-rig
/// writes. Returns false where it leaves open what has to be decided first.
bool show_mapping(const InspectOptions& options, std::optional<Mapping>* mapping) {
  *mapping = mapping_of(options.recording);
  if (!*mapping) {
    if (options.write_rig)
      throw UsageError("--write-rig", "", "is for bags of ROS 2, whose topics have to be mapped");
    return true;
  }
  if (options.write_rig && (*mapping)->is_there)
    throw UsageError("--write-rig", (*mapping)->file.string(), "exists already; edit it");
  if (!options.json) print_mapping(**mapping);
  if (options.write_rig) write_file((*mapping)->file, (*mapping)->text);
  if (options.write_rig && !options.json) std::printf("written to %s\n", (*mapping)->file.c_str());
  if ((*mapping)->questions.empty()) return true;
  if (options.json) print_json(mapping_to_json(**mapping));
  return false;
}

/// Shows a scene bundle, and what AlpaSim and CARLA miss in it.
int inspect_bundle(const InspectOptions& options) {
  const BundleReport report = check_bundle(options.recording);
  const bool complete = report.alpasim.empty() && report.carla.empty() && report.run_damage.empty();
  if (options.json) {
    nlohmann::ordered_json members = nlohmann::ordered_json::object();
    for (const BundleReport::Member& member : report.members) members[member.name] = member.bytes;
    const auto list = [](const std::vector<BundleGap>& gaps) {
      nlohmann::ordered_json all = nlohmann::ordered_json::array();
      for (const BundleGap& gap : gaps)
        all.push_back({{"member", gap.member}, {"field", gap.field}, {"what", gap.what}});
      return all;
    };
    print_json(nlohmann::ordered_json{{"scene_id", report.scene_id},
                                      {"members", members},
                                      {"alpasim", list(report.alpasim)},
                                      {"carla", list(report.carla)},
                                      {"remarks", list(report.remarks)},
                                      {"has_run", report.has_run},
                                      {"run_damage", report.run_damage}});
    return complete ? kExitOk : kExitBadInput;
  }
  std::printf("scene bundle, scene %s\n", report.scene_id.empty() ? "?" : report.scene_id.c_str());
  for (const BundleReport::Member& member : report.members)
    std::printf("  %12llu  %s\n", static_cast<unsigned long long>(member.bytes),
                member.name.c_str());
  const auto print = [](const char* who, const std::vector<BundleGap>& gaps, const char* none) {
    if (gaps.empty()) std::printf("%s: %s\n", who, none);
    for (const BundleGap& gap : gaps)
      std::printf("%s: %s%s%s %s\n", who, gap.member.c_str(), gap.field.empty() ? "" : ": ",
                  gap.field.c_str(), gap.what.c_str());
  };
  print("AlpaSim", report.alpasim, "nothing is missing");
  print("CARLA", report.carla, "nothing is missing");
  for (const BundleGap& gap : report.remarks) print("remark", {gap}, "");
  if (!report.run_damage.empty())
    std::printf("redrive: serve cannot render its run: %s\n", report.run_damage.c_str());
  else
    std::printf("redrive: %s\n", report.has_run
                                     ? "its run is inside, which serve takes"
                                     : "no run is inside; serve cannot render the scene");
  return complete ? kExitOk : kExitBadInput;
}

int run_inspect(const InspectOptions& options) {
  if (is_scene_bundle(options.recording)) return inspect_bundle(options);
  const std::string &masks = options.masks, &report = options.report;
  if (!masks.empty()) require_empty_folder("--masks-out", masks);
  if (!report.empty()) require_empty_folder("--report", report);
  std::optional<Mapping> mapping;
  if (!show_mapping(options, &mapping)) return options.write_rig ? kExitOk : kExitBadInput;
  ThreadPool pool(options.threads > 0 ? options.threads : hardware_threads());
  Inspection result = inspect(options, pool);
  if (!options.actors.empty() && result.problems.empty())
    result.objects = list_objects(result.recording, options.actors, pool);
  if (!masks.empty() && result.problems.empty())
    write_folder(masks, /*replace=*/false,
                 [&](const std::filesystem::path& made) { write_masks(made, pool, &result); });
  if (!report.empty() && result.problems.empty()) write_report(report, pool, &result);
  if (options.json) {
    nlohmann::ordered_json json = inspection_to_json(result);
    if (mapping) json["mapping"] = mapping_to_json(*mapping);
    print_json(json);
  } else {
    print_inspection(result);
  }
  if (!result.problems.empty()) return kExitBadInput;
  return !result.preflight || result.preflight->passes() ? kExitOk : kExitPreflightFailed;
}

}  // namespace

Action configure_inspect(CLI::App& command) {
  auto options = std::make_shared<InspectOptions>();
  command
      .add_option("RECORDING", options->recording,
                  "folder of the recording, or a scene bundle (.usdz)")
      ->required();
  add_frames_option(command, &options->frames);
  add_cameras_option(command, &options->cameras);
  add_outside_files_option(command, &options->outside_files);
  add_max_damaged_option(command, &options->max_damaged);
  add_json_option(command, &options->json);
  command.add_flag(
      "--write-rig", options->write_rig,
      "writes the proposed mapping of a ROS 2 bag's topics to sensors as rig.yaml into "
      "its folder, to be edited");
  command.add_flag("--actors{all},--objects{all}", options->actors,
                   "lists annotated objects, and ones that move by the LiDAR: type, moving or "
                   "parked, boxes, metres driven, least distance, images; --actors=3,17: these "
                   "alone");
  command.add_option(
      "--masks-out,--masks", options->masks,
      "new folder for masks of pixels that training ignores: CAM.png and, where the LiDAR finds "
      "moving objects that nobody annotated, moving.json, to be edited, and CAM_overlay.png, to "
      "inspect them");
  command.add_option(
      "--report", options->report,
      "new folder for a page (index.html) that checks calibration, poses and time offsets "
      "against the images");
  add_train_option(command, "threads", &options->threads);
  return [options] { return run_inspect(*options); };
}

}  // namespace redrive
