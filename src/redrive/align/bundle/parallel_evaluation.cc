// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/parallel_evaluation.h"

#include <algorithm>
#include <array>

#include "redrive/base/error.h"

namespace redrive {
namespace {

constexpr std::size_t kTermsPerRange = 512;  // some 0.3 ms
constexpr std::size_t kMostBlocks = 8;       // parameter blocks of a term

class CopiedCost final : public ceres::CostFunction {
 public:
  CopiedCost(const ParallelEvaluation& values, std::size_t index, const ceres::CostFunction& of)
      : values_(values), index_(index) {
    set_num_residuals(of.num_residuals());
    *mutable_parameter_block_sizes() = of.parameter_block_sizes();
  }
  bool Evaluate(double const* const*, double* residuals, double** jacobians) const override {
    return values_.copy(index_, residuals, jacobians);
  }

 private:
  const ParallelEvaluation& values_;
  std::size_t index_;
};

}  // namespace

std::unique_ptr<ceres::CostFunction> ParallelEvaluation::copy_of(
    std::unique_ptr<ceres::CostFunction> cost, std::vector<double*> parameters) {
  REDRIVE_CHECK_OP(parameters.size(), <=, kMostBlocks);
  auto copied = std::make_unique<CopiedCost>(*this, terms_.size(), *cost);
  std::size_t columns = 1;  // the residual's
  for (const int size : cost->parameter_block_sizes()) columns += static_cast<std::size_t>(size);
  const std::size_t begin = size_;
  size_ += columns * static_cast<std::size_t>(cost->num_residuals());
  terms_.push_back({std::move(cost), std::move(parameters), begin});
  return copied;
}

void ParallelEvaluation::PrepareForEvaluation(bool evaluate_jacobians, bool new_evaluation_point) {
  if (!new_evaluation_point && (has_jacobians_ || !evaluate_jacobians)) return;
  values_.resize(size_);
  pool_.run_ranges(terms_.size(), kTermsPerRange, [&](std::size_t begin, std::size_t end) {
    for (std::size_t i = begin; i < end; ++i) evaluate(evaluate_jacobians, &terms_[i]);
  });
  has_jacobians_ = evaluate_jacobians;
}

void ParallelEvaluation::evaluate(bool with_jacobians, Term* term) {
  const std::vector<int>& sizes = term->cost->parameter_block_sizes();
  double* const residuals = values_.data() + term->begin;
  std::array<double*, kMostBlocks> jacobians;
  double* next = residuals + term->cost->num_residuals();
  for (std::size_t k = 0; k < sizes.size(); ++k) {
    jacobians[k] = next;
    next += sizes[k] * term->cost->num_residuals();
  }
  term->valid = term->cost->Evaluate(term->parameters.data(), residuals,
                                     with_jacobians ? jacobians.data() : nullptr);
}

bool ParallelEvaluation::copy(std::size_t index, double* residuals, double** jacobians) const {
  const Term& term = terms_[index];
  const int rows = term.cost->num_residuals();
  const double* from = values_.data() + term.begin;
  std::copy_n(from, rows, residuals);
  from += rows;
  const std::vector<int>& sizes = term.cost->parameter_block_sizes();
  for (std::size_t k = 0; jacobians && k < sizes.size(); ++k) {
    if (jacobians[k]) std::copy_n(from, rows * sizes[k], jacobians[k]);
    from += rows * sizes[k];
  }
  return term.valid;
}

}  // namespace redrive
