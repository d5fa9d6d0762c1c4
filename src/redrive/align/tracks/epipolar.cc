// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/epipolar.h"

#include <Eigen/Cholesky>

namespace redrive {
namespace {

constexpr std::size_t kMinPairs = 12;  // twice the degrees of freedom of the pose, and two

/// Pixels per radian: the root of the image area per solid angle.
std::optional<double> pixels_per_radian(const Camera& camera, const Eigen::Vector2d& pixel) {
  const auto right = camera.unproject(pixel + Eigen::Vector2d(1, 0)),
             left = camera.unproject(pixel - Eigen::Vector2d(1, 0));
  const auto below = camera.unproject(pixel + Eigen::Vector2d(0, 1)),
             above = camera.unproject(pixel - Eigen::Vector2d(0, 1));
  if (!right || !left || !below || !above) return std::nullopt;
  return 2 / std::sqrt((*right - *left).cross(*below - *above).norm());
}

/// The pose rotated by the first three numbers (rad), with its unit translation shifted by the
/// others and normalised again.
Rigid3d perturbed(const Rigid3d& pose, const Eigen::Matrix<double, 6, 1>& by) {
  Rigid3d result = Rigid3d::Identity();
  const double angle = by.head<3>().norm();
  result.linear() = pose.linear();
  if (angle > 0) result.linear() = Eigen::AngleAxisd(angle, by.head<3>() / angle) * pose.linear();
  result.translation() = (pose.translation() + by.tail<3>()).normalized();
  return result;
}

double robust_cost(const std::vector<RayPair>& pairs, const Rigid3d& pose, double scale_px) {
  double sum = 0;
  for (const RayPair& pair : pairs)
    sum += std::log1p(std::pow(sampson_error_px(pair, pose) / scale_px, 2));
  return sum;
}

Rigid3d fit_from(const std::vector<RayPair>& pairs, Rigid3d pose) {
  constexpr double kStep = 1e-6;
  for (const double scale_px : {16.0, 4.0, 2.0, 1.0}) {
    double damping = 1e-3, cost = robust_cost(pairs, pose, scale_px);
    for (int iteration = 0; iteration < 12; ++iteration) {
      Eigen::Matrix<double, 6, 6> h = Eigen::Matrix<double, 6, 6>::Zero();
      Eigen::Matrix<double, 6, 1> g = Eigen::Matrix<double, 6, 1>::Zero();
      std::array<Rigid3d, 6> ahead;
      for (int k = 0; k < 6; ++k)
        ahead[k] = perturbed(pose, kStep * Eigen::Matrix<double, 6, 1>::Unit(k));
      for (const RayPair& pair : pairs) {
        const double error = sampson_error_px(pair, pose);
        Eigen::Matrix<double, 6, 1> j;
        for (int k = 0; k < 6; ++k) j[k] = (sampson_error_px(pair, ahead[k]) - error) / kStep;
        const double weight = 1 / (1 + std::pow(error / scale_px, 2));
        h += weight * j * j.transpose();
        g += weight * error * j;
      }
      h.diagonal().array() += damping * h.trace() / 6 + 1e-9;
      const Rigid3d next = perturbed(pose, -h.ldlt().solve(g));
      const double next_cost = robust_cost(pairs, next, scale_px);
      const bool better = next_cost < cost;
      const bool settled = std::abs(next_cost - cost) < 1e-4 * cost;
      damping = better ? damping / 10 : damping * 10;
      if (better) {
        pose = next;
        cost = next_cost;
      }
      if (settled || damping > 10) break;
    }
  }
  return pose;
}

}  // namespace

std::optional<RayPair> make_ray_pair(const Camera& a, const Eigen::Vector2d& pixel_a,
                                     const Camera& b, const Eigen::Vector2d& pixel_b) {
  const auto ray_a = a.unproject(pixel_a), ray_b = b.unproject(pixel_b);
  const auto scale_a = pixels_per_radian(a, pixel_a), scale_b = pixels_per_radian(b, pixel_b);
  if (!ray_a || !ray_b || !scale_a || !scale_b) return std::nullopt;
  return RayPair{*ray_a, *ray_b, *scale_a, *scale_b};
}

double sampson_error_px(const RayPair& pair, const Rigid3d& b_from_a) {
  const Eigen::Vector3d a_in_b = b_from_a.linear() * pair.ray_a, t = b_from_a.translation();
  const Eigen::Vector3d by_b = t.cross(a_in_b),
                        by_a = pair.ray_b.cross(t);  // d e / d ray_b, d e / d (R ray_a)
  const double e = pair.ray_b.dot(by_b);
  const double variance = (by_b.squaredNorm() - e * e) / (pair.px_per_rad_b * pair.px_per_rad_b) +
                          (by_a.squaredNorm() - e * e) / (pair.px_per_rad_a * pair.px_per_rad_a);
  return variance > 0 ? e / std::sqrt(variance) : 0;
}

std::optional<double> ray_depth(const Eigen::Vector3d& ray_a, const Eigen::Vector3d& ray_b,
                                const Rigid3d& b_from_a) {
  const Eigen::Vector3d normal = (b_from_a.linear() * ray_a).cross(ray_b);
  if (normal.norm() < 0.01) return std::nullopt;
  // ray_b x (depth R ray_a + t) = 0
  const double depth = ray_b.cross(b_from_a.translation()).dot(normal) / normal.squaredNorm();
  if (!(depth > 0)) return std::nullopt;
  return depth;
}

std::optional<Rigid3d> fit_relative_pose(const std::vector<RayPair>& pairs,
                                         const std::vector<Rigid3d>& starts) {
  if (pairs.size() < kMinPairs) return std::nullopt;
  std::optional<Rigid3d> best;
  double best_cost = 0;
  for (Rigid3d start : starts) {
    if (start.translation().norm() < 1e-9) continue;
    start.translation().normalize();
    const Rigid3d pose = fit_from(pairs, start);
    const double cost = robust_cost(pairs, pose, 1);
    if (!best || cost < best_cost) {
      best = pose;
      best_cost = cost;
    }
  }
  return best;
}

}  // namespace redrive
