// SPDX-License-Identifier: Apache-2.0
// Robust nonlinear least squares over the numbers of a rig and many landmarks of three numbers
// each: Levenberg-Marquardt steps with landmarks eliminated (schur_system.h), on all threads. Terms
// and losses are Ceres'; so are damping, trust region and their constants (ceres-solver.org,
// "Solving Non-linear Least Squares"). All sums keep their order, and so every bit, for any number
// of threads. ceres::Solve guarantees that with one thread only.
#pragma once

#include <array>
#include <cstddef>
#include <memory>
#include <optional>
#include <vector>

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>

#include "redrive/base/parallel.h"

namespace redrive {

/// Numbers of a landmark.
inline constexpr int kLandmarkSize = 3;

class LeastSquares {
 public:
  static constexpr std::size_t kMostBlocks = 7;
  static constexpr int kOwnLandmark = -1;  ///< in Term::blocks

  /// Adds loss(|r|^2) / 2 to the cost.
  struct Term {
    std::unique_ptr<ceres::CostFunction> cost;
    const ceres::LossFunction* loss = nullptr;  ///< null: none; has to outlive the problem
    /// For each parameter block of `cost`: what add_block() returned, or kOwnLandmark.
    std::array<int, kMostBlocks> blocks{};
    int landmark = -1;  ///< index that add_landmark() returned; -1: none
    int group = -1;  ///< residuals whose errors may be correlated (reduced_covariance.h); -1: none
  };

  /// A term and its values: residuals [rows] and Jacobians [rows, size] of its blocks, one after
  /// the other, all weighted by the root of the loss's slope.
  struct Linear {
    const Term* term = nullptr;
    const double* values = nullptr;
    int rows = 0;
    const std::vector<int>& sizes() const { return term->cost->parameter_block_sizes(); }
    const double* jacobian(std::size_t block) const {
      const double* at = values + rows;
      for (std::size_t k = 0; k < block; ++k) at += rows * sizes()[k];
      return at;
    }
  };

  struct Summary {
    double initial_cost = 0, final_cost = 0;
    int iterations = 0;
    double seconds = 0;
  };

  explicit LeastSquares(ThreadPool& pool) : pool_(pool) {}

  /// Adds numbers of the rig. `values` has to outlive the problem.
  int add_block(double* values, int size);
  /// Keeps a block at its present values.
  void hold(int block);
  int add_landmark(const std::array<double, kLandmarkSize>& value);
  /// Adds a term: all terms of a landmark directly one after the other.
  void add(Term term);

  /// Takes steps until one lowers the cost by less than `tolerance` times the cost, or is next to
  /// nothing. Where a term cannot be evaluated at first, nothing changes and costs are infinite.
  Summary solve(int most_iterations, double tolerance);

  const std::array<double, kLandmarkSize>& landmark(int i) const { return now_.landmarks[i]; }
  std::size_t landmarks() const { return now_.landmarks.size(); }

  /// Index of a block's first number among all that are not held, in order of add_block(); nothing
  /// where it is held.
  std::optional<int> column(int block) const;
  int columns() const;  ///< numbers of the rig that are not held
  struct Block {
    double* values;
    int size, column;    ///< index of its first number as column() has it; -1: held
    std::size_t offset;  ///< in the values of all blocks
  };
  const std::vector<Block>& blocks() const { return blocks_; }

  /// Evaluates all terms and Jacobians at the present values. Returns the cost, infinite where a
  /// term cannot be evaluated.
  double linearise();
  std::size_t terms() const { return terms_.size(); }
  Linear linear(std::size_t term) const {
    return {&terms_[term].term, values_.data() + terms_[term].begin, terms_[term].rows};
  }
  /// |r|^2 of a term without its loss, of linearise().
  double square(std::size_t term) const { return squares_[term]; }

 private:
  struct State {
    std::vector<double> rig;  ///< all blocks, held ones too
    std::vector<std::array<double, kLandmarkSize>> landmarks;
  };
  struct StoredTerm {
    Term term;
    int rows = 0;
    std::size_t begin = 0;  ///< in values_
  };
  double evaluate(const State& at, bool linearise);
  double evaluate_term(const State& at, std::size_t term, bool linearise);
  void read_rig();
  void write_rig();

  ThreadPool& pool_;
  std::vector<Block> blocks_;
  int columns_ = 0;
  State now_;
  std::vector<StoredTerm> terms_;
  std::vector<double> values_, squares_;
  std::size_t values_size_ = 0;
};

}  // namespace redrive
