// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/plain_camera.h"

#include <algorithm>
#include <cmath>

#include "redrive/math/dual.h"

namespace redrive {
namespace {

constexpr double kMargin = 1.15;  // times the radius of the image's corners

/// Returns the undistorted radius where the distorted one reaches `radius`, or the model's edge.
double valid_radius(const BrownConrady& lens, double radius) {
  constexpr double kStep = 1e-3, kMost = 10;
  double r = 0;
  while (r < kMost && r + kStep < lens.max_radius) {
    const double s = r * r;
    if (r * (1 + s * (lens.k1 + s * (lens.k2 + s * lens.k3))) > radius) break;
    r += kStep;
  }
  return r;
}

void set_distortion(const BrownConrady& lens, double corner, PlainCamera* out) {
  out->k1 = static_cast<float>(lens.k1);
  out->k2 = static_cast<float>(lens.k2);
  out->p1 = static_cast<float>(lens.p1);
  out->p2 = static_cast<float>(lens.p2);
  out->k3 = static_cast<float>(lens.k3);
  const double radius = valid_radius(lens, kMargin * corner);
  out->max_radius2 = static_cast<float>(radius * radius);
}

/// Projects one point through any model, with derivatives.
bool project_any(const void* camera, const float* point, float* normalised, float* jacobian) {
  const Camera& c = *static_cast<const Camera*>(camera);
  return std::visit(
      [&](const auto& model) {
        const auto distorted = model.template project<Dual>(
            {Dual(static_cast<double>(point[0]), 0), Dual(static_cast<double>(point[1]), 1),
             Dual(static_cast<double>(point[2]), 2)});
        if (!distorted) return false;
        for (int row = 0; row < 2; ++row) {
          normalised[row] = static_cast<float>((*distorted)[row].value);
          for (int k = 0; k < 3; ++k)
            jacobian[3 * row + k] = static_cast<float>((*distorted)[row].d[k]);
        }
        return true;
      },
      c.model);
}

}  // namespace

PlainCamera make_plain_camera(const Camera& camera) {
  PlainCamera out;
  out.fx = static_cast<float>(camera.fx);
  out.fy = static_cast<float>(camera.fy);
  out.cx = static_cast<float>(camera.cx);
  out.cy = static_cast<float>(camera.cy);
  out.width = camera.width;
  out.height = camera.height;
  double corner = 0;
  for (const double u : {-0.5, camera.width - 0.5})
    for (const double v : {-0.5, camera.height - 0.5})
      corner =
          std::max(corner, std::hypot((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy));
  if (const auto* pinhole = std::get_if<OpenCvPinhole>(&camera.model)) {
    set_distortion(pinhole->distortion, corner, &out);
  } else if (const auto* mei = std::get_if<Mei>(&camera.model)) {
    out.kind = PlainCamera::Kind::kMei;
    out.xi = static_cast<float>(mei->xi);
    // Points with a clamped w (math/plain_camera.h) have another pixel than the camera's.
    out.min_cosine = static_cast<float>(std::max(mei->xi > 1 ? -1 / mei->xi : -mei->xi,
                                                 static_cast<double>(kMinMeiDepth) - mei->xi));
    set_distortion(mei->distortion, corner, &out);
  } else {
    out.kind = PlainCamera::Kind::kOther;
    out.project_point = project_any;
    out.model = &camera;
  }
  return out;
}

PlainCamera window_of(PlainCamera camera, int x, int y, int width, int height) {
  camera.cx -= static_cast<float>(x);
  camera.cy -= static_cast<float>(y);
  camera.width = width;
  camera.height = height;
  return camera;
}

}  // namespace redrive
