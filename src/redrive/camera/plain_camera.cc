// SPDX-License-Identifier: Apache-2.0
#include "redrive/camera/plain_camera.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>

#include "redrive/camera/camera.h"

namespace redrive {
namespace {

/// Returns the radius on the model's plane where the distorted one reaches `radius`, or the model's
/// edge.
template <class Model>
double valid_radius(const Model& model, double radius) {
  constexpr double kStep = 1e-3, kMost = 10;
  double r = 0;
  while (r < kMost && r + kStep < model.max_plane_radius()) {
    if (r * Model::Radial::template radial_factor<NumberMath<double>>(model.numbers(), r * r)
                .value >
        radius)
      break;
    r += kStep;
  }
  return r;
}

template <class Model>
void set_model(const Model& model, double most, PlainCamera* out) {
  using Numbers = typename Model::template Numbers<double>;
  const Numbers numbers = model.numbers();
  const auto all = std::bit_cast<std::array<double, sizeof(Numbers) / sizeof(double)>>(numbers);
  std::ranges::transform(all, out->numbers, [](double x) { return static_cast<float>(x); });
  out->perspective = Model::kPerspective;
  const double radius = valid_radius(model, most);
  out->max_radius2 = static_cast<float>(radius * radius);
}

}  // namespace

PlainCamera make_plain_camera(const Camera& camera, double margin) {
  PlainCamera out;
  out.model = static_cast<int>(camera.model.index());
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
  std::visit([&](const auto& model) { set_model(model, margin * corner, &out); }, camera.model);
  return out;
}

SphericalCamera make_spherical_camera(double per_radian, double radius_rad, int width, int height) {
  SphericalCamera out{PlainCamera()};
  out.model = PlainCamera::kSpherical;
  out.perspective = false;
  out.fx = out.fy = static_cast<float>(per_radian);
  out.max_radius2 = static_cast<float>(radius_rad * radius_rad);
  out.width = width;
  out.height = height;
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
