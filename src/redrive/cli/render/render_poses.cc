// SPDX-License-Identifier: Apache-2.0
// redrive render poses: renders the images of a POSES.json into a folder.
#include <cstdio>
#include <filesystem>
#include <memory>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/render/render_options.h"
#include "redrive/image/image_io.h"
#include "redrive/render/renderer.h"
#include "redrive/train/memory.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

struct RenderPosesOptions : RenderOptions {
  std::string poses, exposure = "own";
  bool relative = false;
};

int run_render_poses(const RenderPosesOptions& options) {
  const ViewRequests poses = read_view_requests(options.poses);
  const fs::path out = options.out;
  if (fs::exists(out) && !fs::is_directory(out))
    throw UsageError("--out", options.out, "is a file; the images go into a folder");
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
    exposures.push_back(
        exposure_of(options.exposure, run.scene, camera.name, poses.views[i].frame_id));
  }

  const auto backend = make_backend(options.backend, run.options.method);
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

}  // namespace

Action configure_render_poses(CLI::App& command) {
  auto options = std::make_shared<RenderPosesOptions>();
  add_run_option(command, &options->run);
  command
      .add_option("POSES.json", options->poses,
                  "file of views, each with a name, a camera and a frame_id. RT_ECEF_body is an "
                  "absolute pose of the body, shift_body_m a translation of the recording's pose "
                  "of frame_id in body axes")
      ->required();
  command.add_flag("--relative", options->relative, "uses shift_body_m where a view has both");
  add_exposure_option(command, &options->exposure, "those of the view's camera at its frame");
  add_render_options(command, options.get(), "DIR",
                     "folder for the images, each under its own name");
  return [options] { return run_render_poses(*options); };
}

}  // namespace redrive
