// SPDX-License-Identifier: Apache-2.0
// A camera in plain numbers, for kernels that project many points. The arithmetic M is a template
// parameter (math/lanes.h): one number or a vector of them. The formulas belong to the model.
#pragma once

#include <cstring>

#include "redrive/camera/lenses/lens.h"
#include "redrive/camera/lenses/spherical.h"
#include "redrive/camera/models.h"

namespace redrive {

struct Camera;

struct PlainCamera {
  static constexpr int kMostNumbers = 29, kSpherical = -1;

  int model = 0;                         ///< index into CameraModel; kSpherical: SphericalCamera
  bool perspective = true;               ///< whether the model sees only what is in front of it
  float fx = 1, fy = 1, cx = 0, cy = 0;  ///< pixel = f (x, y) + c; integers are pixel centres
  float numbers[kMostNumbers] = {};      ///< the model's Numbers
  /// Square of the radius on the model's plane up to which points count; its radial factor is
  /// constant beyond. Ends where the model folds, or somewhat outside the image.
  float max_radius2 = 1e9f;
  int width = 0, height = 0;
};

/// The projection of camera/lenses/spherical.h: fx and fy are pixels per radian. It is a type of
/// its own: kernels have its code beside the code of cameras, which therefore changes no bit.
struct SphericalCamera : PlainCamera {
  explicit REDRIVE_LANES SphericalCamera(const PlainCamera& camera) : PlainCamera(camera) {}
};

/// Calls use(camera), by its type.
template <class Use>
REDRIVE_LANES auto with_camera(const PlainCamera& camera, const Use& use) {
  return camera.model == PlainCamera::kSpherical ? use(SphericalCamera(camera)) : use(camera);
}

/// Points count up to `margin` times the radius of the image's corners, so that what is centred
/// beyond the edge reaches into the image, or to where the model folds.
PlainCamera make_plain_camera(const Camera& camera, double margin = 1.15);

/// u and v are angles times `per_radian`; points count up to `radius_rad` from u = v = 0, which
/// must stay below pi / 2, the poles.
SphericalCamera make_spherical_camera(double per_radian, double radius_rad, int width, int height);

/// Returns the camera of the window of width x height pixels from (x, y) on.
PlainCamera window_of(PlainCamera camera, int x, int y, int width, int height);

template <class M>
struct PlainPixel {
  typename M::Real u, v;
  typename M::Mask valid;
};

namespace plain_camera_detail {

template <class Model>
struct ModelTag {
  using Type = Model;
};

/// Calls use(ModelTag<Model>{}, the model's numbers) for the camera's model.
template <int i = 0, class Use>
REDRIVE_LANES void with_model(const PlainCamera& camera, const Use& use) {
  using Model = std::variant_alternative_t<i, CameraModel>;
  using Numbers = typename Model::template Numbers<float>;
  static_assert(sizeof(Numbers) <= sizeof camera.numbers);
  if constexpr (i + 1 < static_cast<int>(std::variant_size_v<CameraModel>))
    if (camera.model != i) return with_model<i + 1>(camera, use);
  Numbers numbers;
  std::memcpy(&numbers, camera.numbers, sizeof numbers);
  use(ModelTag<Model>{}, numbers);
}

}  // namespace plain_camera_detail

/// Projects points in camera axes. u and v are finite where the point is in front of the camera,
/// and in the valid region if `valid` holds.
template <class M>
REDRIVE_LANES PlainPixel<M> project(const PlainCamera& camera, typename M::Real x,
                                    typename M::Real y, typename M::Real z) {
  PlainPixel<M> out;
  plain_camera_detail::with_model(
      camera, [&](auto model, const auto& numbers) __attribute__((always_inline)) {
        const LensPoint<M> at = project_lens<typename decltype(model)::Type, M>(
            numbers, M::constant(camera.max_radius2), x, y, z);
        out = {M::constant(camera.fx) * at.x + M::constant(camera.cx),
               M::constant(camera.fy) * at.y + M::constant(camera.cy), at.valid};
      });
  return out;
}

template <class M>
REDRIVE_LANES PlainPixel<M> project(const SphericalCamera& camera, typename M::Real x,
                                    typename M::Real y, typename M::Real z) {
  const PlanePoint<M> at = SphericalPlane::project<M>(x, y, z);
  return {M::constant(camera.fx) * at.x, M::constant(camera.fy) * at.y,
          M::both(at.seen, at.s <= M::constant(camera.max_radius2))};
}

/// Adds the derivatives of u d_u + v d_v with respect to the point to d_point[3].
template <class M>
REDRIVE_LANES void project_adjoint(const PlainCamera& camera, typename M::Real x,
                                   typename M::Real y, typename M::Real z, typename M::Real d_u,
                                   typename M::Real d_v, typename M::Real* d_point) {
  plain_camera_detail::with_model(
      camera, [&](auto model, const auto& numbers) __attribute__((always_inline)) {
        project_lens_adjoint<typename decltype(model)::Type, M>(
            numbers, M::constant(camera.max_radius2), x, y, z, d_u * M::constant(camera.fx),
            d_v * M::constant(camera.fy), d_point);
      });
}

template <class M>
REDRIVE_LANES void project_adjoint(const SphericalCamera& camera, typename M::Real x,
                                   typename M::Real y, typename M::Real z, typename M::Real d_u,
                                   typename M::Real d_v, typename M::Real* d_point) {
  SphericalPlane::adjoint<M>(x, y, z, d_u * M::constant(camera.fx), d_v * M::constant(camera.fy),
                             d_point);
}

}  // namespace redrive
