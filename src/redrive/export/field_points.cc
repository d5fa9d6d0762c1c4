// SPDX-License-Identifier: Apache-2.0
#include "redrive/export/field_points.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/evenly_spaced.h"
#include "redrive/base/progress.h"
#include "redrive/render/normals.h"
#include "redrive/render/renderer.h"

namespace redrive {

std::vector<const View*> training_views(const Scene& scene, std::size_t most) {
  std::vector<const View*> views;
  for (const View& view : scene.views)
    if (!view.held_out) views.push_back(&view);
  std::vector<const View*> chosen;
  for (const std::size_t i : evenly_spaced(views.size(), most)) chosen.push_back(views[i]);
  return chosen;
}

std::vector<PlyPoint> field_points(const Run& run, kernels::Backend& backend, std::size_t most,
                                   std::size_t max_views, float least_opacity) {
  const Scene& scene = run.scene;
  const std::vector<const View*> views = training_views(scene, max_views);
  std::size_t pixels = 0;
  for (const View* view : views) {
    const Camera& camera = scene.rig[view->camera].camera;
    pixels += static_cast<std::size_t>(camera.width) * camera.height;
  }
  const std::size_t every = std::max<std::size_t>(1, (pixels + most - 1) / most);

  std::vector<PlyPoint> points;
  RayTable table;
  int table_camera = -1;
  std::size_t taken = 0;
  Progress progress("rendering depth", std::ssize(views));
  for (const View* view : views) {
    if (table_camera != view->camera) {
      table = make_ray_table(scene.rig[view->camera].camera, backend.pool());
      table_camera = view->camera;
    }
    ShutterPoses poses = scene.shutter_poses(*view);
    poses.set_actors({});  // objects are at other places in other images
    const RenderedImage image =
        render_image(backend, *run.field(), table, poses, scene.exposure(*view));
    const SurfaceNormals normals(image, table);
    for (std::size_t entry = 0; entry < table.pixel.size(); ++entry) {
      if (taken++ % every != 0) continue;
      const std::uint32_t pixel = table.pixel[entry];
      const double depth = static_cast<double>(image.depth[pixel]);
      if (!(image.opacity[pixel] >= least_opacity && depth > 0 && depth < scene.far_m)) continue;
      const Eigen::Vector3d normal = normals.at(pixel);
      if (normal.isZero()) continue;
      const Rigid3d pose =
          poses.at_pixel(static_cast<int>(pixel) % table.width,
                         static_cast<int>(pixel) / table.width, table.width, table.height);
      const Eigen::Vector3d direction(table.direction[3 * entry], table.direction[3 * entry + 1],
                                      table.direction[3 * entry + 2]);
      PlyPoint point{(pose * Eigen::Vector3d(depth * direction)).cast<float>(),
                     (pose.linear() * normal).cast<float>(),
                     {}};
      for (std::size_t k = 0; k < 3; ++k)
        point.rgb[k] = static_cast<std::uint8_t>(
            std::lround(255 * std::clamp(image.rgb[3 * pixel + k], 0.0f, 1.0f)));
      points.push_back(point);
    }
    progress.count();
  }
  return points;
}

}  // namespace redrive
