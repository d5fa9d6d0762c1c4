// SPDX-License-Identifier: Apache-2.0
// 3D Gaussians (Kerbl et al., SIGGRAPH 2023), their projection to an image and its adjoint.
//
// A Gaussian has the rows of GaussianRow. Its covariance is Q diag(exp(2 log_scale)) Q^T with the
// rotation Q of its quaternion; its opacity is sigmoid(logit). Projection follows the unscented
// transform through the exact camera (Wu et al., 3DGUT, CVPR 2025): the mean is projected exactly,
// and the covariance in the image is the sum over the axes j of d_j d_j^T, d_j = (pixel(p + k s_j
// q_j) - pixel(p - k s_j q_j)) / (2 k) with k = sqrt(3), less where a sigma point would come too
// close to the camera's plane. A filter of kScreenVariance is added to it, and the opacity is
// lowered by sqrt(det / filtered det), so that the sum over the pixels stays (Yu et al.,
// Mip-Splatting, CVPR 2024, section 4.2).
//
// Templated on the arithmetic M (math/lanes.h) and the camera C, a PlainCamera or SphericalCamera.
#pragma once

#include <cstddef>
#include <type_traits>

#include "redrive/camera/plain_camera.h"

namespace redrive {

/// Numbers of a Gaussian.
enum GaussianRow {
  kPositionRow,        ///< 3, world metres
  kLogScaleRow = 3,    ///< 3, logarithm of the standard deviations along its axes, metres
  kQuaternionRow = 6,  ///< 4: w x y z, any length > 0
  kOpacityRow = 10,    ///< logit
  kColourRow = 11,     ///< 3: r g b in [0, 1], seen along a direction across kHarmonicsRow
  /// 9: change of r, g, b by the x of the viewing direction in the world, then by y, then by z:
  /// spherical harmonics of degree 1.
  kHarmonicsRow = 14,
  /// 4: what a LiDAR sees in place of colours: intensity, then probability of a return, each a + b
  /// times the cosine of the angle of incidence.
  kLidarRow = 23,
  kReturnRow = 25,  ///< 2 of these, of the probability
  /// Distance to the nearest training camera, metres: scales the learning rate of the position. Not
  /// trained.
  kDistanceRow = 27,
  kGaussianRows = 28
};

/// Who sees a Gaussian: a LiDAR sees the rows kLidarRow in place of colours.
enum class SeenBy { kCamera, kLidar, kBoth };
template <class C>
constexpr bool kIsLidar = std::is_same_v<C, SphericalCamera>;
template <class C>
constexpr SeenBy kSeenBy = kIsLidar<C> ? SeenBy::kLidar : SeenBy::kCamera;
inline SeenBy seen_by(const PlainCamera& camera) {
  return camera.model == PlainCamera::kSpherical ? SeenBy::kLidar : SeenBy::kCamera;
}
/// Whether a row below kDistanceRow changes what is seen.
constexpr bool is_seen(SeenBy by, int row) {
  return row < kColourRow || by == SeenBy::kBoth || (row >= kLidarRow) == (by == SeenBy::kLidar);
}
/// Numbers that a LiDAR sees.
enum LidarSlot { kIntensitySlot, kReturnSlot, kLidarSlots };

/// Gaussians are stored in blocks of 16: [blocks, kGaussianRows, 16].
constexpr int kGaussianBlock = 16;
constexpr std::size_t kBlockSize = std::size_t{kGaussianRows} * kGaussianBlock;
constexpr std::size_t gaussian_blocks(std::size_t n) {
  return (n + kGaussianBlock - 1) / kGaussianBlock;
}
/// Index of a number of Gaussian i.
constexpr std::size_t gaussian_slot(std::size_t i, int row) {
  return i / kGaussianBlock * kBlockSize + static_cast<std::size_t>(row) * kGaussianBlock +
         i % kGaussianBlock;
}

constexpr float kScreenVariance = 0.15f;  ///< pixels^2
/// Pixels^2: in a scan the distance of smaller Gaussians changes less from ray to ray.
constexpr float kLidarSlopeVariance = 0.01f;
constexpr float kMinAlpha = 1.0f / 255;  ///< less is not blended
constexpr float kMaxAlpha = 0.99f;
constexpr float kMinTransmittance = 1e-3f;  ///< blending ends below
constexpr float kNearPlane_m = 0.2f;        ///< nearer means are not drawn
constexpr float kSigmaSpread = 1.7320508f;  ///< k: exact for the third moments of a Gaussian
/// largest offset of a sigma point from the mean, as a part of its distance
constexpr float kMaxSpread = 0.3f;
/// largest difference of a Gaussian's log distance at a pixel from its mean's
constexpr float kMaxLogDistance = 0.5f;
constexpr float kMaxRangeError = 0.5f;      ///< errors of log(t / range) beyond count as this
constexpr float kMinCompensation2 = 1e-4f;  ///< least det / filtered det

/// Pose of a camera for one Gaussian or one vector of them.
template <class M>
struct GaussianPose {
  typename M::Real rotation[9];  ///< camera_from_world, row-major
  typename M::Real centre[3];    ///< position of the camera in the world
};

/// A projected Gaussian and what its adjoint needs.
template <class M>
struct ProjectedGaussian {
  using Real = typename M::Real;
  typename M::Mask visible;
  Real point[3], length;  ///< mean in camera axes and its distance
  Real q[4], inverse_norm;
  Real axis[3][3];  ///< [j]: axis j in camera axes, unit
  Real scale[3], spread[3];
  typename M::Mask bounded[3];  ///< spread is below kSigmaSpread
  Real d[3][2];
  Real mean[2];      ///< pixels
  Real conic[3];     ///< inverse of the filtered covariance: xx, xy, yy
  Real variance[2];  ///< filtered, along x and y: pixels^2
  Real covariance;   ///< filtered, xy
  /// Change of the log distance per pixel at the point of highest density on the pixel's ray, which
  /// is the conditional mean of the Gaussian in (u, v, log distance).
  Real slope[2];
  Real det, filtered_det;
  Real opacity;       ///< sigmoid of the logit
  Real transparency;  ///< 1 - opacity, without its rounding
  Real alpha;         ///< opacity at the mean: times the filter's compensation
  Real direction[3];  ///< direction of the mean from the camera, world, unit
  Real incidence;     ///< LiDAR alone: cosine of the angle to the normal, the shortest axis
  Real colour[3];     ///< before the clamp at 0; of a LiDAR by LidarSlot, then 0
};

/// Derivatives of a loss with respect to a projected Gaussian.
template <class M>
struct ProjectedGradient {
  using Real = typename M::Real;
  Real mean[2], conic[3], log_alpha, colour[3], length;
};

/// Derivatives with respect to the camera's pose: by a translation and a small rotation (rad) of
/// the camera, in the world (scene/pose_corrections.h, ViewGradient).
template <class M>
struct GaussianPoseGradient {
  typename M::Real translation[3], rotation[3];
};

template <class M>
REDRIVE_LANES void rotation_from_quaternion(const typename M::Real* q, typename M::Real (*r)[3]) {
  using Real = typename M::Real;
  const Real one = M::constant(1), two = M::constant(2);
  const Real &w = q[0], &x = q[1], &y = q[2], &z = q[3];
  r[0][0] = one - two * (y * y + z * z);
  r[0][1] = two * (x * y - w * z);
  r[0][2] = two * (x * z + w * y);
  r[1][0] = two * (x * y + w * z);
  r[1][1] = one - two * (x * x + z * z);
  r[1][2] = two * (y * z - w * x);
  r[2][0] = two * (x * z - w * y);
  r[2][1] = two * (y * z + w * x);
  r[2][2] = one - two * (x * x + y * y);
}

template <class M>
REDRIVE_LANES void rotated_by(const typename M::Real* rotation, const typename M::Real* in,
                              typename M::Real* out) {
  for (int r = 0; r < 3; ++r)
    out[r] = rotation[3 * r] * in[0] + rotation[3 * r + 1] * in[1] + rotation[3 * r + 2] * in[2];
}
template <class M>
REDRIVE_LANES void rotated_back(const typename M::Real* rotation, const typename M::Real* in,
                                typename M::Real* out) {
  for (int k = 0; k < 3; ++k)
    out[k] = rotation[k] * in[0] + rotation[3 + k] * in[1] + rotation[6 + k] * in[2];
}

/// Adds the cross product of a and b to out.
template <class M>
REDRIVE_LANES void add_cross(const typename M::Real* a, const typename M::Real* b,
                             typename M::Real* out) {
  for (int k = 0; k < 3; ++k) {
    const int next = (k + 1) % 3, last = (k + 2) % 3;
    out[k] = out[k] + a[next] * b[last] - a[last] * b[next];
  }
}

/// Projects the mean alone: sets point, length, mean and visible.
template <class M, class C>
REDRIVE_LANES void project_mean(const C& camera, const GaussianPose<M>& pose,
                                const typename M::Real* position, ProjectedGaussian<M>* out) {
  using Real = typename M::Real;
  Real from_centre[3];
  for (int k = 0; k < 3; ++k) from_centre[k] = position[k] - pose.centre[k];
  rotated_by<M>(pose.rotation, from_centre, out->point);
  out->length = M::sqrt(out->point[0] * out->point[0] + out->point[1] * out->point[1] +
                        out->point[2] * out->point[2]);
  const PlainPixel<M> pixel = project<M>(camera, out->point[0], out->point[1], out->point[2]);
  out->mean[0] = pixel.u;
  out->mean[1] = pixel.v;
  const Real depth = camera.perspective ? out->point[2] : out->length;
  out->visible = M::both(pixel.valid, depth > M::constant(kNearPlane_m));
}

/// Sets incidence and colour of a LiDAR.
template <class M>
REDRIVE_LANES void show_lidar(const typename M::Real* rows, ProjectedGaussian<M>* out) {
  using Real = typename M::Real;
  const Real zero = M::constant(0);
  Real least = out->scale[0], along = zero;
  for (int j = 0; j < 3; ++j) {
    Real dot = zero;
    for (int k = 0; k < 3; ++k) dot = dot + out->axis[j][k] * out->point[k];
    const auto shorter = out->scale[j] < least;
    along = j == 0 ? dot : M::select(shorter, dot, along);
    least = M::select(shorter, out->scale[j], least);
  }
  out->incidence = M::stopped(M::max(along, -along) / out->length);
  for (int slot = 0; slot < kLidarSlots; ++slot)
    out->colour[slot] =
        rows[kLidarRow + 2 * slot] + rows[kLidarRow + 2 * slot + 1] * out->incidence;
  out->colour[2] = zero;
}

/// Projects Gaussians whose mean project_mean has projected. `rows`: their numbers, by
/// GaussianRow. Numbers of invisible lanes are arbitrary.
template <class M, class C>
REDRIVE_LANES void project_gaussian(const C& camera, const GaussianPose<M>& pose,
                                    const typename M::Real* rows, ProjectedGaussian<M>* out) {
  using Real = typename M::Real;
  const Real one = M::constant(1), filter = M::constant(kScreenVariance);
  const Real odds = M::exp(-rows[kOpacityRow]);
  out->opacity = one / (one + odds);
  // An opaque Gaussian goes on being trained: 1 - opacity would be 0 from a logit of 17 on.
  out->transparency = odds * out->opacity;
  Real norm2 = M::constant(0);
  for (int k = 0; k < 4; ++k) norm2 = norm2 + rows[kQuaternionRow + k] * rows[kQuaternionRow + k];
  out->inverse_norm = one / M::sqrt(norm2);
  for (int k = 0; k < 4; ++k) out->q[k] = rows[kQuaternionRow + k] * out->inverse_norm;
  Real q[3][3];
  rotation_from_quaternion<M>(out->q, q);
  const Real depth = M::stopped(camera.perspective ? out->point[2] : out->length);
  Real xx = M::constant(0), xy = M::constant(0), yy = M::constant(0);
  Real with_distance[2] = {xx, xx};  // covariance of the pixel and the logarithm of the distance
  for (int j = 0; j < 3; ++j) {
    const Real column[3] = {q[0][j], q[1][j], q[2][j]};
    rotated_by<M>(pose.rotation, column, out->axis[j]);
    out->scale[j] = M::exp(rows[kLogScaleRow + j]);
    const Real most = M::constant(kMaxSpread) * depth;
    out->bounded[j] = most < M::constant(kSigmaSpread) * out->scale[j];
    out->spread[j] = M::select(out->bounded[j], most / out->scale[j], M::constant(kSigmaSpread));
    const Real step = M::select(out->bounded[j], most, out->spread[j] * out->scale[j]);
    const Real* const e = out->axis[j];
    const Real* const p = out->point;
    const PlainPixel<M> ahead =
        project<M>(camera, p[0] + step * e[0], p[1] + step * e[1], p[2] + step * e[2]);
    const PlainPixel<M> behind =
        project<M>(camera, p[0] - step * e[0], p[1] - step * e[1], p[2] - step * e[2]);
    const Real half = M::constant(0.5) / out->spread[j];
    out->d[j][0] = (ahead.u - behind.u) * half;
    out->d[j][1] = (ahead.v - behind.v) * half;
    xx = xx + out->d[j][0] * out->d[j][0];
    xy = xy + out->d[j][0] * out->d[j][1];
    yy = yy + out->d[j][1] * out->d[j][1];
    const Real away =
        out->scale[j] * (e[0] * p[0] + e[1] * p[1] + e[2] * p[2]) / (out->length * out->length);
    for (int k = 0; k < 2; ++k) with_distance[k] = with_distance[k] + away * out->d[j][k];
  }
  // det(sum of d d^T) is the sum of the squared cross products (Cauchy-Binet): flat Gaussians seen
  // from their side lose no digits.
  out->det = M::constant(0);
  for (int j = 0; j < 3; ++j) {
    const int k = (j + 1) % 3;
    const Real cross = out->d[j][0] * out->d[k][1] - out->d[j][1] * out->d[k][0];
    out->det = out->det + cross * cross;
  }
  out->filtered_det = out->det + filter * (xx + yy) + filter * filter;
  out->variance[0] = xx + filter;
  out->variance[1] = yy + filter;
  out->covariance = xy;
  const Real inverse = one / out->filtered_det;
  out->conic[0] = out->variance[1] * inverse;
  out->conic[1] = -xy * inverse;
  out->conic[2] = out->variance[0] * inverse;
  // For a LiDAR a plane is as steep as before the filter.
  const Real steady = M::constant(kIsLidar<C> ? kLidarSlopeVariance : kScreenVariance),
             of_slope = one / (out->det + steady * (xx + yy) + steady * steady);
  out->slope[0] = ((yy + steady) * with_distance[0] - xy * with_distance[1]) * of_slope;
  out->slope[1] = ((xx + steady) * with_distance[1] - xy * with_distance[0]) * of_slope;
  out->alpha = out->opacity * M::sqrt(M::max(out->det * inverse, M::constant(kMinCompensation2)));
  const Real inverse_length = one / out->length;
  for (int k = 0; k < 3; ++k)
    out->direction[k] = (rows[kPositionRow + k] - pose.centre[k]) * inverse_length;
  if constexpr (kIsLidar<C>)
    show_lidar<M>(rows, out);
  else
    for (int c = 0; c < 3; ++c)
      out->colour[c] = rows[kColourRow + c] + rows[kHarmonicsRow + c] * out->direction[0] +
                       rows[kHarmonicsRow + 3 + c] * out->direction[1] +
                       rows[kHarmonicsRow + 6 + c] * out->direction[2];
}

/// Writes the derivatives with respect to the rows that the camera sees (is_seen) and, if `d_pose`
/// is not null, to the pose. The spread's bound by the distance, the slope, the row of a rolling
/// shutter and the incidence count as constants.
template <class M, class C>
REDRIVE_LANES void project_gaussian_adjoint(const C& camera, const GaussianPose<M>& pose,
                                            const typename M::Real* rows,
                                            const ProjectedGaussian<M>& at,
                                            const ProjectedGradient<M>& gradient,
                                            typename M::Real* d_rows,
                                            GaussianPoseGradient<M>* d_pose) {
  using Real = typename M::Real;
  const Real zero = M::constant(0), one = M::constant(1), two = M::constant(2),
             half = M::constant(0.5), filter = M::constant(kScreenVariance);
  // Opacity, compensation and conic.
  const Real inverse = one / at.filtered_det;
  const Real compensated =
      M::select(at.det * inverse > M::constant(kMinCompensation2), half * gradient.log_alpha, zero);
  Real d_det = compensated / M::max(at.det, M::constant(1e-30));
  const Real d_filtered =
      -compensated * inverse - (gradient.conic[0] * at.conic[0] + gradient.conic[1] * at.conic[1] +
                                gradient.conic[2] * at.conic[2]) *
                                   inverse;
  const Real d_xx = gradient.conic[2] * inverse + filter * d_filtered,
             d_yy = gradient.conic[0] * inverse + filter * d_filtered,
             d_xy = -gradient.conic[1] * inverse;
  d_det = d_det + d_filtered;
  d_rows[kOpacityRow] = gradient.log_alpha * at.transparency;
  Real d_d[3][2];
  for (int j = 0; j < 3; ++j) {
    d_d[j][0] = two * d_xx * at.d[j][0] + d_xy * at.d[j][1];
    d_d[j][1] = two * d_yy * at.d[j][1] + d_xy * at.d[j][0];
  }
  for (int j = 0; j < 3; ++j) {
    const int k = (j + 1) % 3;
    const Real d_cross = two * d_det * (at.d[j][0] * at.d[k][1] - at.d[j][1] * at.d[k][0]);
    d_d[j][0] = d_d[j][0] + d_cross * at.d[k][1];
    d_d[j][1] = d_d[j][1] - d_cross * at.d[k][0];
    d_d[k][0] = d_d[k][0] - d_cross * at.d[j][1];
    d_d[k][1] = d_d[k][1] + d_cross * at.d[j][0];
  }
  // The mean and the sigma points.
  const Real* const p = at.point;
  Real d_point[3] = {zero, zero, zero}, turn[3] = {zero, zero, zero};
  project_adjoint<M>(camera, p[0], p[1], p[2], gradient.mean[0], gradient.mean[1], d_point);
  const Real by_length = gradient.length / at.length;
  for (int k = 0; k < 3; ++k) d_point[k] = d_point[k] + by_length * p[k];
  Real d_q[3][3];  // derivatives with respect to the Gaussian's rotation matrix
  for (int j = 0; j < 3; ++j) {
    const Real step = at.spread[j] * at.scale[j], per = half / at.spread[j];
    const Real d_u = d_d[j][0] * per, d_v = d_d[j][1] * per;
    const Real* const e = at.axis[j];
    Real ahead[3] = {zero, zero, zero}, behind[3] = {zero, zero, zero};
    project_adjoint<M>(camera, p[0] + step * e[0], p[1] + step * e[1], p[2] + step * e[2], d_u, d_v,
                       ahead);
    project_adjoint<M>(camera, p[0] - step * e[0], p[1] - step * e[1], p[2] - step * e[2], -d_u,
                       -d_v, behind);
    Real d_axis[3], along = zero;
    for (int k = 0; k < 3; ++k) {
      d_point[k] = d_point[k] + ahead[k] + behind[k];
      d_axis[k] = (ahead[k] - behind[k]) * step;
      along = along + d_axis[k] * e[k];
    }
    // With a bounded spread the step is constant and d is proportional to the scale.
    d_rows[kLogScaleRow + j] =
        M::select(at.bounded[j], d_d[j][0] * at.d[j][0] + d_d[j][1] * at.d[j][1], along);
    Real in_world[3];
    rotated_back<M>(pose.rotation, d_axis, in_world);
    for (int k = 0; k < 3; ++k) d_q[k][j] = in_world[k];
    if (d_pose) {
      add_cross<M>(e, d_axis, turn);
    }
  }
  Real d_position[3];
  rotated_back<M>(pose.rotation, d_point, d_position);
  if (d_pose) {
    add_cross<M>(p, d_point, turn);
    Real in_world[3];
    rotated_back<M>(pose.rotation, turn, in_world);
    for (int k = 0; k < 3; ++k) d_pose->rotation[k] = -in_world[k];
  }
  // Colour. One below 0 may rise, though it changes no pixel yet: with the derivative of the clamp
  // an opaque Gaussian that once became black would remain black.
  Real d_direction[3] = {zero, zero, zero}, radial = zero;
  for (int c = 0; c < 3; ++c) {
    const auto positive = at.colour[c] > zero;
    const Real d = M::select(positive, gradient.colour[c], zero),
               d_colour = M::select(positive, d, -M::max(-gradient.colour[c], zero));
    if constexpr (kIsLidar<C>) {
      if (c == kLidarSlots) break;
      d_rows[kLidarRow + 2 * c] = d_colour;
      d_rows[kLidarRow + 2 * c + 1] = d_colour * at.incidence;
    } else {
      d_rows[kColourRow + c] = d_colour;
      for (int k = 0; k < 3; ++k) {
        d_rows[kHarmonicsRow + 3 * k + c] = d_colour * at.direction[k];
        d_direction[k] = d_direction[k] + d * rows[kHarmonicsRow + 3 * k + c];
      }
    }
  }
  for (int k = 0; k < 3; ++k) radial = radial + d_direction[k] * at.direction[k];
  const Real inverse_length = one / at.length;
  for (int k = 0; k < 3; ++k) {
    d_rows[kPositionRow + k] =
        d_position[k] + (d_direction[k] - radial * at.direction[k]) * inverse_length;
    if (d_pose) d_pose->translation[k] = -d_rows[kPositionRow + k];
  }
  // Rotation matrix to quaternion, and its normalisation.
  const Real &w = at.q[0], &x = at.q[1], &y = at.q[2], &z = at.q[3];
  const Real d[4] = {two * (z * (d_q[1][0] - d_q[0][1]) + y * (d_q[0][2] - d_q[2][0]) +
                            x * (d_q[2][1] - d_q[1][2])),
                     two * (y * (d_q[0][1] + d_q[1][0]) + z * (d_q[0][2] + d_q[2][0]) +
                            w * (d_q[2][1] - d_q[1][2]) - two * x * (d_q[1][1] + d_q[2][2])),
                     two * (x * (d_q[0][1] + d_q[1][0]) + z * (d_q[1][2] + d_q[2][1]) +
                            w * (d_q[0][2] - d_q[2][0]) - two * y * (d_q[0][0] + d_q[2][2])),
                     two * (x * (d_q[0][2] + d_q[2][0]) + y * (d_q[1][2] + d_q[2][1]) +
                            w * (d_q[1][0] - d_q[0][1]) - two * z * (d_q[0][0] + d_q[1][1]))};
  const Real dot = w * d[0] + x * d[1] + y * d[2] + z * d[3];
  for (int k = 0; k < 4; ++k) d_rows[kQuaternionRow + k] = (d[k] - at.q[k] * dot) * at.inverse_norm;
}

}  // namespace redrive
