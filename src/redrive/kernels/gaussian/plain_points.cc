// SPDX-License-Identifier: Apache-2.0
#include "redrive/kernels/gaussian/plain_points.h"

#include <limits>

#include "redrive/base/error.h"
#include "redrive/kernels/gaussian/line_pose.h"

namespace redrive::kernels {

void project_plain_points(const GaussianCamera& camera, std::span<const float> points,
                          ThreadPool* pool, std::span<float> pixels) {
  using Math = NumberMath<double>;
  const std::size_t n = points.size() / 3;
  REDRIVE_CHECK_OP(pixels.size(), ==, 2 * n);
  const std::span<const PlainPose> poses = camera.world_from_camera;
  const auto project = [&](std::size_t begin, std::size_t end) {
    with_camera(camera.camera, [&](const auto& lens) {
      for (std::size_t i = begin; i < end; ++i) {
        const double point[] = {points[i], points[n + i], points[2 * n + i]};
        ProjectedGaussian<Math> at;
        at.mean[camera.by_column ? 0 : 1] = static_cast<double>(first_line(camera));
        for (int k = 0; k < point_iterations(poses); ++k)
          project_mean<Math>(lens, line_pose(camera, poses, at.mean), point, &at);
        for (int k = 0; k < 2; ++k)
          pixels[k * n + i] =
              at.visible ? static_cast<float>(at.mean[k]) : std::numeric_limits<float>::quiet_NaN();
      }
    });
  };
  constexpr std::size_t kPointsPerRange = 2048;
  if (pool)
    pool->run_ranges(n, kPointsPerRange, project);
  else
    project(0, n);
}

}  // namespace redrive::kernels
