// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/join_trajectories.h"

#include <cmath>

#include <Eigen/Dense>

#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"
#include "redrive/recording/core/register_trajectories.h"

namespace redrive {
namespace {

constexpr int kOverlapDivisor = 5;  // an overlap is a fifth of a window
// Neighbours disagree smoothly over an overlap of a few seconds, which counts as this many
// independent frames.
constexpr double kIndependent = 3;
constexpr double kMinResidual_m = 2e-4, kMinResidual_rad = 1e-5;

/// Converts a motion about `from` to a motion about a point at `offset` from there.
Matrix6d about(const Eigen::Vector3d& offset) {
  Matrix6d s = Matrix6d::Identity();
  s.topRightCorner<3, 3>() = -skew(offset);
  return s;
}

/// [6, 6 n]: the least-squares rigid motion, about `middle`, of the poses `begin` to `end` - 1.
Eigen::MatrixXd mean_motion(const std::vector<Rigid3d>& poses, int begin, int end,
                            const Eigen::Vector3d& middle) {
  Matrix6d normal = Matrix6d::Zero();
  Eigen::MatrixXd sums = Eigen::MatrixXd::Zero(6, 6 * static_cast<Eigen::Index>(poses.size()));
  for (int f = begin; f < end; ++f) {
    const Matrix6d g = by_motion(poses[f], middle),
                   weighted = g.transpose() * motion_weights().asDiagonal();
    normal += weighted * g;
    sums.middleCols<6>(6 * f) = weighted;
  }
  return normal.ldlt().solve(sums);
}

Rigid3d moved(const Vector6d& motion, const Eigen::Vector3d& middle, const Rigid3d& pose) {
  Rigid3d result;
  const Eigen::Matrix3d rotation = so3_exp(motion.tail<3>());
  result.linear() = rotation * pose.linear();
  result.translation() = middle + rotation * (pose.translation() - middle) + motion.head<3>();
  return result;
}

/// A symmetric positive definite matrix of 6 x 6 blocks, of which only neighbours are coupled.
struct BlockChain {
  std::vector<Matrix6d> diagonal, upper;  ///< upper[k]: block (k, k + 1)

  /// Solves for right-hand sides of n columns, and computes the inverse's diagonal blocks.
  template <int n>
  std::vector<Eigen::Matrix<double, 6, n>> solve(std::vector<Eigen::Matrix<double, 6, n>> b,
                                                 std::vector<Matrix6d>* inverse) const {
    const std::size_t blocks = diagonal.size();
    std::vector<Eigen::LDLT<Matrix6d>> reduced;
    for (std::size_t k = 0; k < blocks; ++k) {
      Matrix6d d = diagonal[k];
      if (k > 0) {
        d -= upper[k - 1].transpose() * reduced[k - 1].solve(upper[k - 1]);
        b[k] -= upper[k - 1].transpose() * reduced[k - 1].solve(b[k - 1]);
      }
      reduced.emplace_back(d);
    }
    inverse->resize(blocks);
    for (std::size_t k = blocks; k-- > 0;) {
      if (k + 1 < blocks) b[k] -= upper[k] * b[k + 1];
      b[k] = reduced[k].solve(b[k]).eval();
      (*inverse)[k] = reduced[k].solve(Matrix6d::Identity());
      if (k + 1 < blocks) {
        const Matrix6d passed = reduced[k].solve(upper[k]);
        (*inverse)[k] += passed * (*inverse)[k + 1] * passed.transpose();
      }
    }
    return b;
  }
};

std::vector<Rigid3d> in_world(const std::vector<FramePose>& poses,
                              const Rigid3d& world_from_global) {
  std::vector<Rigid3d> result;
  for (const FramePose& pose : poses) result.push_back(world_from_global * pose.global_from_body);
  return result;
}

/// Relative motion of two neighbouring windows, measured on the frames that they share.
struct RelativeMotion {
  Eigen::Vector3d middle;  ///< middle of the shared frames in the world, in metres
  Vector6d difference;   ///< motion of the later window minus the earlier window's, about `middle`
  Matrix6d information;  ///< information matrix of `difference`
};

RelativeMotion measure_relative_motion(const WindowTrajectory& a, const WindowTrajectory& b,
                                       const Rigid3d& world_from_global) {
  const int shared = a.frames.end - b.frames.begin;
  REDRIVE_CHECK_OP(shared, >, 0);
  const std::vector<FramePose> of_a(a.poses.end() - shared, a.poses.end()),
      of_b(b.poses.begin(), b.poses.begin() + shared);
  const TrajectoryRegistration found = register_trajectories(of_a, of_b, "");
  const Rigid3d a_from_b =
      world_from_global * found.run_from_ground_truth * world_from_global.inverse(Eigen::Isometry);
  RelativeMotion between;
  between.middle.setZero();
  for (const Rigid3d& pose : in_world(of_b, world_from_global))
    between.middle += pose.translation() / shared;
  between.difference << a_from_b * between.middle - between.middle, so3_log(a_from_b.linear());
  const Matrix6d of_end = about(between.middle - a.middle),
                 of_start = about(between.middle - b.middle);
  Matrix6d covariance =
      of_end * a.end * of_end.transpose() + of_start * b.start * of_start.transpose();
  const double residual_m = std::max(found.residual_m / std::sqrt(kIndependent), kMinResidual_m),
               residual_rad =
                   std::max(found.residual_deg * kRadiansPerDegree / std::sqrt(kIndependent),
                            kMinResidual_rad);
  covariance.diagonal().head<3>().array() += residual_m * residual_m;
  covariance.diagonal().tail<3>().array() += residual_rad * residual_rad;
  between.information = covariance.inverse();
  return between;
}

}  // namespace

std::vector<FrameWindow> cut_windows(int frames, int most) {
  if (frames <= most) return {{0, frames}};
  REDRIVE_CHECK_OP(most, >=, 2 * kOverlapDivisor);
  const int overlap = most / kOverlapDivisor,
            count = (frames - overlap + most - overlap - 1) / (most - overlap);
  std::vector<FrameWindow> windows;
  const auto border = [&](int k) {  // evenly spaced beginnings of the part that each window adds
    return static_cast<int>(static_cast<std::int64_t>(frames - overlap) * k / count);
  };
  for (int k = 0; k < count; ++k) windows.push_back({border(k), border(k + 1) + overlap});
  return windows;
}

Matrix6d larger_covariance(const Matrix6d& a, const Matrix6d& b) {
  if (a.isZero(0)) return a;
  // B v = l A v, V^T A V = 1: in these axes A is 1 and B is l.
  const Eigen::GeneralizedSelfAdjointEigenSolver<Matrix6d> solver(b, a);
  const Matrix6d axes = a * solver.eigenvectors();
  return axes * solver.eigenvalues().cwiseMax(1).asDiagonal() * axes.transpose();
}

WindowTrajectory window_trajectory(const FrameWindow& frames, std::vector<FramePose> poses,
                                   const Eigen::MatrixXd& covariance, const Eigen::MatrixXd& robust,
                                   int overlap_before, int overlap_after,
                                   const Rigid3d& world_from_global) {
  const int n = frames.size();
  REDRIVE_CHECK_OP(poses.size(), ==, static_cast<std::size_t>(n));
  REDRIVE_CHECK_OP(covariance.rows(), >=, 6 * n);
  REDRIVE_CHECK_OP(robust.rows(), >=, 6 * n);
  WindowTrajectory window{frames, std::move(poses)};
  const std::vector<Rigid3d> local = in_world(window.poses, world_from_global);
  for (const Rigid3d& pose : local) window.middle += pose.translation() / n;
  const auto of_motion = [&](const Eigen::MatrixXd& motion) -> Matrix6d {
    const auto by = [&](const Eigen::MatrixXd& c) -> Matrix6d {
      return motion * c.topLeftCorner(6 * n, 6 * n) * motion.transpose();
    };
    return larger_covariance(by(covariance), by(robust));
  };
  const Eigen::MatrixXd whole = mean_motion(local, 0, n, window.middle);
  window.whole = of_motion(whole);
  const auto relative = [&](int begin, int end) -> Matrix6d {
    if (begin == end) return Matrix6d::Zero();
    return of_motion(mean_motion(local, begin, end, window.middle) - whole);
  };
  window.start = relative(0, overlap_before);
  window.end = relative(n - overlap_after, n);
  return window;
}

JoinedTrajectory join_trajectories(const std::vector<WindowTrajectory>& windows,
                                   const Rigid3d& world_from_global) {
  const std::size_t n = windows.size();
  // Minimises sum m_k^T whole_k^-1 m_k, and the squares of relative motions, over the motions m_k
  // of windows.
  BlockChain chain;
  std::vector<Vector6d> b(n, Vector6d::Zero());
  for (const WindowTrajectory& window : windows) chain.diagonal.push_back(window.whole.inverse());
  for (std::size_t k = 0; k + 1 < n; ++k) {
    const RelativeMotion between =
        measure_relative_motion(windows[k], windows[k + 1], world_from_global);
    const Matrix6d of_a = about(between.middle - windows[k].middle),
                   of_b = about(between.middle - windows[k + 1].middle);
    chain.diagonal[k] += of_a.transpose() * between.information * of_a;
    chain.diagonal[k + 1] += of_b.transpose() * between.information * of_b;
    chain.upper.push_back(-of_a.transpose() * between.information * of_b);
    b[k] -= of_a.transpose() * between.information * between.difference;
    b[k + 1] += of_b.transpose() * between.information * between.difference;
  }
  std::vector<Matrix6d> covariance;
  const std::vector<Vector6d> motions = chain.solve<1>(b, &covariance);

  std::vector<std::vector<Rigid3d>> poses;
  std::vector<Matrix6d> effect, weighted;  // effect of a rigid motion of the whole, one per window
  for (const WindowTrajectory& window : windows) {
    poses.push_back(in_world(window.poses, world_from_global));
    effect.push_back(about(window.middle - windows.front().middle));
    Matrix6d w = Matrix6d::Zero();
    for (const Rigid3d& pose : poses.back()) {
      const Matrix6d g = by_motion(pose, window.middle);
      w += g.transpose() * motion_weights().asDiagonal() * g;
    }
    weighted.push_back(w * effect.back());
  }
  std::vector<Matrix6d> unused;
  remove_common_motion(effect, weighted, chain.solve<6>(weighted, &unused), &covariance);

  JoinedTrajectory joined;
  const Rigid3d global_from_world = world_from_global.inverse(Eigen::Isometry);
  double squares_m = 0, squares_rad = 0;
  int compared = 0;
  for (std::size_t k = 0; k < n; ++k) {
    const WindowTrajectory& window = windows[k];
    const int shared_before = k > 0 ? windows[k - 1].frames.end - window.frames.begin : 0;
    for (int i = 0; i < window.frames.size(); ++i) {
      const Rigid3d pose = moved(motions[k], window.middle, poses[k][i]);
      const Matrix6d g = by_motion(poses[k][i], window.middle);
      const Vector6d variance = (g * covariance[k] * g.transpose()).diagonal().cwiseMax(0);
      if (i >= shared_before) {
        FramePose frame = window.poses[i];
        frame.global_from_body = global_from_world * pose;
        joined.frames.push_back(frame);
        joined.variance.push_back(variance);
        continue;
      }
      const std::size_t at = static_cast<std::size_t>(window.frames.begin + i);
      FramePose& frame = joined.frames[at];
      const Rigid3d before = world_from_global * frame.global_from_body;
      squares_m += (pose.translation() - before.translation()).squaredNorm();
      squares_rad += so3_log(before.linear().transpose() * pose.linear()).squaredNorm();
      ++compared;
      const double u = (i + 1.0) / (shared_before + 1);
      frame.global_from_body = global_from_world * interpolate(before, pose, u);
      joined.variance[at] = joined.variance[at].cwiseMax(variance);
    }
  }
  const double repeated =
      1 + static_cast<double>(compared) / static_cast<double>(joined.frames.size());
  for (Vector6d& variance : joined.variance) variance *= repeated;
  if (compared > 0) {
    joined.seam_m = std::sqrt(squares_m / compared);
    joined.seam_rad = std::sqrt(squares_rad / compared);
  }
  return joined;
}

}  // namespace redrive
