// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/reduced_covariance.h"

#include <algorithm>
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

constexpr std::size_t kBlocksOfRange = 64, kColumnsOfRange = 6;
constexpr double kMinFraction = 0.2;  // lower bound: less curvature comes from gross outliers

/// A row of the Jacobian. An eliminated block that it depends on has the derivatives `own`.
struct Row {
  int first = 0, n = 0;  ///< range in CRSMatrix::values: derivatives by the rig's parameters
  Eigen::Vector3d own = Eigen::Vector3d::Zero();
  double residual = 0;
  double curvature = 1;  ///< fraction of the normal matrix (curvature_fractions)
  int group = -1;
};

/// An eliminated block: its own part of the normal matrix, its part with the rig, and its
/// gradients.
struct Eliminated {
  std::vector<Row> rows;
  double curvature = 1;
  std::vector<int> index;     ///< ascending: the parameters of the rig that its rows depend on
  Eigen::Matrix3Xd with_rig;  ///< [3, index]
  Eigen::Matrix3Xd weighted;  ///< times the inverse of its own part
  Eigen::VectorXd gradient;   ///< [index] sum over all rows, with the block eliminated
  std::map<int, Eigen::VectorXd> of_groups;  ///< the same sum over the rows of each group
};

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

/// Sorts the rows of the Jacobian by eliminated block; rows without a block come last. Its first
/// `n` columns are the rig's.
std::vector<Eliminated> rows_of_blocks(const ceres::CRSMatrix& jacobian, int n, std::size_t blocks,
                                       const std::vector<double>& residuals,
                                       const std::vector<double>& fractions,
                                       const std::vector<int>& group_of_row) {
  std::vector<Eliminated> all(blocks + 1);
  for (int r = 0; r < jacobian.num_rows; ++r) {
    const int begin = jacobian.rows[r], end = jacobian.rows[r + 1];
    Row row{begin, 0, Eigen::Vector3d::Zero(), residuals[r], 1, -1};
    while (begin + row.n < end && jacobian.cols[begin + row.n] < n) ++row.n;
    int block = -1;
    for (int i = begin + row.n; i < end; ++i) {
      const int column = jacobian.cols[i] - n;
      REDRIVE_CHECK(block < 0 || block == column / 3);
      block = column / 3;
      row.own[column % 3] = jacobian.values[i];
    }
    if (block >= 0) {
      row.curvature = fractions[r];
      row.group = group_of_row[r];
    }
    all[block < 0 ? blocks : static_cast<std::size_t>(block)].rows.push_back(row);
  }
  return all;
}

/// Eliminates a block from its rows.
void eliminate(const ceres::CRSMatrix& jacobian, Eliminated* e) {
  for (const Row& row : e->rows)
    for (int i = row.first; i < row.first + row.n; ++i)
      if (jacobian.values[i] != 0) e->index.push_back(jacobian.cols[i]);
  std::ranges::sort(e->index);
  e->index.erase(std::ranges::unique(e->index).begin(), e->index.end());
  const auto size = static_cast<Eigen::Index>(e->index.size());
  const auto place = [&](int column) {
    return std::ranges::lower_bound(e->index, column) - e->index.begin();
  };
  e->with_rig = Eigen::Matrix3Xd::Zero(3, size);
  e->gradient = Eigen::VectorXd::Zero(size);
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  std::map<int, Eigen::Vector3d> own_of_groups;
  for (const Row& row : e->rows) {
    e->curvature = row.curvature;
    own += row.own * row.own.transpose();
    own_of_groups.try_emplace(row.group, Eigen::Vector3d::Zero()).first->second +=
        row.residual * row.own;
    Eigen::VectorXd& gradient =
        e->of_groups.try_emplace(row.group, Eigen::VectorXd::Zero(size)).first->second;
    for (int i = row.first; i < row.first + row.n; ++i) {
      if (jacobian.values[i] == 0) continue;
      const Eigen::Index at = place(jacobian.cols[i]);
      e->with_rig.col(at) += jacobian.values[i] * row.own;
      gradient[at] += jacobian.values[i] * row.residual;
    }
  }
  e->weighted = inverse_of_block(own) * e->with_rig;
  for (auto& [group, gradient] : e->of_groups) {
    gradient -= e->weighted.transpose() * own_of_groups.at(group);
    e->gradient += gradient;
  }
}

/// Adds what the rows of a block know about columns [begin, end) of the rig's parameters, less what
/// the block takes of it.
void add_columns(const ceres::CRSMatrix& jacobian, const Eliminated& e, bool is_free, int begin,
                 int end, RigSums* sums) {
  const auto first = std::ranges::lower_bound(e.index, begin) - e.index.begin();
  if (is_free && (first == std::ssize(e.index) || e.index[first] >= end)) return;
  for (const Row& row : e.rows)
    for (int a = row.first; a < row.first + row.n; ++a) {
      const int column = jacobian.cols[a];
      if (column < begin || column >= end || jacobian.values[a] == 0) continue;
      for (int b = row.first; b < row.first + row.n; ++b) {
        const double product = jacobian.values[a] * jacobian.values[b];
        sums->normal(jacobian.cols[b], column) += product;
        sums->curved(jacobian.cols[b], column) += row.curvature * product;
        if (!is_free) sums->spread(jacobian.cols[b], column) += product;
      }
    }
  if (!is_free) return;
  for (Eigen::Index a = first; a < std::ssize(e.index) && e.index[a] < end; ++a)
    for (Eigen::Index b = 0; b < std::ssize(e.index); ++b) {
      const double taken = e.weighted.col(a).dot(e.with_rig.col(b));
      sums->normal(e.index[b], e.index[a]) -= taken;
      sums->curved(e.index[b], e.index[a]) -= e.curvature * taken;
      sums->spread(e.index[b], e.index[a]) += e.gradient[b] * e.gradient[a];
    }
}

}  // namespace

ReducedCovariance reduced_covariance(ceres::Problem& problem, const std::vector<double*>& rig,
                                     const std::vector<double*>& free, ThreadPool& pool,
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
  std::vector<Eliminated> blocks =
      rows_of_blocks(jacobian, n, free.size(), residuals, fractions, group_of_row);
  pool.run_ranges(free.size(), kBlocksOfRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) eliminate(jacobian, &blocks[i]);
  });
  pool.run_ranges(static_cast<std::size_t>(n), kColumnsOfRange,
                  [&](std::size_t begin, std::size_t end) {
                    for (std::size_t i = 0; i < blocks.size(); ++i)
                      add_columns(jacobian, blocks[i], i < free.size(), static_cast<int>(begin),
                                  static_cast<int>(end), &sums);
                  });
  GroupGradients of_groups(n);
  for (const Eliminated& e : blocks)
    for (const auto& [group, gradient] : e.of_groups) of_groups.add(group, e.index, gradient);
  sums.spread += of_groups.squares();
  ReducedCovariance covariance;
  covariance.matrix = inverse_of(sums.normal);
  const Eigen::MatrixXd by_curvature = inverse_of(sums.curved);
  covariance.robust = by_curvature * sums.spread * by_curvature;
  covariance.variance = covariance.robust.diagonal().cwiseMax(covariance.matrix.diagonal());
  return covariance;
}

}  // namespace redrive
