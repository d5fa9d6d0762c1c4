// SPDX-License-Identifier: Apache-2.0
// Evaluates all residuals and Jacobians of a problem on all cores before Ceres, in one thread,
// copies and sums them: sums keep their order, and so every bit, for any number of threads.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include <ceres/cost_function.h>
#include <ceres/evaluation_callback.h>

#include "redrive/base/parallel.h"

namespace redrive {

class ParallelEvaluation final : public ceres::EvaluationCallback {
 public:
  explicit ParallelEvaluation(ThreadPool& pool) : pool_(pool) {}

  /// Returns a cost function that copies what `cost` gives at `parameters`, the blocks with which
  /// it is added to the problem. It must not outlive this.
  std::unique_ptr<ceres::CostFunction> copy_of(std::unique_ptr<ceres::CostFunction> cost,
                                               std::vector<double*> parameters);

  void PrepareForEvaluation(bool evaluate_jacobians, bool new_evaluation_point) override;

  /// Copies values of a cost function, in order of copy_of; Jacobians where not null.
  bool copy(std::size_t index, double* residuals, double** jacobians) const;

 private:
  struct Term {
    std::unique_ptr<ceres::CostFunction> cost;
    std::vector<double*> parameters;
    std::size_t begin = 0;  ///< in values_: residuals, then the Jacobian of each parameter block
    bool valid = false;
  };
  void evaluate(bool with_jacobians, Term* term);

  ThreadPool& pool_;
  std::vector<Term> terms_;
  std::vector<double> values_;
  std::size_t size_ = 0;
  bool has_jacobians_ = false;
};

}  // namespace redrive
