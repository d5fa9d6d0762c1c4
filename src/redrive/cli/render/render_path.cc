// SPDX-License-Identifier: Apache-2.0
// redrive render path: renders a camera path into a video or a folder of images.
#include <algorithm>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/base/files/output_folder.h"
#include "redrive/base/progress.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/help.h"
#include "redrive/cli/output_file.h"
#include "redrive/cli/render/render_options.h"
#include "redrive/cli/train/training.h"
#include "redrive/image/image_io.h"
#include "redrive/image/video.h"
#include "redrive/render/camera_path.h"
#include "redrive/render/renderer.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

struct RenderPathOptions : RenderOptions {
  std::string path, camera, exposure = "own";
  double fps = 0, seconds = 0;  ///< images a second and duration; 0: the path's own
};

std::string image_name(int index) {
  std::string digits = std::to_string(index);
  return digits.insert(0, 6 - std::min<std::size_t>(6, digits.size()), '0') + ".png";
}

bool is_video(const fs::path& out) { return has_extension(out, {".mp4"}); }

/// Checks --out before anything is rendered, and returns it without a slash at its end.
fs::path checked_output(const RenderPathOptions& options) {
  const fs::path out = fs::path(options.out).has_filename() ? fs::path(options.out)
                                                            : fs::path(options.out).parent_path();
  if (is_video(out)) {
    check_output_file("--out", out, options.force);
    if (const auto obstacle = video_obstacle())
      throw UsageError("--out", options.out,
                       "videos need FFmpeg's libraries with libx264, and " + *obstacle +
                           "; --out FOLDER writes PNGs");
    return out;
  }
  if (!out.extension().empty() && !fs::is_directory(out))
    throw UsageError("--out", options.out,
                     "must be a video that ends in .mp4, or a folder for PNGs");
  if (const fs::path parent = out.parent_path(); !parent.empty() && !fs::is_directory(parent))
    throw UsageError("--out", options.out, "its folder does not exist");
  check_output_folder("--out", out, options.force);
  return out;
}

/// Parses "drive" and "sideways:METRES"; nothing for a file.
std::optional<double> left_of_drive(const std::string& path) {
  if (path == "drive") return 0;
  const std::string_view prefix = "sideways:";
  if (!path.starts_with(prefix)) return std::nullopt;
  double left_m = 0;
  const char* const end = path.data() + path.size();
  const auto [at, error] = std::from_chars(path.data() + prefix.size(), end, left_m);
  if (error != std::errc{} || at != end || !(std::abs(left_m) <= kMaxShift_m))
    throw UsageError("PATH", path, "must be sideways:METRES to the left, at most 1e4");
  return left_m;
}

CameraPath make_path(const RenderPathOptions& options, const Run& run) {
  const RigCamera& camera =
      options.camera.empty() ? run.scene.rig.front() : find_camera(run.scene, options.camera);
  CameraPath path;
  if (const auto left_m = left_of_drive(options.path))
    path = drive_path(run.scene, camera, *left_m);
  else
    path = path_of_file(read_camera_path(options.path), run.scene);
  if (!options.camera.empty()) path.camera = options.camera;
  if (options.fps > 0) path.fps = options.fps;
  if (options.seconds > 0) path.seconds = options.seconds;
  return path;
}

int run_render_path(const RenderPathOptions& options) {
  const fs::path out = checked_output(options);
  left_of_drive(options.path);  // checks it before the run is opened
  const Run run = open_edited_run(options);
  const CameraPath path = make_path(options, run);
  const bool own_lens = path.camera.empty();
  const int camera = std::max(0, run.scene.camera_index(path.camera));
  const Exposure exposure =
      chosen_exposure(options.exposure, run.scene).value_or(path_exposure(path, run.scene, camera));
  Camera lens = own_lens ? *path.lens : run.scene.rig[camera].camera;

  const auto backend = make_backend(options.backend, run.options.method);
  std::printf("%s\n", kernels::describe(*backend).c_str());
  check_rendering_memory(run, &lens);
  const std::atomic<bool>& stop = stop_on_signal();
  const int images = path.images();
  Progress progress("rendering images", images);
  std::optional<RayTable> rays;
  RenderedImage rendered;
  double fov_deg = 0;
  const auto image_at = [&](int i) {
    if (stop) throw Interrupted();
    const PathKey key = path.at_image(i);
    if (own_lens) lens = with_fov(lens, key.fov_deg);
    if (!rays || (own_lens && key.fov_deg != fov_deg)) rays = make_ray_table(lens, backend->pool());
    fov_deg = key.fov_deg;
    const ShutterPoses pose = run.scene.with_actors(key.world_from_camera, run.scene.rig[camera],
                                                    drive_time_ns(key, run.scene));
    run.field()->render_to(*backend, *rays, pose, exposure, &rendered);
    const Image8 image = to_image8(rendered);
    progress.count();
    return image;
  };
  if (is_video(out)) {
    VideoWriter video(out, lens.width, lens.height, path.fps);
    for (int i = 0; i < images; ++i) video.add(image_at(i));
    video.finish();
  } else {
    write_output_folder("--out", out, options.force, [&](const fs::path& folder) {
      for (int i = 0; i < images; ++i) write_image(folder / image_name(i), image_at(i));
    });
  }
  std::printf("%s: %d images, %s, %g a second, %.2f s\n", out.c_str(), images,
              size_text(lens.width, lens.height).c_str(), path.fps, images / path.fps);
  return kExitOk;
}

}  // namespace

Action configure_render_path(CLI::App& command) {
  auto options = std::make_shared<RenderPathOptions>();
  add_run_option(command, &options->run);
  command
      .add_option("PATH", options->path,
                  "drive (the drive of --camera), sideways:N (N metres to its left), or a file in "
                  "nerfstudio's layout")
      ->required();
  command.add_option(
      "--camera", options->camera,
      "camera of the run whose lens and exposure the images have (default: that of the "
      "file's keyframes, else the file's lens; for a drive the run's first)");
  command
      .add_option("--fps", options->fps,
                  "images a second (default: the file's, or " + number_text(CameraPath().fps) + ")")
      ->check(within("--fps", kMinPathFps, kMaxPathFps));
  command.add_option("--seconds", options->seconds, "duration (default: the path's own)")
      ->check(within("--seconds", 0.001, kMaxPath_s));
  add_exposure_option(command, &options->exposure,
                      "those of the frame nearest to the path's middle, for all images");
  add_render_options(command, options.get(), "OUT", "video, .mp4, or a folder for PNGs");
  return [options] { return run_render_path(*options); };
}

}  // namespace redrive
