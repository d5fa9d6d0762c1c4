// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/reduced_covariance.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <Eigen/Dense>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr std::size_t kBlocksOfRange = 64, kColumnsOfRange = 6;
constexpr double kMinFraction = 0.2;  // lower bound: less curvature comes from gross outliers

using Linear = LeastSquares::Linear;

/// A row of the Jacobian. A landmark that it depends on has the derivatives `own`.
struct Row {
  int first = 0, n = 0;  ///< range in Eliminated::columns and values
  Eigen::Vector3d own = Eigen::Vector3d::Zero();
  double residual = 0;
  double curvature = 1;  ///< fraction of the normal matrix (curvature_fractions)
  int group = -1;
};

/// An eliminated landmark: its own part of the normal matrix, its part with the rig, and its
/// gradients.
struct Eliminated {
  std::vector<Row> rows;
  std::vector<int> columns;    ///< numbers of the rig, row after row
  std::vector<double> values;  ///< derivatives by them, none 0
  double curvature = 1;
  std::vector<int> index;     ///< ascending: the parameters of the rig that its rows depend on
  Eigen::Matrix3Xd with_rig;  ///< [3, index]
  Eigen::Matrix3Xd weighted;  ///< times the inverse of its own part
  Eigen::VectorXd gradient;   ///< [index] sum over all rows, with the landmark eliminated
  std::map<int, Eigen::VectorXd> of_groups;  ///< the same sum over the rows of each group
};

/// Sums of gradients of all landmarks, one for each group.
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

/// One per term: the curvature of the robust loss as a fraction of its weight, averaged over all
/// residuals with that loss, since the curvature of a single outlier is negative. 1 without a loss;
/// 3/4 for normal errors and a Cauchy loss of 2 sigma.
std::vector<double> curvature_fractions(const LeastSquares& problem) {
  struct Sums {
    double weight = 0, curvature = 0;
  };
  std::map<const ceres::LossFunction*, Sums> of_loss;
  for (std::size_t t = 0; t < problem.terms(); ++t) {
    const Linear linear = problem.linear(t);
    const ceres::LossFunction* const loss = linear.term->loss;
    if (!loss) continue;
    double rho[3];
    loss->Evaluate(problem.square(t), rho);
    of_loss[loss].weight += rho[1];
    of_loss[loss].curvature += rho[1] + 2 * rho[2] * problem.square(t) / linear.rows;
  }
  std::vector<double> fractions(problem.terms(), 1);
  for (std::size_t t = 0; t < problem.terms(); ++t)
    if (const ceres::LossFunction* const loss = problem.linear(t).term->loss)
      fractions[t] = std::max(kMinFraction, of_loss[loss].curvature / of_loss[loss].weight);
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

/// Returns the inverse of what a landmark's rows know about it.
Eigen::Matrix3d inverse_of_landmark(const Eigen::Matrix3d& own) {
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

/// Appends the rows of a term.
void append_rows(const LeastSquares& problem, const Linear& linear, double curvature,
                 Eliminated* e) {
  const bool has_landmark = linear.term->landmark >= 0;
  for (int r = 0; r < linear.rows; ++r) {
    Row row{static_cast<int>(e->values.size()), 0, Eigen::Vector3d::Zero(), linear.values[r]};
    if (has_landmark) {
      row.curvature = curvature;
      row.group = linear.term->group;
    }
    const double* jacobian = linear.values + linear.rows;
    for (std::size_t k = 0; k < linear.sizes().size(); ++k) {
      const int size = linear.sizes()[k], block = linear.term->blocks[k];
      const double* const of_row = jacobian + r * size;
      if (block == LeastSquares::kOwnLandmark)
        row.own = Eigen::Map<const Eigen::Vector3d>(of_row);
      else if (const int column = problem.blocks()[block].column; column >= 0)
        for (int i = 0; i < size; ++i) {
          if (of_row[i] == 0) continue;
          e->columns.push_back(column + i);
          e->values.push_back(of_row[i]);
        }
      jacobian += linear.rows * size;
    }
    row.n = static_cast<int>(e->values.size()) - row.first;
    e->rows.push_back(row);
  }
}

/// Eliminates a landmark from its rows.
void eliminate(Eliminated* e) {
  e->index = e->columns;
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
      const Eigen::Index at = place(e->columns[i]);
      e->with_rig.col(at) += e->values[i] * row.own;
      gradient[at] += e->values[i] * row.residual;
    }
  }
  e->weighted = inverse_of_landmark(own) * e->with_rig;
  for (auto& [group, gradient] : e->of_groups) {
    gradient -= e->weighted.transpose() * own_of_groups.at(group);
    e->gradient += gradient;
  }
}

/// Adds what the rows of a landmark know about columns [begin, end) of the rig's parameters, less
/// what the landmark takes of it. `eliminated`: false for the rows without a landmark.
void add_columns(const Eliminated& e, bool eliminated, int begin, int end, RigSums* sums) {
  const auto first = std::ranges::lower_bound(e.index, begin) - e.index.begin();
  if (eliminated && (first == std::ssize(e.index) || e.index[first] >= end)) return;
  for (const Row& row : e.rows)
    for (int a = row.first; a < row.first + row.n; ++a) {
      const int column = e.columns[a];
      if (column < begin || column >= end) continue;
      for (int b = row.first; b < row.first + row.n; ++b) {
        const double product = e.values[a] * e.values[b];
        sums->normal(e.columns[b], column) += product;
        sums->curved(e.columns[b], column) += row.curvature * product;
        if (!eliminated) sums->spread(e.columns[b], column) += product;
      }
    }
  if (!eliminated) return;
  for (Eigen::Index a = first; a < std::ssize(e.index) && e.index[a] < end; ++a)
    for (Eigen::Index b = 0; b < std::ssize(e.index); ++b) {
      const double taken = e.weighted.col(a).dot(e.with_rig.col(b));
      sums->normal(e.index[b], e.index[a]) -= taken;
      sums->curved(e.index[b], e.index[a]) -= e.curvature * taken;
      sums->spread(e.index[b], e.index[a]) += e.gradient[b] * e.gradient[a];
    }
}

}  // namespace

ReducedCovariance reduced_covariance(LeastSquares* problem, ThreadPool& pool) {
  REDRIVE_CHECK(std::isfinite(problem->linearise()));
  const std::vector<double> fractions = curvature_fractions(*problem);
  const std::size_t landmarks = problem->landmarks();
  std::vector<std::vector<std::size_t>> terms(landmarks + 1);  // the last ones have no landmark
  for (std::size_t t = 0; t < problem->terms(); ++t) {
    const int landmark = problem->linear(t).term->landmark;
    terms[landmark < 0 ? landmarks : static_cast<std::size_t>(landmark)].push_back(t);
  }
  std::vector<Eliminated> blocks(landmarks + 1);
  pool.run_ranges(blocks.size(), kBlocksOfRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) {
      for (const std::size_t t : terms[i])
        append_rows(*problem, problem->linear(t), fractions[t], &blocks[i]);
      if (i < landmarks) eliminate(&blocks[i]);
    }
  });
  const int n = problem->columns();
  const Eigen::MatrixXd zero = Eigen::MatrixXd::Zero(n, n);
  RigSums sums{zero, zero, zero};
  pool.run_ranges(static_cast<std::size_t>(n), kColumnsOfRange,
                  [&](std::size_t begin, std::size_t end) {
                    for (std::size_t i = 0; i < blocks.size(); ++i)
                      add_columns(blocks[i], i < landmarks, static_cast<int>(begin),
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
