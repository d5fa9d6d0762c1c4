// SPDX-License-Identifier: Apache-2.0
// For tests: a field whose rays are a formula, with lost ones and intensities.
#pragma once

#include <functional>
#include <vector>

#include "redrive/model/field.h"

namespace redrive {

class MadeField : public Field {
 public:
  struct Ray {
    float depth_m = 10, lost = 0, intensity = 0;
  };
  /// Returns what the ray meets from `origin` along `direction`, in the world.
  using Formula =
      std::function<Ray(const Eigen::Vector3f& origin, const Eigen::Vector3f& direction)>;

  const char* method() const override { return "made"; }
  std::string describe() const override { return "made"; }
  void render_to(kernels::Backend&, const RayTable&, const ShutterPoses&, const Exposure&,
                 RenderedImage*) const override {}
  RenderedRays trace(kernels::Backend&, const kernels::Rays& rays,
                     const std::vector<MovingObject>& = {}) const override {
    const auto n = static_cast<std::size_t>(rays.n);
    RenderedRays out;
    for (std::size_t i = 0; i < n; ++i) {
      const auto at = [&](std::span<const float> v) {
        return Eigen::Vector3f(v[i], v[n + i], v[2 * n + i]);
      };
      const Ray ray = formula(at(rays.origin), at(rays.direction));
      out.depth.push_back(ray.depth_m);
      out.opacity.push_back(1);
      if (!has_signals) continue;
      out.intensity.push_back(ray.intensity);
      out.lost.push_back(ray.lost);
    }
    return out;
  }

  Formula formula = [](const auto&, const auto&) { return Ray{}; };
  bool has_signals = false;  ///< whether it models losses and intensities
};

}  // namespace redrive
