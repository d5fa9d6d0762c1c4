// SPDX-License-Identifier: Apache-2.0
// A camera in plain numbers, for kernels that project many points (camera/plain_camera.h makes it).
// Templated on the arithmetic M (math/lanes.h): one number or a vector of them.
#pragma once

#include "redrive/math/lanes.h"

namespace redrive {

struct PlainCamera {
  /// Models with a projection of their own below; the others go through `project_point`.
  enum class Kind { kPinhole, kMei, kOther };
  Kind kind = Kind::kPinhole;
  float fx = 1, fy = 1, cx = 0, cy = 0;          ///< pixel = f x + c; integers are pixel centres
  float k1 = 0, k2 = 0, p1 = 0, p2 = 0, k3 = 0;  ///< camera/brown_conrady.h
  float xi = 0;                                  ///< camera/mei.h
  /// Square of the undistorted radius up to which points count; the radial polynomial is constant
  /// beyond. Ends where the model folds, or somewhat outside the image.
  float max_radius2 = 1e9f;
  float min_cosine = 0;  ///< least cosine between the optical axis and directions that count
  int width = 0, height = 0;
  /// Projects point[3] (any length > 0) to normalised[2], pixel = f normalised + c, with their
  /// derivatives jacobian[2][3]; false outside the valid region.
  bool (*project_point)(const void* model, const float* point, float* normalised,
                        float* jacobian) = nullptr;
  const void* model = nullptr;  ///< for project_point; must outlive the copies of this camera
};

/// Least w = Z + xi |point|, in lengths of the point, that points are projected with: sigma points
/// near the edge of the sphere stay finite.
constexpr float kMinMeiDepth = 0.02f;

template <class M>
struct PlainPixel {
  typename M::Real u, v;
  typename M::Mask valid;
};

namespace plain_camera_detail {

/// Normalised coordinates before the distortion and the numbers that their derivatives need.
template <class M>
struct Normalised {
  typename M::Real x, y, inverse_w, length, radius2;
  typename M::Mask clamped_w;
};

template <class M>
REDRIVE_LANES Normalised<M> normalise(const PlainCamera& camera, typename M::Real x,
                                      typename M::Real y, typename M::Real z) {
  using Real = typename M::Real;
  Normalised<M> n;
  n.length = M::sqrt(x * x + y * y + z * z);
  Real w = z;
  n.clamped_w = w != w;  // false
  if (camera.kind == PlainCamera::Kind::kMei) {
    w = z + M::constant(camera.xi) * n.length;
    const Real least = M::constant(kMinMeiDepth) * n.length;
    n.clamped_w = w < least;
    w = M::select(n.clamped_w, least, w);
  }
  n.inverse_w = M::constant(1) / w;
  n.x = x * n.inverse_w;
  n.y = y * n.inverse_w;
  n.radius2 = n.x * n.x + n.y * n.y;
  return n;
}

/// The radial factor g and its derivative by the squared radius, constant beyond max_radius2.
template <class M>
REDRIVE_LANES void radial_factor(const PlainCamera& camera, typename M::Real radius2,
                                 typename M::Real* g, typename M::Real* derivative) {
  using Real = typename M::Real;
  const Real limit = M::constant(camera.max_radius2), s = M::min(radius2, limit);
  *g = M::constant(1) +
       s * (M::constant(camera.k1) + s * (M::constant(camera.k2) + s * M::constant(camera.k3)));
  *derivative = M::select(
      radius2 < limit,
      M::constant(camera.k1) + s * (M::constant(2 * camera.k2) + s * M::constant(3 * camera.k3)),
      M::constant(0));
}

}  // namespace plain_camera_detail

/// Projects points in camera axes. u and v are finite where the point is in front of the camera,
/// and in the valid region if `valid` holds.
template <class M>
REDRIVE_LANES PlainPixel<M> project(const PlainCamera& camera, typename M::Real x,
                                    typename M::Real y, typename M::Real z) {
  using Real = typename M::Real;
  if (camera.kind == PlainCamera::Kind::kOther) {
    PlainPixel<M> out{M::constant(0), M::constant(0), x != x};
    for (int lane = 0; lane < M::kLanes; ++lane) {
      const float point[3] = {M::get(x, lane), M::get(y, lane), M::get(z, lane)};
      float at[2] = {0, 0}, jacobian[6];
      const bool valid = camera.project_point(camera.model, point, at, jacobian);
      M::set(&out.u, lane, camera.fx * at[0] + camera.cx);
      M::set(&out.v, lane, camera.fy * at[1] + camera.cy);
      M::set_mask(&out.valid, lane, valid);
    }
    return out;
  }
  const plain_camera_detail::Normalised<M> n = plain_camera_detail::normalise<M>(camera, x, y, z);
  Real g, unused;
  plain_camera_detail::radial_factor<M>(camera, n.radius2, &g, &unused);
  const Real p1 = M::constant(camera.p1), p2 = M::constant(camera.p2), two = M::constant(2);
  const Real xd = n.x * g + two * p1 * n.x * n.y + p2 * (n.radius2 + two * n.x * n.x);
  const Real yd = n.y * g + p1 * (n.radius2 + two * n.y * n.y) + two * p2 * n.x * n.y;
  const Real cosine = M::constant(camera.min_cosine) * n.length;
  return {M::constant(camera.fx) * xd + M::constant(camera.cx),
          M::constant(camera.fy) * yd + M::constant(camera.cy),
          M::both(z > cosine, n.radius2 < M::constant(camera.max_radius2))};
}

/// Adds the derivatives of u d_u + v d_v with respect to the point to d_point[3].
template <class M>
REDRIVE_LANES void project_adjoint(const PlainCamera& camera, typename M::Real x,
                                   typename M::Real y, typename M::Real z, typename M::Real d_u,
                                   typename M::Real d_v, typename M::Real* d_point) {
  using Real = typename M::Real;
  if (camera.kind == PlainCamera::Kind::kOther) {
    for (int lane = 0; lane < M::kLanes; ++lane) {
      const float point[3] = {M::get(x, lane), M::get(y, lane), M::get(z, lane)};
      float at[2] = {0, 0}, jacobian[6] = {};
      if (!camera.project_point(camera.model, point, at, jacobian)) continue;
      for (int k = 0; k < 3; ++k)
        M::set(&d_point[k], lane,
               M::get(d_point[k], lane) + camera.fx * M::get(d_u, lane) * jacobian[k] +
                   camera.fy * M::get(d_v, lane) * jacobian[3 + k]);
    }
    return;
  }
  const plain_camera_detail::Normalised<M> n = plain_camera_detail::normalise<M>(camera, x, y, z);
  Real g, dg;
  plain_camera_detail::radial_factor<M>(camera, n.radius2, &g, &dg);
  const Real p1 = M::constant(camera.p1), p2 = M::constant(camera.p2), two = M::constant(2),
             six = M::constant(6);
  const Real xx = g + two * n.x * n.x * dg + two * p1 * n.y + six * p2 * n.x,
             yy = g + two * n.y * n.y * dg + six * p1 * n.y + two * p2 * n.x,
             xy = two * n.x * n.y * dg + two * p1 * n.x + two * p2 * n.y;
  d_u = d_u * M::constant(camera.fx);
  d_v = d_v * M::constant(camera.fy);
  const Real d_x = (d_u * xx + d_v * xy) * n.inverse_w, d_y = (d_u * xy + d_v * yy) * n.inverse_w;
  const Real d_w = -(d_x * n.x + d_y * n.y);
  d_point[0] = d_point[0] + d_x;
  d_point[1] = d_point[1] + d_y;
  if (camera.kind != PlainCamera::Kind::kMei) {
    d_point[2] = d_point[2] + d_w;
    return;
  }
  const Real by_length =
      d_w * M::select(n.clamped_w, M::constant(kMinMeiDepth), M::constant(camera.xi)) / n.length;
  d_point[0] = d_point[0] + by_length * x;
  d_point[1] = d_point[1] + by_length * y;
  d_point[2] = d_point[2] + by_length * z + M::select(n.clamped_w, M::constant(0), d_w);
}

}  // namespace redrive
