// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/schur_system.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include <Eigen/Cholesky>

#include "redrive/base/error.h"

namespace redrive {
namespace {

using Linear = LeastSquares::Linear;

constexpr std::size_t kLandmarksPerRange = 64;
constexpr double kLeastDiagonal = 1e-6, kMostDiagonal = 1e32;  // Ceres' defaults
constexpr Eigen::Index kPanel = 48;  // columns of a panel of the factorisation

/// Damping of a number with the diagonal `h` of the normal matrix, in units of `scale`.
double damping_of(double h, double scale, double radius) {
  return std::clamp(h * scale * scale, kLeastDiagonal, kMostDiagonal) / (radius * scale * scale);
}

double scale_of(double h) { return 1 / (1 + std::sqrt(h)); }

}  // namespace

SchurSystem::SchurSystem(const LeastSquares& problem, ThreadPool& pool)
    : problem_(problem), pool_(pool), landmarks_(problem.landmarks()) {
  find_terms();
  std::vector<std::vector<std::size_t>> blocks(landmarks_.size());
  pool_.run_ranges(landmarks_.size(), kLandmarksPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) blocks[i] = blocks_of(landmarks_[i]);
  });
  uses_.resize(problem.blocks().size());
  std::size_t size = 0;
  for (std::size_t i = 0; i < landmarks_.size(); ++i) {
    Landmark& landmark = landmarks_[i];
    landmark.begin = size;
    landmark.first_run = runs_.size();
    for (const std::size_t b : blocks[i]) {
      const LeastSquares::Block& block = problem.blocks()[b];
      uses_[b].push_back({static_cast<std::uint32_t>(i), landmark.columns});
      if (runs_.size() > landmark.first_run &&
          runs_.back().column + runs_.back().size == block.column)
        runs_.back().size += block.size;
      else
        runs_.push_back({block.column, block.size, landmark.columns});
      landmark.columns += block.size;
    }
    landmark.end_run = runs_.size();
    size += static_cast<std::size_t>(kLandmarkSize * landmark.columns);
  }
  with_rig_.resize(size);
  weighted_.resize(size);
  inverse_.resize(landmarks_.size());
  const auto n = static_cast<Eigen::Index>(landmarks_.size());
  gradient_of_.resize(3, n);
  damping_of_.resize(3, n);
  scale_of_.resize(3, n);
  const Eigen::Index columns = problem.columns();
  matrix_.resize(columns, columns);
  for (Eigen::VectorXd* vector : {&gradient_, &reduced_, &diagonal_, &damping_, &scale_})
    vector->resize(columns);
}

void SchurSystem::find_terms() {
  term_uses_.resize(problem_.blocks().size());
  for (std::size_t t = 0; t < problem_.terms(); ++t) {
    const Linear linear = problem_.linear(t);
    for (std::size_t k = 0; k < linear.sizes().size(); ++k)
      if (const int block = linear.term->blocks[k];
          block != LeastSquares::kOwnLandmark && problem_.blocks()[block].column >= 0)
        term_uses_[static_cast<std::size_t>(block)].push_back(
            {static_cast<std::uint32_t>(t), static_cast<std::uint32_t>(k)});
    if (linear.term->landmark < 0) continue;
    Landmark& of = landmarks_[static_cast<std::size_t>(linear.term->landmark)];
    if (of.end_term == 0) of.first_term = of.end_term = t;
    REDRIVE_CHECK_OP(of.end_term, ==, t);
    ++of.end_term;
  }
}

std::vector<std::size_t> SchurSystem::blocks_of(const Landmark& landmark) const {
  std::vector<std::size_t> blocks;
  for (std::size_t t = landmark.first_term; t < landmark.end_term; ++t) {
    const Linear linear = problem_.linear(t);
    for (std::size_t k = 0; k < linear.sizes().size(); ++k)
      if (const int block = linear.term->blocks[k];
          block != LeastSquares::kOwnLandmark && problem_.blocks()[block].column >= 0)
        blocks.push_back(static_cast<std::size_t>(block));
  }
  std::ranges::sort(blocks);
  blocks.erase(std::ranges::unique(blocks).begin(), blocks.end());
  return blocks;
}

int SchurSystem::local_of(const Landmark& landmark, int column) const {
  for (std::size_t r = landmark.first_run; r < landmark.end_run; ++r)
    if (column >= runs_[r].column && column < runs_[r].column + runs_[r].size)
      return runs_[r].local + column - runs_[r].column;
  return -1;
}

void SchurSystem::reduce_landmark(std::size_t i, double radius, bool first) {
  const Landmark& landmark = landmarks_[i];
  const auto column = static_cast<Eigen::Index>(i);
  using Wide = Eigen::Matrix<double, kLandmarkSize, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<Wide> with_rig(with_rig_.data() + landmark.begin, kLandmarkSize, landmark.columns);
  with_rig.setZero();
  Eigen::Matrix3d own = Eigen::Matrix3d::Zero();
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  for (std::size_t t = landmark.first_term; t < landmark.end_term; ++t) {
    const Linear linear = problem_.linear(t);
    const auto& blocks = linear.term->blocks;
    const auto at = std::ranges::find(blocks, LeastSquares::kOwnLandmark) - blocks.begin();
    const Eigen::Map<const Eigen::Matrix<double, Eigen::Dynamic, kLandmarkSize, Eigen::RowMajor>>
        by_own(linear.jacobian(static_cast<std::size_t>(at)), linear.rows, kLandmarkSize);
    for (int row = 0; row < linear.rows; ++row) {
      const Eigen::Vector3d slope = by_own.row(row).transpose();
      own += slope * slope.transpose();
      gradient += linear.values[row] * slope;
    }
    const double* jacobian = linear.values + linear.rows;
    for (std::size_t k = 0; k < linear.sizes().size(); ++k) {
      const int size = linear.sizes()[k];
      const int to =
          blocks[k] == LeastSquares::kOwnLandmark ? -1 : problem_.blocks()[blocks[k]].column;
      if (const int local = to < 0 ? -1 : local_of(landmark, to); local >= 0)
        for (int row = 0; row < linear.rows; ++row)
          for (int q = 0; q < kLandmarkSize; ++q)
            for (int j = 0; j < size; ++j)
              with_rig(q, local + j) += by_own(row, q) * jacobian[row * size + j];
      jacobian += linear.rows * size;
    }
  }
  for (int q = 0; q < kLandmarkSize; ++q) {
    if (first) scale_of_(q, column) = scale_of(own(q, q));
    damping_of_(q, column) = redrive::damping_of(own(q, q), scale_of_(q, column), radius);
    own(q, q) += damping_of_(q, column);
  }
  const Eigen::LLT<Eigen::Matrix3d> factor(own);
  if (factor.info() == Eigen::Success)
    inverse_[i] = factor.solve(Eigen::Matrix3d::Identity());
  else
    inverse_[i].setConstant(std::numeric_limits<double>::quiet_NaN());  // solve() fails
  gradient_of_.col(column) = gradient;
  Eigen::Map<Wide>(weighted_.data() + landmark.begin, kLandmarkSize, landmark.columns) =
      inverse_[i] * with_rig;
}

/// Adds what a term knows of the columns of the block at `place` among its own.
void SchurSystem::add_outer(const Linear& linear, std::size_t place) {
  const auto& blocks = linear.term->blocks;
  const std::vector<int>& sizes = linear.sizes();
  const int first = problem_.blocks()[blocks[place]].column, size = sizes[place];
  const double* const own = linear.jacobian(place);
  for (int row = 0; row < linear.rows; ++row)
    for (int i = 0; i < size; ++i) {
      gradient_[first + i] += own[row * size + i] * linear.values[row];
      diagonal_[first + i] += own[row * size + i] * own[row * size + i];
    }
  const double* jacobian = linear.values + linear.rows;
  for (std::size_t k = 0; k < sizes.size(); ++k) {
    const int to =
        blocks[k] == LeastSquares::kOwnLandmark ? -1 : problem_.blocks()[blocks[k]].column;
    for (int i = 0; to >= first && i < size; ++i) {
      double* const at = &matrix_(to, first + i);
      for (int row = 0; row < linear.rows; ++row)
        for (int j = 0; j < sizes[k]; ++j)
          at[j] += own[row * size + i] * jacobian[row * sizes[k] + j];
    }
    jacobian += linear.rows * sizes[k];
  }
}

void SchurSystem::sum_row(std::size_t block) {
  const int first = problem_.blocks()[block].column, size = problem_.blocks()[block].size;
  matrix_.middleCols(first, size).setZero();
  for (Eigen::VectorXd* vector : {&gradient_, &diagonal_}) vector->segment(first, size).setZero();
  for (const TermUse& use : term_uses_[block]) add_outer(problem_.linear(use.term), use.block);
  reduced_.segment(first, size) = gradient_.segment(first, size);
  for (const Use& use : uses_[block]) {
    const Landmark& landmark = landmarks_[use.landmark];
    const double* const with_rig = with_rig_.data() + landmark.begin + use.local;
    const double* const weighted = weighted_.data() + landmark.begin;
    const int n = landmark.columns;
    const Eigen::Vector3d gradient = gradient_of_.col(use.landmark);
    for (int i = 0; i < size; ++i) {
      const double w[3] = {with_rig[i], with_rig[n + i], with_rig[2 * n + i]};
      const double* const own = weighted + use.local + i;
      reduced_[first + i] -= own[0] * gradient[0] + own[n] * gradient[1] + own[2 * n] * gradient[2];
      for (std::size_t r = landmark.first_run; r < landmark.end_run; ++r) {
        const Run& run = runs_[r];
        double* const at = &matrix_(run.column, first + i);
        const double* const y = weighted + run.local;
        for (int j = std::max(0, first - run.column); j < run.size; ++j)
          at[j] -= w[0] * y[j] + w[1] * y[n + j] + w[2] * y[2 * n + j];
      }
    }
  }
}

void SchurSystem::damp_rig(double radius, bool first) {
  for (Eigen::Index i = 0; i < diagonal_.size(); ++i) {
    if (first) scale_[i] = scale_of(diagonal_[i]);
    damping_[i] = redrive::damping_of(diagonal_[i], scale_[i], radius);
    matrix_(i, i) += damping_[i];
  }
}

/// Replaces the lower triangle of the matrix by its Cholesky factor, panel by panel; blocks of
/// zeros, as between frames that see no landmark in common, are passed over. Returns whether the
/// matrix is positive definite.
bool SchurSystem::factorise() {
  const Eigen::Index n = matrix_.rows(), panels = (n + kPanel - 1) / kPanel;
  const auto block = [&](Eigen::Index i, Eigen::Index j) {
    return matrix_.block(i * kPanel, j * kPanel, std::min(kPanel, n - i * kPanel),
                         std::min(kPanel, n - j * kPanel));
  };
  for (Eigen::Index k = 0; k < panels; ++k) {
    Eigen::Ref<Eigen::MatrixXd> diagonal = block(k, k);
    const Eigen::LLT<Eigen::Ref<Eigen::MatrixXd>> own(diagonal);  // in place
    if (own.info() != Eigen::Success) return false;
    std::vector<Eigen::Index> below;
    for (Eigen::Index i = k + 1; i < panels; ++i)
      if (!block(i, k).isZero(0)) below.push_back(i);
    pool_.run_ranges(below.size(), 1, [&](std::size_t i, std::size_t) {
      auto of = block(below[i], k);
      block(k, k).triangularView<Eigen::Lower>().transpose().solveInPlace<Eigen::OnTheRight>(of);
    });
    pool_.run_ranges(below.size(), 1, [&](std::size_t i, std::size_t) {
      for (std::size_t j = 0; j <= i; ++j)
        block(below[i], below[j]).noalias() -= block(below[i], k) * block(below[j], k).transpose();
    });
  }
  return true;
}

bool SchurSystem::solve(double radius, Step* step) {
  const bool first = !has_scale_;
  has_scale_ = true;
  pool_.run_ranges(landmarks_.size(), kLandmarksPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) reduce_landmark(i, radius, first);
  });
  const std::vector<LeastSquares::Block>& blocks = problem_.blocks();
  pool_.run_ranges(blocks.size(), 1, [&](std::size_t block, std::size_t) {
    if (blocks[block].column >= 0) sum_row(block);
  });
  damp_rig(radius, first);
  if (!factorise()) return false;
  step->rig = -reduced_;
  matrix_.triangularView<Eigen::Lower>().solveInPlace(step->rig);
  matrix_.triangularView<Eigen::Lower>().transpose().solveInPlace(step->rig);
  step->landmarks.resize(3, static_cast<Eigen::Index>(landmarks_.size()));
  struct Sums {
    double decrease = 0, square = 0;
  };
  std::vector<Sums> sums((landmarks_.size() + kLandmarksPerRange - 1) / kLandmarksPerRange);
  pool_.run_ranges(landmarks_.size(), kLandmarksPerRange, [&](std::size_t begin, std::size_t end) {
    Sums& sum = sums[begin / kLandmarksPerRange];
    for (std::size_t i = begin; i < end; ++i) {
      const Landmark& landmark = landmarks_[i];
      const auto column = static_cast<Eigen::Index>(i);
      Eigen::Vector3d change = -inverse_[i] * gradient_of_.col(column);
      for (std::size_t r = landmark.first_run; r < landmark.end_run; ++r)
        for (int q = 0; q < kLandmarkSize; ++q) {
          const double* const y =
              weighted_.data() + landmark.begin + q * landmark.columns + runs_[r].local;
          for (int j = 0; j < runs_[r].size; ++j)
            change[q] -= y[j] * step->rig[runs_[r].column + j];
        }
      step->landmarks.col(column) = change;
      sum.decrease += change.dot(damping_of_.col(column).cwiseProduct(change)) -
                      gradient_of_.col(column).dot(change);
      sum.square += change.squaredNorm();
    }
  });
  Sums all{step->rig.dot(damping_.cwiseProduct(step->rig)) - gradient_.dot(step->rig),
           step->rig.squaredNorm()};
  for (const Sums& sum : sums) {
    all.decrease += sum.decrease;
    all.square += sum.square;
  }
  step->decrease = all.decrease / 2;  // H step = -g - D step
  step->square = all.square;
  return std::isfinite(all.decrease);
}

}  // namespace redrive
