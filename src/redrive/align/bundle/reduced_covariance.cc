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

/// The gradient of one row, which belongs to an eliminated block.
struct RowTerms {
  int group = -1;
  std::vector<std::pair<int, double>> gradient;  ///< key: parameter of the rig
  Eigen::Vector3d own;  ///< derivatives with respect to the block's own parameters
};

/// An eliminated block: its own part of the normal matrix, its part with the rig, and its rows.
struct Eliminated {
  double curvature = 1;  ///< as a fraction of the normal matrix: curvature_fractions
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  std::map<int, Eigen::Vector3d> with_rig;  ///< key: parameter of the rig
  std::vector<RowTerms> rows;
};

/// Returns, for each group, the sum of the gradients of a block's rows with respect to the rig's
/// parameters, in the order of with_rig, with the block eliminated. `inverse`: inverse of `own`.
std::map<int, Eigen::VectorXd> gradients_by_group(const Eliminated& e,
                                                  const Eigen::Matrix3d& inverse) {
  std::map<int, int> position;
  for (const auto& [a, with_a] : e.with_rig) position.emplace(a, static_cast<int>(position.size()));
  std::map<int, Eigen::VectorXd> gradients;
  std::map<int, Eigen::Vector3d> own;
  for (const RowTerms& row : e.rows) {
    Eigen::VectorXd& gradient =
        gradients.try_emplace(row.group, Eigen::VectorXd::Zero(position.size())).first->second;
    for (const auto& [a, value] : row.gradient) gradient[position.at(a)] += value;
    own.try_emplace(row.group, Eigen::Vector3d::Zero()).first->second += row.own;
  }
  for (auto& [group, gradient] : gradients) {
    const Eigen::Vector3d weighted = inverse * own.at(group);
    int i = 0;
    for (const auto& [a, with_a] : e.with_rig) gradient[i++] -= with_a.dot(weighted);
  }
  return gradients;
}

/// Sums of gradients of all blocks, one for each group.
class GroupGradients {
 public:
  explicit GroupGradients(int n) : n_(n) {}
  void add(int group, const std::vector<int>& index, const Eigen::VectorXd& gradient) {
    if (group < 0) return;
    Eigen::VectorXd& sum = sums_.try_emplace(group, Eigen::VectorXd::Zero(n_)).first->second;
    for (std::size_t i = 0; i < index.size(); ++i)
      sum[index[i]] += gradient[static_cast<Eigen::Index>(i)];
  }
  /// Sum of g g^T over the groups.
  Eigen::MatrixXd squares() const {
    Eigen::MatrixXd all(n_, sums_.size());
    Eigen::Index column = 0;
    for (const auto& [group, sum] : sums_) all.col(column++) = sum;
    return all * all.transpose();
  }

 private:
  int n_;
  std::map<int, Eigen::VectorXd> sums_;
};

/// One per row; -1: none.
std::vector<int> groups_of_rows(const ceres::Problem& problem,
                                const std::vector<ceres::ResidualBlockId>& blocks,
                                const ResidualGroups& groups) {
  std::vector<int> of_row;
  for (const ceres::ResidualBlockId id : blocks) {
    const auto found = groups.find(id);
    of_row.insert(of_row.end(), problem.GetCostFunctionForResidualBlock(id)->num_residuals(),
                  found == groups.end() ? -1 : found->second);
  }
  return of_row;
}

/// One per row: the curvature of the robust loss as a fraction of its weight, averaged over all
/// residuals with that loss, since the curvature of a single outlier is negative. 1 without a loss;
/// 3/4 for normal errors and a Cauchy loss of 2 sigma.
std::vector<double> curvature_fractions(const ceres::Problem& problem,
                                        const std::vector<ceres::ResidualBlockId>& blocks,
                                        const std::vector<double>& residuals) {
  struct Sums {
    double weight = 0, curvature = 0;
  };
  std::map<const ceres::LossFunction*, Sums> of_loss;
  std::vector<const ceres::LossFunction*> losses;  // one per row
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

/// Returns the inverse after scaling columns to a unit diagonal, since they are metres and radians.
/// Damps it by 1e-12 where it is singular.
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

/// Returns the inverse of what an eliminated block knows about itself.
Eigen::Matrix3d inverse_of_block(const Eigen::Matrix3d& own) {
  // Directions without information, below 1e-12 of the largest eigenvalue, remove nothing.
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(own);
  Eigen::Matrix3d inverse = Eigen::Matrix3d::Zero();
  for (int k = 0; k < 3; ++k)
    if (solver.eigenvalues()[k] > 1e-12 * solver.eigenvalues()[2])
      inverse += solver.eigenvectors().col(k) * solver.eigenvectors().col(k).transpose() /
                 solver.eigenvalues()[k];
  return inverse;
}

/// Sums over the parameters of the rig.
struct RigSums {
  Eigen::MatrixXd normal;  ///< normal matrix
  Eigen::MatrixXd curved;  ///< the same, weighted by the curvature of the losses
  Eigen::MatrixXd spread;  ///< squares of gradients
};

/// Adds the rows of the Jacobian, whose first `n` columns are the rig's. Rows with a block that is
/// eliminated are kept for it.
void add_rows(const ceres::CRSMatrix& jacobian, int n, const std::vector<double>& residuals,
              const std::vector<double>& fractions, const std::vector<int>& group_of_row,
              RigSums* sums, std::vector<Eliminated>* all_eliminated) {
  std::vector<Eliminated>& eliminated = *all_eliminated;
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
    RowTerms terms{group_of_row[row], {}, own * residuals[row]};
    for (int a = begin; a < split; ++a) {
      if (jacobian.values[a] == 0) continue;
      for (int b = begin; b < split; ++b) {
        const double product = jacobian.values[a] * jacobian.values[b];
        sums->normal(jacobian.cols[b], jacobian.cols[a]) += product;
        sums->curved(jacobian.cols[b], jacobian.cols[a]) +=
            (block < 0 ? 1 : fractions[row]) * product;
        if (block < 0) sums->spread(jacobian.cols[b], jacobian.cols[a]) += product;
      }
      if (block < 0) continue;
      eliminated[block]
          .with_rig.try_emplace(jacobian.cols[a], Eigen::Vector3d::Zero())
          .first->second += jacobian.values[a] * own;
      terms.gradient.emplace_back(jacobian.cols[a], jacobian.values[a] * residuals[row]);
    }
    if (block < 0) continue;
    eliminated[block].curvature = fractions[row];
    eliminated[block].own += own * own.transpose();
    eliminated[block].rows.push_back(std::move(terms));
  }
}

/// Removes what an eliminated block takes of the rig's information.
void eliminate(const Eliminated& e, RigSums* sums, GroupGradients* of_groups) {
  const Eigen::Matrix3d inverse = inverse_of_block(e.own);
  for (const auto& [a, with_a] : e.with_rig) {
    const Eigen::Vector3d weighted = inverse * with_a;
    for (const auto& [b, with_b] : e.with_rig) {
      sums->normal(b, a) -= weighted.dot(with_b);
      sums->curved(b, a) -= e.curvature * weighted.dot(with_b);
    }
  }
  std::vector<int> index;
  for (const auto& [a, with_a] : e.with_rig) index.push_back(a);
  Eigen::VectorXd of_block = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(index.size()));
  for (const auto& [group, gradient] : gradients_by_group(e, inverse)) {
    of_block += gradient;
    of_groups->add(group, index, gradient);
  }
  for (std::size_t a = 0; a < index.size(); ++a)
    for (std::size_t b = 0; b < index.size(); ++b)
      sums->spread(index[b], index[a]) +=
          of_block[static_cast<Eigen::Index>(b)] * of_block[static_cast<Eigen::Index>(a)];
}

}  // namespace

ReducedCovariance reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                     const std::vector<double*>& free,
                                     const ResidualGroups& groups) {
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
  const std::vector<int> group_of_row = groups_of_rows(problem, options.residual_blocks, groups);

  const Eigen::MatrixXd zero = Eigen::MatrixXd::Zero(n, n);
  RigSums sums{zero, zero, zero};
  std::vector<Eliminated> eliminated(free.size());
  add_rows(jacobian, n, residuals, fractions, group_of_row, &sums, &eliminated);
  GroupGradients of_groups(n);
  for (const Eliminated& e : eliminated) eliminate(e, &sums, &of_groups);
  sums.spread += of_groups.squares();
  ReducedCovariance covariance;
  covariance.matrix = inverse_of(sums.normal);
  const Eigen::MatrixXd by_curvature = inverse_of(sums.curved);
  covariance.robust = by_curvature * sums.spread * by_curvature;
  covariance.variance = covariance.robust.diagonal().cwiseMax(covariance.matrix.diagonal());
  return covariance;
}

}  // namespace redrive
