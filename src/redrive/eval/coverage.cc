// SPDX-License-Identifier: Apache-2.0
#include "redrive/eval/coverage.h"

#include <algorithm>
#include <cmath>

#include "redrive/base/error.h"
#include "redrive/eval/evaluate.h"
#include "redrive/train/training_data.h"

namespace redrive {
namespace {

constexpr int kSmallWidth =
    80;  // of the training views' depth: still resolves a surface a few pixels wide
constexpr double kRangeTolerance =
    0.1;  // a field's depth is not exact, and a small pixel holds several depths

double range_of(const RenderedImage& image, std::size_t pixel, double far_m) {
  return image.opacity[pixel] < 0.5f ? far_m : image.depth[pixel];
}

/// Returns the coordinate in the full image of the centre of a pixel of the small one.
std::size_t centre(int small, int factor) {
  return static_cast<std::size_t>(small) * factor + factor / 2;
}

}  // namespace

Coverage::Coverage(const Run& run, kernels::Backend& backend) : far_m_(run.scene.far_m) {
  const Scene& scene = run.scene;
  const Exclusions left_out = read_exclusions(run);
  for (int c = 0; c < static_cast<int>(scene.rig.size()); ++c) {
    std::vector<const View*> training;
    for (const View& view : scene.views)
      if (view.camera == c && !view.held_out) training.push_back(&view);
    const Camera& full = scene.rig[c].camera;
    const int factor = std::clamp(full.width / kSmallWidth, 1, full.height);
    const Camera small = full.downscaled(factor);
    const RayTable table = make_ray_table(small);
    for (const std::size_t i :
         evenly_spaced(training.size(), std::max<std::size_t>(1, kMaxViews / scene.rig.size()))) {
      const Rigid3d world_from_camera = scene.world_from_camera(*training[i]);
      const RenderedImage image = render_image(backend, *run.state.model, table, world_from_camera);
      const Mask mask = view_mask(scene, *training[i], left_out.masks[c], left_out.moving);
      TrainingView view{small, world_from_camera.inverse(Eigen::Isometry),
                        std::vector<float>(image.depth.size())};
      for (int y = 0; y < small.height; ++y)
        for (int x = 0; x < small.width; ++x) {
          const std::size_t k = static_cast<std::size_t>(y) * small.width + x;
          if (image.valid[k] && mask.used[centre(y, factor) * full.width + centre(x, factor)])
            view.range_m[k] = static_cast<float>(range_of(image, k, far_m_));
        }
      views_.push_back(std::move(view));
    }
  }
}

std::vector<std::uint8_t> Coverage::seen(const Camera& camera, const Rigid3d& world_from_camera,
                                         const RenderedImage& rendered) const {
  REDRIVE_CHECK_OP(rendered.width, ==, camera.width);
  REDRIVE_CHECK_OP(rendered.height, ==, camera.height);
  std::vector<std::uint8_t> seen(rendered.depth.size(), 0);
  for (std::size_t i = 0; i < seen.size(); ++i) {
    if (!rendered.valid[i]) continue;
    const Eigen::Vector2d pixel(static_cast<double>(i % rendered.width),
                                static_cast<double>(i / rendered.width));
    const auto direction = camera.unproject(pixel);
    if (!direction) continue;
    const Eigen::Vector3d point =
        world_from_camera * Eigen::Vector3d(range_of(rendered, i, far_m_) * *direction);
    seen[i] = std::any_of(views_.begin(), views_.end(), [&](const TrainingView& view) {
      const Eigen::Vector3d in_camera = view.camera_from_world * point;
      const auto at = view.camera.project(in_camera);
      if (!at) return false;
      const long x = std::lround(at->x()), y = std::lround(at->y());
      if (x < 0 || y < 0 || x >= view.camera.width || y >= view.camera.height) return false;
      const double range_m = view.range_m[static_cast<std::size_t>(y) * view.camera.width + x];
      return range_m > 0 && in_camera.norm() <= (1 + kRangeTolerance) * range_m;
    });
  }
  return seen;
}

}  // namespace redrive
