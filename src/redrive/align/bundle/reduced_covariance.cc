// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/reduced_covariance.h"

#include <cmath>
#include <map>

#include <ceres/cost_function.h>
#include <ceres/crs_matrix.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <Eigen/Dense>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr double kLeastShare =
    0.2;  // less curvature would be that of residuals which nothing explains

/// What residuals say of one parameter of the rig.
struct OfRig {
  Eigen::Vector3d with_own = Eigen::Vector3d::Zero();  ///< columns of the normal matrix
  double gradient = 0;
};

/// One eliminated block: its own part of the normal matrix and gradient, and those with the rig.
struct Eliminated {
  double curvature = 1;  ///< share of the normal matrix: curvature_shares
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  std::map<int, OfRig> with_rig;  ///< by parameter of the rig
};

/// By row: how much of a residual's weight the curvature of its robust loss is, in the mean over
/// all residuals of that loss (a single one that is far off curves the other way); 1 without one.
/// Of normal errors and a Cauchy loss of 2 sigma three quarters.
std::vector<double> curvature_shares(const ceres::Problem& problem,
                                     const std::vector<ceres::ResidualBlockId>& blocks,
                                     const std::vector<double>& residuals) {
  struct Sums {
    double weight = 0, curvature = 0;
  };
  std::map<const ceres::LossFunction*, Sums> of_loss;
  std::vector<const ceres::LossFunction*> losses;  // by row
  for (const ceres::ResidualBlockId id : blocks) {
    const ceres::LossFunction* const loss = problem.GetLossFunctionForResidualBlock(id);
    const int rows = problem.GetCostFunctionForResidualBlock(id)->num_residuals();
    double squares = 0, rho[3];
    for (int k = 0; k < rows; ++k)
      squares += std::pow(residuals[losses.size() + static_cast<std::size_t>(k)], 2);
    losses.insert(losses.end(), rows, loss);
    if (!loss) continue;
    loss->Evaluate(squares, rho);
    of_loss[loss].weight += rho[1];
    of_loss[loss].curvature += rho[1] + 2 * rho[2] * squares / rows;
  }
  std::vector<double> shares;
  for (const ceres::LossFunction* loss : losses)
    shares.push_back(loss ? std::max(kLeastShare, of_loss[loss].curvature / of_loss[loss].weight)
                          : 1);
  return shares;
}

/// Columns are metres and radians: scaled to one another before. Where nothing holds a direction,
/// next to nothing does.
Eigen::MatrixXd inverse_of(const Eigen::MatrixXd& normal) {
  const Eigen::Index n = normal.rows();
  const Eigen::VectorXd scale = normal.diagonal().cwiseMax(1e-12).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * normal * scale.asDiagonal();
  Eigen::LDLT<Eigen::MatrixXd> solver(scaled);
  if (!(solver.vectorD().minCoeff() > 1e-14)) {
    Eigen::MatrixXd held = scaled;
    held.diagonal().array() += 1e-12;
    solver.compute(held);
  }
  return scale.asDiagonal() * solver.solve(Eigen::MatrixXd::Identity(n, n)) * scale.asDiagonal();
}

}  // namespace

ReducedCovariance reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                     const std::vector<double*>& free) {
  ceres::Problem::EvaluateOptions options;
  options.parameter_blocks = rig;
  options.parameter_blocks.insert(options.parameter_blocks.end(), free.begin(), free.end());
  int n = 0;
  for (double* block : rig) n += problem.ParameterBlockSize(block);
  ceres::CRSMatrix jacobian;
  std::vector<double> residuals;
  problem.GetResidualBlocks(&options.residual_blocks);
  options.apply_loss_function = false;
  REDRIVE_CHECK(problem.Evaluate(options, nullptr, &residuals, nullptr, nullptr));
  const std::vector<double> shares = curvature_shares(problem, options.residual_blocks, residuals);
  options.apply_loss_function = true;
  REDRIVE_CHECK(problem.Evaluate(options, nullptr, &residuals, nullptr, &jacobian));

  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(n, n), curved = normal, spread = normal;
  std::vector<Eliminated> eliminated(free.size());
  for (int row = 0; row < jacobian.num_rows; ++row) {
    const int begin = jacobian.rows[row], end = jacobian.rows[row + 1];
    int split = begin, block = -1;
    while (split < end && jacobian.cols[split] < n) ++split;
    Eigen::Vector3d own = Eigen::Vector3d::Zero();
    for (int i = split; i < end; ++i) {
      const int column = jacobian.cols[i] - n;
      REDRIVE_CHECK(block < 0 || block == column / 3);
      block = column / 3;
      own[column % 3] = jacobian.values[i];
    }
    for (int a = begin; a < split; ++a) {
      if (jacobian.values[a] == 0) continue;
      for (int b = begin; b < split; ++b) {
        const double product = jacobian.values[a] * jacobian.values[b];
        normal(jacobian.cols[b], jacobian.cols[a]) += product;
        curved(jacobian.cols[b], jacobian.cols[a]) += (block < 0 ? 1 : shares[row]) * product;
        if (block < 0) spread(jacobian.cols[b], jacobian.cols[a]) += product;
      }
      if (block < 0) continue;
      OfRig& of_rig = eliminated[block].with_rig[jacobian.cols[a]];
      of_rig.with_own += jacobian.values[a] * own;
      of_rig.gradient += jacobian.values[a] * residuals[row];
    }
    if (block < 0) continue;
    eliminated[block].curvature = shares[row];
    eliminated[block].own += own * own.transpose();
    eliminated[block].gradient += own * residuals[row];
  }
  for (const Eliminated& e : eliminated) {
    // 1e-12 of the largest: a direction that no residual sees takes nothing away.
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(e.own);
    Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();
    for (int k = 0; k < 3; ++k)
      if (solver.eigenvalues()[k] > 1e-12 * solver.eigenvalues()[2])
        inverse += solver.eigenvectors().col(k) * solver.eigenvectors().col(k).transpose() /
                   solver.eigenvalues()[k];
    for (const auto& [a, of_a] : e.with_rig) {
      const Eigen::Vector3d weighted = inverse * of_a.with_own;
      const double gradient = of_a.gradient - weighted.dot(e.gradient);
      for (const auto& [b, of_b] : e.with_rig) {
        normal(b, a) -= weighted.dot(of_b.with_own);
        curved(b, a) -= e.curvature * weighted.dot(of_b.with_own);
        spread(b, a) += gradient * (of_b.gradient - of_b.with_own.dot(inverse * e.gradient));
      }
    }
  }
  ReducedCovariance covariance;
  covariance.matrix = inverse_of(normal);
  const Eigen::MatrixXd by_curvature = inverse_of(curved);
  covariance.variance =
      (by_curvature * spread * by_curvature).diagonal().cwiseMax(covariance.matrix.diagonal());
  return covariance;
}

}  // namespace redrive
