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

constexpr double kMinFraction = 0.2;  // lower bound: less curvature comes from gross outliers

/// Terms of an eliminated block with one parameter of the rig.
struct RigTerms {
  Eigen::Vector3d with_own = Eigen::Vector3d::Zero();  ///< columns of the normal matrix
  double gradient = 0;
};

/// One eliminated block: its own blocks of the normal matrix and gradient, and those with the rig.
struct Eliminated {
  double curvature = 1;  ///< as a fraction of the normal matrix: curvature_fractions
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  std::map<int, RigTerms> with_rig;  ///< by parameter of the rig
};

/// By row: the curvature of the robust loss as a fraction of its weight, averaged over all
/// residuals of that loss, since the curvature of a single outlier is negative. 1 without a loss;
/// 3/4 for normal errors and a Cauchy loss of 2 sigma.
std::vector<double> curvature_fractions(const ceres::Problem& problem,
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
  std::vector<double> fractions;
  for (const ceres::LossFunction* loss : losses)
    fractions.push_back(
        loss ? std::max(kMinFraction, of_loss[loss].curvature / of_loss[loss].weight) : 1);
  return fractions;
}

/// Inverse after scaling columns to a unit diagonal, since they are metres and radians. Damped by
/// 1e-12 where it is singular.
Eigen::MatrixXd inverse_of(const Eigen::MatrixXd& normal) {
  const Eigen::Index n = normal.rows();
  const Eigen::VectorXd scale = normal.diagonal().cwiseMax(1e-12).cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * normal * scale.asDiagonal();
  Eigen::LDLT<Eigen::MatrixXd> solver(scaled);
  if (!(solver.vectorD().minCoeff() > 1e-14)) {
    Eigen::MatrixXd damped = scaled;
    damped.diagonal().array() += 1e-12;
    solver.compute(damped);
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
  const std::vector<double> fractions =
      curvature_fractions(problem, options.residual_blocks, residuals);
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
        curved(jacobian.cols[b], jacobian.cols[a]) += (block < 0 ? 1 : fractions[row]) * product;
        if (block < 0) spread(jacobian.cols[b], jacobian.cols[a]) += product;
      }
      if (block < 0) continue;
      RigTerms& terms = eliminated[block].with_rig[jacobian.cols[a]];
      terms.with_own += jacobian.values[a] * own;
      terms.gradient += jacobian.values[a] * residuals[row];
    }
    if (block < 0) continue;
    eliminated[block].curvature = fractions[row];
    eliminated[block].own += own * own.transpose();
    eliminated[block].gradient += own * residuals[row];
  }
  for (const Eliminated& e : eliminated) {
    // Directions without information, below 1e-12 of the largest eigenvalue, remove nothing.
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
  covariance.robust = by_curvature * spread * by_curvature;
  covariance.variance = covariance.robust.diagonal().cwiseMax(covariance.matrix.diagonal());
  return covariance;
}

}  // namespace redrive
