// SPDX-License-Identifier: Apache-2.0
// Damped normal equations of a least-squares problem with all landmarks eliminated (Triggs,
// McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment - a modern synthesis", 2000, section 6.1).
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "redrive/align/bundle/least_squares.h"

namespace redrive {

class SchurSystem {
 public:
  /// `problem` has been linearised; its terms and held blocks stay as they are.
  SchurSystem(const LeastSquares& problem, ThreadPool& pool);

  struct Step {
    Eigen::VectorXd rig;         ///< [columns]
    Eigen::Matrix3Xd landmarks;  ///< [3, landmarks]
    double decrease = 0;         ///< decrease of the cost, were the terms linear
    double square = 0;           ///< squared norm
  };
  /// Solves (H + D) step = -g with the problem's present linearisation, D = clamp(diag(H)) /
  /// radius in units of the first linearisation. Returns whether H + D is positive definite.
  bool solve(double radius, Step* step);

 private:
  /// A range of columns that a landmark's terms depend on, without a gap.
  struct Run {
    int column, size, local;
  };
  /// A landmark's terms, runs, and its part of with_rig_ and weighted_, [3, columns] each.
  struct Landmark {
    std::size_t first_term = 0, end_term = 0, first_run = 0, end_run = 0, begin = 0;
    int columns = 0;
  };
  struct Use {
    std::uint32_t landmark;
    int local;  ///< index of the block's first column in the landmark's
  };
  struct TermUse {
    std::uint32_t term, block;  ///< index of the block in the term's blocks
  };
  void find_terms();
  /// Blocks that a landmark's terms depend on, in order of their columns.
  std::vector<std::size_t> blocks_of(const Landmark& landmark) const;
  int local_of(const Landmark& landmark, int column) const;
  void reduce_landmark(std::size_t landmark, double radius, bool first);
  void sum_row(std::size_t block);
  void add_outer(const LeastSquares::Linear& linear, std::size_t place);
  void damp_rig(double radius, bool first);
  bool factorise();

  const LeastSquares& problem_;
  ThreadPool& pool_;
  std::vector<Landmark> landmarks_;
  std::vector<Run> runs_;
  std::vector<std::vector<Use>> uses_;           ///< one for each block of the rig
  std::vector<std::vector<TermUse>> term_uses_;  ///< likewise
  std::vector<double> with_rig_, weighted_;
  std::vector<Eigen::Matrix3d> inverse_;
  Eigen::Matrix3Xd gradient_of_, damping_of_, scale_of_;  ///< [3, landmarks]
  Eigen::MatrixXd matrix_;  ///< [columns, columns], of which the lower triangle is used
  Eigen::VectorXd gradient_, reduced_, diagonal_, damping_, scale_;
  bool has_scale_ = false;
};

}  // namespace redrive
