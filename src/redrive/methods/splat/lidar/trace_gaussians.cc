// SPDX-License-Identifier: Apache-2.0
#include "redrive/methods/splat/lidar/trace_gaussians.h"

#include <algorithm>
#include <optional>
#include <vector>

namespace redrive {
namespace {

/// Draws a group's rays.
void trace_group(kernels::GaussianStages& stages, const DrawnGaussians& drawn,
                 const kernels::Rays& rays, const RayGroup& group, const RayRaster& of_rays,
                 RenderedRays* out) {
  kernels::RasterOptions options;
  options.depth = true;
  const kernels::Raster raster =
      stages.rasterise(of_rays.camera(drawn.parts), drawn.gaussians, options);
  const kernels::RasterImage& image = raster.image();
  const std::size_t plane = image.size.plane();
  for (std::size_t k = 0; k < group.rays.size(); ++k) {
    const std::size_t ray = group.rays[k], place = of_rays.places()[k];
    const Eigen::Vector3d drawn_from = group.origin_at(double(group.azimuth[k]));
    double ahead = 0;  // the drawn origin before the ray's own
    for (std::size_t axis = 0; axis < 3; ++axis)
      ahead += (drawn_from[axis] - double(rays.origin[axis * rays.n + ray])) *
               double(rays.direction[axis * rays.n + ray]);
    const float depth = image.depth[place], opacity = 1 - image.transmittance[place];
    out->depth[ray] = depth > 0 ? std::max(0.0f, depth + static_cast<float>(ahead)) : 0.0f;
    out->opacity[ray] = opacity;
    out->intensity[ray] =
        opacity > 0 ? std::clamp(image.rgb[kIntensitySlot * plane + place] / opacity, 0.0f, 1.0f)
                    : 0.0f;
    out->lost[ray] = std::clamp(1 - image.rgb[kReturnSlot * plane + place], 0.0f, 1.0f);
  }
}

}  // namespace

RenderedRays trace_gaussians(kernels::GaussianStages& stages, ThreadPool& pool,
                             const kernels::Rays& rays,
                             const std::function<DrawnGaussians(const RayRaster&)>& drawn,
                             double beam_rad) {
  const std::vector<float> none(rays.n);
  RenderedRays out{none, none, none, none};
  const std::vector<RayGroup> groups = group_rays(rays, pool);
  std::vector<std::optional<RayRaster>> rasters(groups.size());
  pool.run(static_cast<int>(groups.size()),
           [&](int g) { rasters[g].emplace(groups[g], beam_rad); });
  for (std::size_t g = 0; g < groups.size(); ++g)
    trace_group(stages, drawn(*rasters[g]), rays, groups[g], *rasters[g], &out);
  return out;
}

}  // namespace redrive
