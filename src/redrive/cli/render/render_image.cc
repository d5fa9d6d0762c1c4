// SPDX-License-Identifier: Apache-2.0
// redrive render image and redrive render mount: renders one image of a camera of the run, or of a
// camera of one's own on the car.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include "redrive/base/error.h"
#include "redrive/base/files/files.h"
#include "redrive/cli/backend_options.h"
#include "redrive/cli/command.h"
#include "redrive/cli/frames_option.h"
#include "redrive/cli/output_file.h"
#include "redrive/cli/render/render_options.h"
#include "redrive/image/exr.h"
#include "redrive/image/image_io.h"
#include "redrive/render/normals.h"
#include "redrive/render/run_renderer.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;

struct RenderImageOptions : MovedSensorOptions {
  std::string camera;       ///< camera of the run; empty: a mount
  std::string mount, lens;  ///< camera of one's own
  std::string exposure = "own", depth, opacity, normals, ids;
};

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

RigCamera chosen_camera(const RenderImageOptions& options, const Scene& scene) {
  if (!options.camera.empty()) return find_camera(scene, options.camera);
  const std::optional<Lens> lens = parse_lens(options.lens);
  const auto camera =
      lens ? mounted_camera(parsed_mount(options.mount), *lens, scene) : std::nullopt;
  if (!camera) throw UsageError("--lens", options.lens, kLensRule);
  return *camera;
}

/// Checks --out, --depth, --opacity, --normals and --ids.
void check_image_outputs(const RenderImageOptions& options) {
  check_image_output("--out", options.out, options.force, {".png", ".jpg", ".jpeg"});
  std::vector<fs::path> outputs{fs::weakly_canonical(fs::absolute(options.out))};
  if (!options.depth.empty())
    check_image_output("--depth", options.depth, options.force, {".png", ".exr"});
  for (const auto& [option, file] :
       {std::pair("--depth", options.depth), std::pair("--opacity", options.opacity),
        std::pair("--normals", options.normals), std::pair("--ids", options.ids)}) {
    if (file.empty()) continue;
    if (file != options.depth) check_image_output(option, file, options.force, {".png"});
    const fs::path path = fs::weakly_canonical(fs::absolute(file));
    if (std::ranges::find(outputs, path) != outputs.end())
      throw UsageError(option, file, "must differ from the other images");
    outputs.push_back(path);
  }
}

/// Writes the images that the options name.
void write_images(const RenderImageOptions& options, const RenderedImage& image,
                  const RayTable& rays) {
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
}

/// Writes --ids, and prints which objects its values are.
void write_ids(const fs::path& file, const RenderedImage& image, const Scene& scene) {
  write_png16(file, {image.width, image.height, image.ids});
  std::printf("%s: ids, 16 bit, 0: the static world\n", file.c_str());
  for (const SeenActor& seen : image.seen) {
    const MovingObject& object = scene.actors[seen.number - 1];
    std::printf("  %d: object %lld, %s, %u of %u pixels visible\n", seen.number,
                static_cast<long long>(object.id), object.type.c_str(), seen.visible, seen.whole);
  }
}

int run_render_image(const RenderImageOptions& options) {
  const std::int64_t frame = parse_frame("--frame", options.frame);
  parse_translation(options.translate);  // checks it before the run is opened
  check_image_outputs(options);
  RunRenderer renderer(std::make_shared<const Run>(open_edited_run(options)), options.backend);
  const Run& run = renderer.run();
  ImageRequest request{chosen_camera(options, run.scene)};
  const auto frame_ns = time_of_frame(run.scene, frame);
  if (!frame_ns) no_such_frame(options.frame, run);
  request.exposed_ns = *frame_ns + request.camera.time_offset_ns;
  request.world_from_camera = {moved_camera(run.scene, request.camera.body_from_sensor,
                                            request.exposed_ns, sensor_shift(options, run))};
  request.exposure = exposure_of(options.exposure, run.scene, request.camera.name, frame);
  request.labelled = !options.ids.empty();
  std::printf("%s\n", kernels::describe(renderer.backend()).c_str());
  const RenderedImage image = renderer.image(request);
  write_images(options, image, *renderer.rays(request.camera.camera));
  if (request.labelled) write_ids(options.ids, image, run.scene);
  return kExitOk;
}

/// Adds the options after the choice of a camera.
Action add_image_options(CLI::App& command, const std::shared_ptr<RenderImageOptions>& options) {
  add_motion_options(command, options.get())->required();
  add_exposure_option(command, &options->exposure, "those of the camera at the frame");
  add_render_options(command, options.get(), "FILE", "image to write, .png or .jpg");
  command.add_option("--depth", options->depth,
                     "EXR to write depth along the ray to, in metres, or 16-bit PNG, in mm; "
                     "65535: 65.535 m and more");
  command.add_option("--opacity", options->opacity,
                     "PNG to write opacity to, as grey; white: opaque");
  command.add_option("--normals", options->normals,
                     "PNG to write surface normals to, from depth, as (1 + n) / 2: x right, y up, "
                     "z to the camera; black where nothing is seen");
  command.add_option("--ids", options->ids,
                     "16-bit PNG to write the moving object that each pixel shows to; 0: none");
  return [options] { return run_render_image(*options); };
}

}  // namespace

Action configure_render_image(CLI::App& command) {
  auto options = std::make_shared<RenderImageOptions>();
  add_run_option(command, &options->run);
  command.add_option("--camera", options->camera, "camera of the run")->required();
  return add_image_options(command, options);
}

Action configure_render_mount(CLI::App& command) {
  auto options = std::make_shared<RenderImageOptions>();
  add_run_option(command, &options->run);
  add_mount_option(command, &options->mount, "the camera")->required();
  command
      .add_option("--lens", options->lens,
                  "pinhole:FOV:WIDTHxHEIGHT with the horizontal field of view in degrees, or the "
                  "lens of a camera of the run")
      ->required();
  return add_image_options(command, options);
}

}  // namespace redrive
