// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/mesh/field_mesh.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/base/progress.h"
#include "redrive/export/field_points.h"
#include "redrive/export/mesh/fill_ground.h"
#include "redrive/export/mesh/surface_mesh.h"
#include "redrive/scene/load_views.h"
#include "redrive/train/memory.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

constexpr std::size_t kMostViews = 200;
// Images are rendered smaller until they have at most this many pixels. At f = 300 pixels a pixel
// spans 0.1 m, a voxel, at a distance of 30 m.
constexpr double kMostPixels = 300'000;
constexpr double kRangeVoxels = 400;
// A piece of 1 m^2 has 200 triangles of half a voxel's face.
constexpr std::size_t kLeastTriangles = 200;

int factor_of(const Camera& camera) {
  const double pixels = static_cast<double>(camera.width) * camera.height;
  return std::max(1, static_cast<int>(std::ceil(std::sqrt(pixels / kMostPixels))));
}

/// Returns the pixels in use at the smaller size: a pixel whose recorded pixels are all in use.
std::vector<std::uint8_t> used_pixels(const Scene& scene, const View& view,
                                      const Exclusions& left_out, int factor) {
  const Camera& full = scene.rig[view.camera].camera;
  Mask mask = view_mask(scene, view, left_out.masks[view.camera], left_out.moving);
  if (!view.mask.path.empty()) {
    const Image8 image = load_view(scene, view);
    for (std::size_t i = 0; i < image.used.size(); ++i) mask.used[i] &= image.used[i] != 0;
  }
  const int width = full.width / factor, height = full.height / factor;
  std::vector<std::uint8_t> used(static_cast<std::size_t>(width) * height, 1);
  for (int y = 0; y < height * factor; ++y)
    for (int x = 0; x < width * factor; ++x)
      used[static_cast<std::size_t>(y / factor) * width + x / factor] &=
          mask.used[static_cast<std::size_t>(y) * full.width + x];
  return used;
}

double median_depth(const std::vector<DepthImage>& images) {
  std::vector<float> all;
  for (const DepthImage& image : images)
    for (std::size_t i = 0; i < image.depth_m.size(); i += 16)
      if (image.depth_m[i] > 0) all.push_back(image.depth_m[i]);
  if (all.empty()) return 1;
  const auto middle = all.begin() + static_cast<std::ptrdiff_t>(all.size() / 2);
  std::ranges::nth_element(all, middle);
  return static_cast<double>(*middle);
}

/// Throws UsageError where the images take more than is allowed.
std::uint64_t bytes_of(const std::vector<DepthImage>& images, const Run& run,
                       std::uint64_t most_bytes) {
  std::uint64_t bytes = 0;
  for (const DepthImage& image : images) bytes += image.bytes();
  if (bytes > most_bytes)
    throw UsageError("--memory", run.options.memory,
                     "of the run: " + memory_text(bytes, most_bytes) +
                         " for images of depth; train with a larger --memory");
  return bytes;
}

std::vector<DepthImage> render_depth_images(const Run& run, kernels::Backend& backend,
                                            const MeshOptions& options, ThreadPool& pool) {
  const Scene& scene = run.scene;
  const Exclusions left_out = read_exclusions(run);
  const std::vector<const View*> views = training_views(scene, kMostViews);
  std::vector<DepthImage> images;
  RayTable table;
  std::shared_ptr<const PixelDirections> directions;
  int table_camera = -1, factor = 1;
  Progress progress("rendering depth", static_cast<std::int64_t>(views.size()));
  // Views of a camera in groups: their normals take a thread each.
  for (std::size_t first = 0; first < views.size();) {
    const int camera = views[first]->camera;
    if (table_camera != camera) {
      factor = factor_of(scene.rig[camera].camera);
      table = make_ray_table(scene.rig[camera].camera.downscaled(factor), backend.pool());
      directions = pixel_directions(table);
      table_camera = camera;
    }
    std::vector<RenderedImage> rendered;
    while (first + rendered.size() < views.size() &&
           views[first + rendered.size()]->camera == camera &&
           rendered.size() < static_cast<std::size_t>(pool.threads())) {
      const View& view = *views[first + rendered.size()];
      ShutterPoses poses = scene.shutter_poses(view);
      poses.set_actors({});  // objects are at other places in other images
      rendered.push_back(render_image(backend, *run.field(), table, poses, scene.exposure(view)));
    }
    std::vector<std::optional<DepthImage>> made(rendered.size());
    pool.run(static_cast<int>(rendered.size()), [&](int i) {
      const View& view = *views[first + i];
      made[i] = make_depth_image(rendered[i], table, directions, scene.shutter_poses(view),
                                 used_pixels(scene, view, left_out, factor));
    });
    for (auto& image : made) images.push_back(std::move(*image));
    first += made.size();
    bytes_of(images, run, options.most_bytes);
    progress.count(static_cast<std::int64_t>(made.size()));
  }
  return images;
}

}  // namespace

FieldMesh field_mesh(const Run& run, kernels::Backend& backend, const MeshOptions& options) {
  ThreadPool& pool = backend.pool();
  FieldMesh out;
  std::vector<DepthImage> images = render_depth_images(run, backend, options, pool);
  out.images = static_cast<int>(images.size());
  out.voxel_m = options.voxel_m > 0 ? options.voxel_m
                : run.scene.metric  ? kMeshVoxel_m
                                    : median_depth(images) / kVoxelsPerMedianDepth;
  out.range_m = kRangeVoxels * out.voxel_m;
  const Progress progress("making a surface of the depth");
  TsdfVolume volume(out.voxel_m, options.most_bytes - bytes_of(images, run, options.most_bytes));
  volume.fuse(images, out.range_m, pool);
  images.clear();
  if (run.scene.metric) {
    std::vector<Eigen::Vector3d> driven;
    for (const PosedFrame& frame : run.scene.posed_frames())
      driven.emplace_back(frame.world_from_body.translation());
    out.filled_m2 = static_cast<double>(fill_ground(driven, &volume)) * out.voxel_m * out.voxel_m;
  }
  out.mesh = surface_mesh(volume, kLeastTriangles, pool);
  return out;
}

}  // namespace redrive
