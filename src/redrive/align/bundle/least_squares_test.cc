// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/least_squares.h"

#include <cmath>
#include <limits>

#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include "redrive/align/bundle/synthetic_rig_testing.h"

namespace redrive {
namespace {

/// a x + sin(x_0) / 10 - b [2] of all blocks one after the other, x.
class BentTerm final : public ceres::CostFunction {
 public:
  BentTerm(Eigen::Matrix2Xd a, const Eigen::Vector2d& b, const std::vector<int>& sizes)
      : a_(std::move(a)), b_(b) {
    set_num_residuals(2);
    *mutable_parameter_block_sizes() = sizes;
  }
  bool Evaluate(double const* const* at, double* residuals, double** jacobians) const override {
    Eigen::Map<Eigen::Vector2d> r(residuals);
    r = Eigen::Vector2d::Constant(0.1 * std::sin(at[0][0])) - b_;
    int column = 0;
    for (std::size_t k = 0; k < parameter_block_sizes().size(); ++k) {
      const int size = parameter_block_sizes()[k];
      r += a_.middleCols(column, size) * Eigen::Map<const Eigen::VectorXd>(at[k], size);
      if (jacobians && jacobians[k])
        for (int row = 0; row < 2; ++row)
          for (int i = 0; i < size; ++i)
            jacobians[k][row * size + i] =
                a_(row, column + i) + (k + i == 0 ? 0.1 * std::cos(at[0][0]) : 0);
      column += size;
    }
    return true;
  }

 private:
  Eigen::Matrix2Xd a_;
  Eigen::Vector2d b_;
};

/// A rig of blocks along a line, each seen by landmarks that see a few more, and one that all see:
/// more columns than a panel of the factorisation has, of which most know nothing of each other.
struct Line {
  static constexpr int kBlocks = 30, kLandmarks = 300, kEach = 5;
  std::array<std::array<double, 6>, kBlocks> rig{};
  std::array<double, 2> shared{};
  double held = 0.5;
  std::array<std::array<double, 3>, kLandmarks> landmarks{};

  bool operator==(const Line&) const = default;
};

using AddTerm = std::function<void(std::unique_ptr<ceres::CostFunction>, std::array<int, 4> blocks,
                                   int landmark)>;

/// Calls `add` with terms; one in ten is far off. Blocks: the line's, then shared, then held; -1:
/// the landmark, or none.
void add_terms(const AddTerm& add) {
  testing::SyntheticNoise noise(31);
  const auto term = [&](const std::vector<int>& sizes) {
    int columns = 0;
    for (const int size : sizes) columns += size;
    Eigen::Matrix2Xd a(2, columns);
    for (double& x : a.reshaped()) x = noise.normal();
    Eigen::Vector2d b(noise.normal(), noise.normal());
    if (noise.uniform(0, 1) < 0.1) b *= 40;
    return std::make_unique<BentTerm>(std::move(a), b, sizes);
  };
  for (int l = 0; l < Line::kLandmarks; ++l)
    for (int i = 0; i < Line::kEach; ++i)
      add(term({6, 3, 2, 1}),
          {(l * Line::kBlocks / Line::kLandmarks + i) % Line::kBlocks, -1, Line::kBlocks,
           Line::kBlocks + 1},
          l);
  for (int b = 0; b < Line::kBlocks; ++b) add(term({6}), {b}, -1);
}

LeastSquares::Summary solve(Line* line, int threads) {
  ThreadPool pool(threads);
  LeastSquares problem(pool);
  const ceres::CauchyLoss loss(2);
  for (auto& block : line->rig) problem.add_block(block.data(), 6);
  problem.add_block(line->shared.data(), 2);
  problem.hold(problem.add_block(&line->held, 1));
  for (const auto& landmark : line->landmarks) problem.add_landmark(landmark);
  add_terms(
      [&](std::unique_ptr<ceres::CostFunction> cost, std::array<int, 4> blocks, int landmark) {
        LeastSquares::Term term{.cost = std::move(cost), .loss = &loss, .landmark = landmark};
        std::ranges::copy(blocks, term.blocks.begin());
        problem.add(std::move(term));
      });
  const LeastSquares::Summary summary = problem.solve(100, 1e-15);
  for (int l = 0; l < Line::kLandmarks; ++l) line->landmarks[l] = problem.landmark(l);
  return summary;
}

ceres::Solver::Summary solve_by_ceres(Line* line) {
  ceres::Problem problem;
  add_terms(
      [&](std::unique_ptr<ceres::CostFunction> cost, std::array<int, 4> blocks, int landmark) {
        std::vector<double*> at;
        for (std::size_t k = 0; k < cost->parameter_block_sizes().size(); ++k)
          at.push_back(blocks[k] < 0                ? line->landmarks[landmark].data()
                       : blocks[k] < Line::kBlocks  ? line->rig[blocks[k]].data()
                       : blocks[k] == Line::kBlocks ? line->shared.data()
                                                    : &line->held);
        problem.AddResidualBlock(cost.release(), new ceres::CauchyLoss(2), at);
      });
  problem.SetParameterBlockConstant(&line->held);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (auto& landmark : line->landmarks)
    options.linear_solver_ordering->AddElementToGroup(landmark.data(), 0);
  for (auto& block : line->rig) options.linear_solver_ordering->AddElementToGroup(block.data(), 1);
  for (double* const block : {line->shared.data(), &line->held})
    options.linear_solver_ordering->AddElementToGroup(block, 1);
  options.max_num_iterations = 100;
  options.function_tolerance = 1e-15;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary;
}

TEST(LeastSquares, EndsWhereCeresEnds) {
  Line ours, theirs;
  const LeastSquares::Summary own = solve(&ours, 2);
  const ceres::Solver::Summary ceres = solve_by_ceres(&theirs);
  ASSERT_EQ(ceres.termination_type, ceres::CONVERGENCE);
  EXPECT_NEAR(own.initial_cost, ceres.initial_cost, 1e-10 * ceres.initial_cost);
  EXPECT_NEAR(own.final_cost, ceres.final_cost, 1e-10 * ceres.final_cost);
  EXPECT_GT(own.iterations, 3);
  for (int b = 0; b < Line::kBlocks; ++b)
    for (int k = 0; k < 6; ++k) EXPECT_NEAR(ours.rig[b][k], theirs.rig[b][k], 1e-5) << b;
  for (int l = 0; l < Line::kLandmarks; ++l)
    for (int k = 0; k < 3; ++k) EXPECT_NEAR(ours.landmarks[l][k], theirs.landmarks[l][k], 1e-5);
  EXPECT_EQ(ours.held, 0.5);
}

TEST(LeastSquares, GivesTheSameBitsForAnyNumberOfThreads) {
  Line alone;
  const LeastSquares::Summary summary = solve(&alone, 1);
  for (const int threads : {2, 5}) {
    Line line;
    EXPECT_EQ(solve(&line, threads).iterations, summary.iterations);
    EXPECT_TRUE(line == alone) << threads;
  }
}

/// log(x / 1e-3) [1] of a number above 0.
class LogTerm final : public ceres::CostFunction {
 public:
  LogTerm() {
    set_num_residuals(1);
    mutable_parameter_block_sizes()->push_back(1);
  }
  bool Evaluate(double const* const* at, double* residuals, double** jacobians) const override {
    if (!(at[0][0] > 0)) return false;
    residuals[0] = std::log(at[0][0] / 1e-3);
    if (jacobians && jacobians[0]) jacobians[0][0] = 1 / at[0][0];
    return true;
  }
};

// The first step, to -21, would leave what the term can evaluate.
TEST(LeastSquares, TakesSmallerStepsWhereATermCannotBeEvaluated) {
  ThreadPool pool(1);
  double x = 3;
  LeastSquares problem(pool);
  const int block = problem.add_block(&x, 1);
  const int unseen = problem.add_landmark({1, 2, 3});
  problem.add({.cost = std::make_unique<LogTerm>(), .blocks = {block}});
  const LeastSquares::Summary summary = problem.solve(100, 1e-12);
  EXPECT_EQ(problem.landmark(unseen), (std::array<double, 3>{1, 2, 3})) << "it has no terms";
  EXPECT_NEAR(x, 1e-3, 1e-6);
  EXPECT_LT(summary.final_cost, 1e-6);
}

TEST(LeastSquares, ChangesNothingWhereATermCannotBeEvaluatedAtFirst) {
  ThreadPool pool(1);
  double x = -1;
  LeastSquares problem(pool);
  const int block = problem.add_block(&x, 1);
  problem.add({.cost = std::make_unique<LogTerm>(), .blocks = {block}});
  EXPECT_EQ(problem.solve(100, 1e-12).final_cost, std::numeric_limits<double>::infinity());
  EXPECT_EQ(x, -1);
}

TEST(LeastSquares, ColumnsOfHeldBlocksAreLeftOut) {
  ThreadPool pool(1);
  std::array<double, 3> a{};
  double b = 0, c = 0;
  LeastSquares problem(pool);
  const int first = problem.add_block(a.data(), 3), second = problem.add_block(&b, 1),
            third = problem.add_block(&c, 1);
  EXPECT_EQ(problem.column(third), 4);
  problem.hold(first);
  problem.hold(first);
  EXPECT_EQ(problem.column(first), std::nullopt);
  EXPECT_EQ(problem.column(second), 0);
  EXPECT_EQ(problem.column(third), 1);
  EXPECT_EQ(problem.columns(), 2);
}

}  // namespace
}  // namespace redrive
