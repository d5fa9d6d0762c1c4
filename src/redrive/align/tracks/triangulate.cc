// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/triangulate.h"

#include <Eigen/Cholesky>

#include "redrive/base/error.h"
#include "redrive/perception/nearest_to_rays.h"

namespace redrive {
namespace {

struct Problem {
  const Track& track;
  std::span<const Rigid3d> world_from_camera;
  std::span<const Camera> cameras;
  double scale_px;

  std::optional<Eigen::Vector2d> residual(std::size_t i, const Eigen::Vector3d& point) const {
    return reprojection_residual(point, track.seen[i], world_from_camera[i],
                                 cameras[track.seen[i].camera]);
  }

  /// sum of r^2 / (r^2 + scale^2); a point that is not seen counts as infinitely far.
  double cost(const Eigen::Vector3d& point) const {
    double sum = 0;
    for (std::size_t i = 0; i < track.seen.size(); ++i) {
      const auto r = residual(i, point);
      sum += r ? r->squaredNorm() / (r->squaredNorm() + scale_px * scale_px) : 1;
    }
    return sum;
  }

  /// One Gauss-Newton step with Geman-McClure's weights; zero where it has no solution.
  Eigen::Vector3d step(const Eigen::Vector3d& point) const {
    Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
    Eigen::Vector3d g = Eigen::Vector3d::Zero();
    for (std::size_t i = 0; i < track.seen.size(); ++i) {
      const auto r = residual(i, point);
      if (!r) continue;
      const double delta_m = 1e-6 * (point - world_from_camera[i].translation()).norm() + 1e-12;
      Eigen::Matrix<double, 2, 3> jacobian;
      bool seen = true;
      for (int d = 0; d < 3 && seen; ++d) {
        const auto plus = residual(i, point + delta_m * Eigen::Vector3d::Unit(d));
        const auto minus = residual(i, point - delta_m * Eigen::Vector3d::Unit(d));
        seen = plus && minus;
        if (seen) jacobian.col(d) = (*plus - *minus) / (2 * delta_m);
      }
      if (!seen) continue;
      const double weight =
          std::pow(scale_px * scale_px / (r->squaredNorm() + scale_px * scale_px), 2);
      h += weight * jacobian.transpose() * jacobian;
      g += weight * jacobian.transpose() * *r;
    }
    const Eigen::LDLT<Eigen::Matrix3d> solver(h);
    if (solver.info() != Eigen::Success || !(solver.rcond() > 1e-14))
      return Eigen::Vector3d::Zero();
    return -solver.solve(g);
  }
};

}  // namespace

std::optional<Eigen::Vector2d> reprojection_residual(const Eigen::Vector3d& in_world,
                                                     const Observation& observation,
                                                     const Rigid3d& world_from_camera,
                                                     const Camera& camera) {
  const auto pixel = camera.project(world_from_camera.linear().transpose() *
                                    (in_world - world_from_camera.translation()));
  if (!pixel) return std::nullopt;
  return *pixel - observation.pixel;
}

std::optional<Eigen::Vector3d> triangulate(const Track& track,
                                           std::span<const Rigid3d> world_from_camera,
                                           std::span<const Camera> cameras,
                                           const TriangulateOptions& options) {
  const std::size_t n = track.seen.size();
  REDRIVE_CHECK_OP(world_from_camera.size(), ==, n);
  if (n < 2) return std::nullopt;
  std::vector<WorldRay> rays;
  for (std::size_t i = 0; i < n; ++i) {
    const auto direction = cameras[track.seen[i].camera].unproject(track.seen[i].pixel);
    if (!direction) return std::nullopt;
    rays.push_back(
        {world_from_camera[i].translation(), world_from_camera[i].linear() * *direction});
  }

  const Problem problem{track, world_from_camera, cameras, options.outlier_px};
  std::vector<Eigen::Vector3d> starts;
  const auto add_start = [&](std::span<const WorldRay> of) {
    constexpr double kParallel = 1e-12;  // least eigenvalue of a ray
    const NearestToRays nearest = nearest_to_rays(of);
    if (nearest.least_eigenvalue > kParallel * static_cast<double>(of.size()))
      starts.push_back(of[0].origin + nearest.from_first);
  };
  add_start(rays);
  if (n > 2) {  // pairs of up to five observations spread over the track: one without outliers is a
                // good start
    const std::size_t spread = std::min<std::size_t>(n, 5);
    for (std::size_t a = 0; a < spread; ++a)
      for (std::size_t b = a + 1; b < spread; ++b) {
        const WorldRay two[] = {rays[a * (n - 1) / (spread - 1)], rays[b * (n - 1) / (spread - 1)]};
        add_start(two);
      }
  }
  if (starts.empty()) return std::nullopt;
  Eigen::Vector3d point =
      *std::ranges::min_element(starts, {}, [&](const auto& p) { return problem.cost(p); });

  double cost = problem.cost(point);
  for (int iteration = 0; iteration < 20; ++iteration) {
    Eigen::Vector3d step = problem.step(point);
    double next = problem.cost(point + step);
    for (int halved = 0; next > cost && halved < 6; ++halved)
      next = problem.cost(point + (step /= 2));
    if (!(next <= cost)) break;
    point += step;
    cost = next;
    if (step.norm() < 1e-10 * (point - rays[0].origin).norm()) break;
  }

  std::vector<Eigen::Vector3d> agreeing;  // directions to the point
  for (std::size_t i = 0; i < n; ++i) {
    const auto r = problem.residual(i, point);
    const Eigen::Vector3d to_point = point - rays[i].origin;
    if (r && r->norm() <= options.outlier_px && to_point.dot(rays[i].direction) > 0)
      agreeing.push_back(to_point.normalized());
  }
  if (agreeing.size() < std::max<std::size_t>(2, (n + 1) / 2)) return std::nullopt;
  double widest = 0;
  for (const Eigen::Vector3d& a : agreeing) widest = std::max(widest, a.cross(agreeing[0]).norm());
  for (const Eigen::Vector3d& a : agreeing)
    widest = std::max(widest, a.cross(agreeing.back()).norm());
  if (widest < std::sin(options.min_angle_rad)) return std::nullopt;
  return point;
}

}  // namespace redrive
