// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/parallel_evaluation.h"

#include <array>
#include <cmath>

#include <ceres/crs_matrix.h>
#include <ceres/problem.h>
#include <ceres/sized_cost_function.h>
#include <gtest/gtest.h>

namespace redrive {
namespace {

/// (a0 b, sin(a1 + k)); invalid where b is negative.
class Example final : public ceres::SizedCostFunction<2, 2, 1> {
 public:
  explicit Example(int k) : k_(k) {}
  bool Evaluate(double const* const* at, double* residuals, double** jacobians) const override {
    residuals[0] = at[0][0] * at[1][0];
    residuals[1] = std::sin(at[0][1] + k_);
    if (jacobians && jacobians[0]) {
      jacobians[0][0] = at[1][0];
      jacobians[0][1] = jacobians[0][2] = 0;
      jacobians[0][3] = std::cos(at[0][1] + k_);
    }
    if (jacobians && jacobians[1]) {
      jacobians[1][0] = at[0][0];
      jacobians[1][1] = 0;
    }
    return at[1][0] >= 0;
  }

 private:
  int k_;
};

struct Values {
  double cost = 0;
  std::vector<double> residuals, gradient, jacobian;
  bool operator==(const Values&) const = default;
};

/// Values at two points one after the other; of Ceres alone where pool is null.
std::vector<Values> values(ThreadPool* pool) {
  constexpr int kTerms = 2000;  // several ranges
  std::array<std::array<double, 2>, kTerms> a;
  double b = 0.75;
  std::optional<ParallelEvaluation> evaluation;
  ceres::Problem::Options options;
  if (pool) options.evaluation_callback = &evaluation.emplace(*pool);
  ceres::Problem problem(options);
  for (int k = 0; k < kTerms; ++k) {
    a[k] = {0.1 * k, -0.3 * k};
    auto cost = std::make_unique<Example>(k);
    if (pool)
      problem.AddResidualBlock(evaluation->copy_of(std::move(cost), {a[k].data(), &b}).release(),
                               nullptr, a[k].data(), &b);
    else
      problem.AddResidualBlock(cost.release(), nullptr, a[k].data(), &b);
  }
  problem.SetParameterBlockConstant(a[3].data());
  std::vector<Values> all(2);
  for (Values& at : all) {
    ceres::CRSMatrix jacobian;
    EXPECT_TRUE(problem.Evaluate({}, &at.cost, &at.residuals, &at.gradient, &jacobian));
    at.jacobian = jacobian.values;
    b = 1.5;
    a[7] = {5, 6};
  }
  b = -1;
  double cost = 0;
  EXPECT_FALSE(problem.Evaluate({}, &cost, nullptr, nullptr, nullptr));
  return all;
}

TEST(ParallelEvaluation, GivesTheBitsOfCeresAloneForAnyNumberOfThreads) {
  const std::vector<Values> alone = values(nullptr);
  EXPECT_NE(alone[0], alone[1]);
  for (const int threads : {1, 2, 5}) {
    ThreadPool pool(threads);
    EXPECT_EQ(values(&pool), alone) << threads;
  }
}

}  // namespace
}  // namespace redrive
