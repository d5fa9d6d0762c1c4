// SPDX-License-Identifier: Apache-2.0
// redrive render: renders one image of a frame's camera, shifted; all images of a POSES.json; a
// camera path (render_path.cc); or LiDAR scans (render_lidar.cc).
#include <charconv>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include "redrive/base/error.h"
#include "redrive/base/files.h"
#include "redrive/cli/actor_options.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/output_file.h"
#include "redrive/cli/render/render_options.h"
#include "redrive/edit/camera_path_file.h"
#include "redrive/edit/edit_actors.h"
#include "redrive/image/exr.h"
#include "redrive/image/image_io.h"
#include "redrive/math/angles.h"
#include "redrive/render/normals.h"
#include "redrive/render/open_to_render.h"
#include "redrive/render/renderer.h"
#include "redrive/render/view_pose.h"
#include "redrive/train/memory.h"
#include "redrive/train/run.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

}  // namespace

std::int64_t parse_frame(const char* option, const std::string& text) {
  std::int64_t id = -1;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), id);
  if (error != std::errc{} || end != text.data() + text.size() || id < 0)
    throw UsageError(option, text, "must be a frame id, a whole number from 0");
  return id;
}

Eigen::Vector3d parse_translation(const std::string& text) {
  const char* rule = "must be three numbers X,Y,Z in metres, at most 1e4 each, e.g. 0.5,0,0";
  Eigen::Vector3d shift_m;
  const char *at = text.data(), *end = text.data() + text.size();
  for (int i = 0; i < 3; ++i) {
    const auto [next, error] = std::from_chars(at, end, shift_m[i]);
    const bool comma = next != end && *next == ',';
    if (error != std::errc{} || !(std::abs(shift_m[i]) <= kMaxShift_m) ||
        (i < 2 ? !comma : next != end))
      throw UsageError("--translate", text, rule);
    at = next + (i < 2);
  }
  return shift_m;
}

ShiftAxes shift_axes(const RenderOptions& options, const Run& run) {
  const ShiftAxes axes = *shift_axes_from_name(options.axes);
  if (axes == ShiftAxes::kLocal && run.recording.global_frame != GlobalFrame::kEcef)
    throw UsageError("--axes", options.axes,
                     "needs a recording whose poses are in ECEF; use body or camera");
  return axes;
}

void no_such_frame(const std::string& frame, const Run& run) {
  throw UsageError("--frame", frame, unknown_frame(parse_frame("--frame", frame), run.scene));
}

namespace {

/// Checks, before anything is rendered, that the extension is one of `extensions` and that the file
/// can be written.
void check_image_output(const char* option, const fs::path& file, bool force,
                        std::initializer_list<std::string_view> extensions) {
  if (!has_extension(file, extensions)) {
    std::string rule = "must end in ";
    for (const std::string_view extension : extensions)
      rule += (extension == *extensions.begin() ? "" : " or ") + std::string(extension);
    throw UsageError(option, file.string(), rule);
  }
  if (const auto obstacle = exr_obstacle(); obstacle && has_extension(file, {".exr"}))
    throw UsageError(option, file.string(), *obstacle);
  check_output_file(option, file, force);
}

}  // namespace

const RigCamera& find_camera(const Scene& scene, const std::string& name) {
  const int index = scene.camera_index(name);
  if (index >= 0) return scene.rig[index];
  throw UsageError("--camera", name, unknown_camera(name, scene.rig));
}

namespace {

/// Returns the camera of --camera, or the one that --mount and --lens describe.
RigCamera chosen_camera(const RenderOptions& options, const Scene& scene) {
  if (options.mount.empty()) return find_camera(scene, options.camera);
  const std::optional<Mount> mount = parse_mount(options.mount);
  if (!mount) throw UsageError("--mount", options.mount, kMountRule);
  const std::optional<Lens> lens = parse_lens(options.lens);
  const auto camera = lens ? mounted_camera(*mount, *lens, scene) : std::nullopt;
  if (!camera) throw UsageError("--lens", options.lens, kLensRule);
  return *camera;
}

}  // namespace

Run open_edited_run(const RenderOptions& options) {
  std::optional<TrafficEdit> edit;
  if (!options.edit.empty()) edit = read_traffic_edit(options.edit);
  Run run = open_to_render(options.run, options.max_damaged);
  if (edit) check_added(*edit, run.field()->draws_actors());
  if (edit)
    for (const std::string& remark : edit_actors(*edit, &run.scene))
      std::printf("%s: %s\n", options.edit.c_str(), remark.c_str());
  select_actors(options.actors, &run.scene);
  return run;
}

std::optional<Exposure> chosen_exposure(const RenderOptions& options, const Run& run) {
  if (options.exposure == "own") return std::nullopt;
  if (options.exposure == "none") return Exposure{};
  const std::size_t colon = options.exposure.find(':');
  const auto fail = [&](const std::string& rule) -> void {
    throw UsageError("--exposure", options.exposure, rule);
  };
  if (colon == std::string::npos) fail("must be own, none or CAMERA:FRAME");
  const std::string of = options.exposure.substr(0, colon);
  const Exposure exposure =
      exposure_at(run.scene, of, parse_frame("--exposure", options.exposure.substr(colon + 1)));
  if (exposure.camera < 0) fail("the run has no such camera or the recording no such frame");
  return exposure;
}

namespace {

/// Resolves --exposure for a view of `camera` at `frame`.
Exposure exposure_of(const RenderOptions& options, const Run& run, const std::string& camera,
                     std::int64_t frame) {
  const std::optional<Exposure> chosen = chosen_exposure(options, run);
  return chosen ? *chosen : exposure_at(run.scene, camera, frame);
}

int render_one(const RenderOptions& options) {
  const std::int64_t frame = parse_frame("--frame", options.frame);
  const Eigen::Vector3d shift_m = parse_translation(options.translate);
  check_image_output("--out", options.out, options.force, {".png", ".jpg", ".jpeg"});
  std::vector<fs::path> outputs{fs::weakly_canonical(fs::absolute(options.out))};
  if (!options.depth.empty())
    check_image_output("--depth", options.depth, options.force, {".png", ".exr"});
  for (const auto& [option, file] :
       {std::pair("--depth", options.depth), std::pair("--opacity", options.opacity),
        std::pair("--normals", options.normals)}) {
    if (file.empty()) continue;
    if (file != options.depth) check_image_output(option, file, options.force, {".png"});
    const fs::path path = fs::weakly_canonical(fs::absolute(file));
    if (std::ranges::find(outputs, path) != outputs.end())
      throw UsageError(option, file, "must differ from the other images");
    outputs.push_back(path);
  }

  const Run run = open_edited_run(options);
  const RigCamera camera = chosen_camera(options, run.scene);
  const auto pose = world_from_body(run.scene, frame, camera);
  if (!pose) no_such_frame(options.frame, run);
  const ShiftAxes axes = shift_axes(options, run);
  const Rigid3d world_from_camera =
      shifted_camera(run.scene.global_from_world, *pose,
                     turned_sensor(camera.body_from_sensor, kRadiansPerDegree * options.yaw_deg,
                                   kRadiansPerDegree * options.pitch_deg),
                     axes, shift_m);
  const auto backend = make_checked_backend(options.backend);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  check_rendering_memory(run, &camera.camera);
  const RayTable rays = make_ray_table(camera.camera, backend->pool());
  const RenderedImage image = render_image(
      *backend, *run.field(), rays, posed_at_frame(run.scene, camera, world_from_camera, frame),
      exposure_of(options, run, camera.name, frame));
  write_image(options.out, to_image8(image));
  std::printf("%s: %d x %d\n", options.out.c_str(), image.width, image.height);
  if (has_extension(options.depth, {".exr"})) {
    write_exr(options.depth, image.width, image.height, image.depth);
    std::printf("%s: depth along the ray in m, channel Z\n", options.depth.c_str());
  } else if (!options.depth.empty()) {
    write_png16(options.depth, {image.width, image.height, depth_mm(image)});
    std::printf("%s: depth along the ray in mm, 16 bit, 65535: 65.535 m and more\n",
                options.depth.c_str());
  }
  if (!options.opacity.empty()) {
    write_image(options.opacity, opacity_image(image));
    std::printf("%s: opacity, 255: opaque\n", options.opacity.c_str());
  }
  if (!options.normals.empty()) {
    write_image(options.normals, normals_image(image, rays));
    std::printf("%s: normals, (1 + n) / 2: x right, y up, z to the camera\n",
                options.normals.c_str());
  }
  return kExitOk;
}

int render_poses(const RenderOptions& options) {
  const ViewRequests poses = read_view_requests(options.poses);
  const fs::path out = options.out;
  if (fs::exists(out) && !fs::is_directory(out))
    throw UsageError("--out", options.out, "is a file; --poses writes into a folder");
  for (const RequestedView& view : poses.views)
    if (fs::exists(out / view.file) && !options.force)
      throw UsageError("--out", (out / view.file).string(), "exists; --force overwrites it");

  const Run run = open_edited_run(options);
  // Cameras that the file defines are rendered at full size, the run's at the size of training.
  const std::vector<RigCamera> rig = poses_rig(poses, run.scene, /*like_run=*/false);
  std::vector<ShutterPoses> poses_of;
  std::vector<const RigCamera*> cameras;
  std::vector<Exposure> exposures;
  for (std::size_t i = 0; i < poses.views.size(); ++i) {  // check all before the first is rendered
    const RigCamera& camera = requested_camera(poses, i, rig);
    cameras.push_back(&camera);
    poses_of.push_back(
        posed_at_frame(run.scene, camera,
                       requested_world_from_body(poses, i, camera, run.scene, options.relative) *
                           camera.body_from_sensor,
                       poses.views[i].frame_id));
    exposures.push_back(exposure_of(options, run, camera.name, poses.views[i].frame_id));
  }

  const auto backend = make_checked_backend(options.backend);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  for (const RigCamera* camera : cameras) check_rendering_memory(run, &camera->camera);
  std::error_code error;
  fs::create_directories(out, error);
  if (error) throw IoError(out, error.message());
  for (std::size_t i = 0; i < poses.views.size(); ++i) {
    const fs::path file = out / poses.views[i].file;
    const RenderedImage image =
        render_image(*backend, *run.field(), cameras[i]->camera, poses_of[i], exposures[i]);
    make_folders_within(out, fs::path(poses.views[i].file).parent_path());
    write_image(file, to_image8(image));
    std::printf("%zu/%zu %s: %d x %d\n", i + 1, poses.views.size(), file.c_str(), image.width,
                image.height);
    std::fflush(stdout);
  }
  return kExitOk;
}

int render(const RenderOptions& options) {
  if (!options.poses.empty()) return render_poses(options);
  if (!options.path.empty()) return render_path(options);
  if (!options.lidar.empty()) return render_lidar(options);
  const bool has_camera = !options.camera.empty() || !options.mount.empty();
  if (!has_camera || options.frame.empty())
    throw UsageError("render", "",
                     "needs --camera or --mount, and --frame; or --poses; or --path; or --lidar");
  if (options.lens.empty() && !options.mount.empty())
    throw UsageError("--mount", options.mount, "needs --lens, or --lidar");
  return render_one(options);
}

}  // namespace

Action configure_render(CLI::App& command) {
  auto options = std::make_shared<RenderOptions>();
  command.add_option("RUN", options->run, "run folder, as train makes it")->required();
  CLI::Option* poses = command.add_option(
      "--poses", options->poses,
      "renders each view of the file under its own name into the folder --out. "
      "RT_ECEF_body is an absolute pose of the body, shift_body_m a translation of the recording's "
      "pose of frame_id in body axes");
  poses->type_name("POSES.json")->group("Many images");
  command
      .add_flag("--relative", options->relative,
                "with --poses: uses shift_body_m where a view has both")
      ->needs(poses);
  CLI::Option* path =
      command
          .add_option("--path", options->path,
                      "camera path to render into the video --out FILE.mp4 or, as PNGs, into the "
                      "folder --out: a file in nerfstudio's layout, drive (the drive of --camera), "
                      "or sideways:N (N metres to its left)")
          ->excludes(poses);
  command
      .add_option("--fps", options->fps, "images a second of --path (default: the file's, or 24)")
      ->check(within("--fps", kMinPathFps, kMaxPathFps))
      ->needs(path);
  command.add_option("--seconds", options->seconds, "duration of --path (default: the path's own)")
      ->check(within("--seconds", 0.001, kMaxPath_s))
      ->needs(path);
  add_actor_options(command, &options->actors, &options->edit);
  CLI::Option* camera =
      command
          .add_option("--camera", options->camera,
                      "camera of the run; with --path whose lens and exposure the images have "
                      "(default: that of the file's keyframes, else the file's lens; for a drive "
                      "the run's first)")
          ->excludes(poses);
  CLI::Option* mount =
      command.add_option("--mount", options->mount,
                         "a camera of your own instead of --camera: metres along the body's axes "
                         "(x forward, y left, z up) and degrees (to the left, "
                         "upwards, clockwise); zeros look forward");
  CLI::Option* lens = command.add_option("--lens", options->lens,
                                         "lens of --mount: pinhole:FOV:WIDTHxHEIGHT with the "
                                         "horizontal field of view in degrees, or a "
                                         "camera of the run");
  mount->excludes(camera);
  lens->needs(mount);
  CLI::Option* lidar =
      command
          .add_option(
              "--lidar", options->lidar,
              "renders a LiDAR's revolution instead of an image: N beams as usual sensors have "
              "them, N:MIN:MAX (from MIN to MAX degrees of elevation), elevations E1,E2,.., or "
              "recorded (the rays of "
              "the recording's own revolution). --mount places it elsewhere than the "
              "recording's, with axes x forward, y left, z up")
          ->excludes(poses)
          ->excludes(path)
          ->excludes(camera)
          ->excludes(lens);
  command.add_option("--azimuth-steps", options->azimuth_steps, "of a revolution of --lidar")
      ->check(within("--azimuth-steps", 1, 36000))
      ->needs(lidar)
      ->default_str("1800");
  command.add_option("--rate", options->rate_hz, "revolutions a second of --lidar")
      ->check(within("--rate", 0.1, 1000.0))
      ->needs(lidar)
      ->default_str("10");
  command.add_option("--range", options->range, "metres: returns of --lidar outside are dropped")
      ->needs(lidar)
      ->capture_default_str();
  command
      .add_option(
          "--points-in", options->points_in,
          "axes of the points of --lidar: sensor or body (those at the time of each point), "
          "or world (of the scene, motion compensated)")
      ->check(one_of("--points-in", {"sensor", "body", "world"}))
      ->needs(lidar)
      ->capture_default_str();
  for (CLI::Option* option :
       {mount,
        command.add_option("--frame", options->frame,
                           "frame id of the recording, whose pose the body has"),
        command
            .add_option("--translate", options->translate,
                        "translation of the camera by X,Y,Z metres along --axes")
            ->capture_default_str(),
        command
            .add_option("--axes", options->axes,
                        "axes of --translate: body (x forward, y left, z up), camera (x right, y "
                        "down, z forward) or local (level: z up, x along the horizontal heading, y "
                        "left)")
            ->check(one_of("--axes", {"body", "camera", "local"}))
            ->capture_default_str(),
        command
            .add_option("--yaw", options->yaw_deg,
                        "turns the camera about z of the body, degrees, to the left")
            ->check(within("--yaw", -360.0, 360.0)),
        command
            .add_option("--pitch", options->pitch_deg,
                        "then turns it about x of the camera, degrees, upwards")
            ->check(within("--pitch", -360.0, 360.0)),
        command
            .add_option("--depth", options->depth,
                        "EXR to write depth along the ray to, in metres, or 16-bit PNG, in mm; "
                        "65535: 65.535 m and more")
            ->excludes(lidar),
        command
            .add_option("--opacity", options->opacity,
                        "PNG to write opacity to, as grey; white: opaque")
            ->excludes(lidar),
        command
            .add_option("--normals", options->normals,
                        "PNG to write surface normals to, from depth, as (1 + n) / 2: x right, y "
                        "up, z to the camera; black where nothing is seen")
            ->excludes(lidar)})
    option->excludes(poses)->excludes(path);
  command
      .add_option(
          "--exposure", options->exposure,
          "exposure, white balance and shading of the image: own (those of the view's "
          "camera at its frame; of a path those of the frame nearest to its middle, for all "
          "images), none (the field's colours unchanged) or those of CAMERA:FRAME")
      ->excludes(lidar)
      ->capture_default_str();
  command
      .add_option("--out", options->out,
                  "image to write, .png or .jpg; with --poses a folder; with --path a video, .mp4, "
                  "or a folder; with --lidar points, .las, .pcd or .bin (KITTI), or a folder as "
                  "KITTI's velodyne_points for all frames")
      ->required();
  command.add_flag("--force", options->force, "overwrites existing images or an existing video");
  add_max_damaged_option(command, &options->max_damaged);
  add_backend_options(command, &options->backend);
  return [options] { return render(*options); };
}

}  // namespace redrive
