// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/reduced_covariance.h"

#include <ceres/cost_function.h>
#include <ceres/loss_function.h>
#include <ceres/problem.h>
#include <gtest/gtest.h>
#include <Eigen/Dense>

#include "redrive/align/bundle/synthetic_rig_testing.h"

namespace redrive {
namespace {

/// a . (all blocks one after the other) - b [1].
class LinearTerm final : public ceres::CostFunction {
 public:
  LinearTerm(const std::vector<Eigen::VectorXd>& a, double b) : a_(a), b_(b) {
    set_num_residuals(1);
    for (const Eigen::VectorXd& block : a)
      mutable_parameter_block_sizes()->push_back(static_cast<int>(block.size()));
  }
  bool Evaluate(double const* const* parameters, double* residuals,
                double** jacobians) const override {
    residuals[0] = -b_;
    for (std::size_t k = 0; k < a_.size(); ++k) {
      const Eigen::Map<const Eigen::VectorXd> block(parameters[k], a_[k].size());
      residuals[0] += a_[k].dot(block);
      if (jacobians && jacobians[k])
        Eigen::Map<Eigen::VectorXd>(jacobians[k], a_[k].size()) = a_[k];
    }
    return true;
  }

 private:
  std::vector<Eigen::VectorXd> a_;
  double b_;
};

Eigen::VectorXd random_vector(testing::SyntheticNoise* noise, int size) {
  Eigen::VectorXd v(size);
  for (double& x : v) x = noise->normal();
  return v;
}

// Two blocks of the rig and four free ones: compares with the block of the inverse of the normal
// matrix of all 17 parameters.
TEST(ReducedCovariance, EqualsTheBlockOfTheFullInverse) {
  ThreadPool pool(2);
  testing::SyntheticNoise noise(21);
  std::array<double, 2> first{};
  std::array<double, 3> second{};
  std::array<std::array<double, 3>, 4> points{};
  ceres::Problem problem;
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(17, 17);
  for (int point = 0; point < 4; ++point)
    for (int row = 0; row < 8; ++row) {
      const std::vector<Eigen::VectorXd> a{random_vector(&noise, 2), random_vector(&noise, 3),
                                           random_vector(&noise, 3)};
      problem.AddResidualBlock(new LinearTerm(a, noise.normal()), nullptr, first.data(),
                               second.data(), points[point].data());
      Eigen::VectorXd all = Eigen::VectorXd::Zero(17);
      all << a[0], a[1], Eigen::VectorXd::Zero(12);
      all.segment<3>(5 + 3 * point) = a[2];
      normal += all * all.transpose();
    }
  const ReducedCovariance covariance = reduced_covariance(
      problem, {first.data(), second.data()},
      {points[0].data(), points[1].data(), points[2].data(), points[3].data()}, pool);
  const Eigen::MatrixXd expected = normal.inverse().topLeftCorner(5, 5);
  EXPECT_LT((covariance.matrix - expected).norm(), 1e-10 * expected.norm());
  EXPECT_TRUE((covariance.variance.array() >= covariance.matrix.diagonal().array()).all());
}

// One number is measured 40 times, first with 8 errors of five measurements each, then with
// independent errors: the variance of the mean is an 8th, then a 40th, of a measurement's. A prior
// with the sigma of one measurement counts once.
TEST(ReducedCovariance, AccountsForCorrelatedResidualsOfAPoint) {
  ThreadPool pool(2);
  constexpr int kPoints = 8, kEach = 5;
  for (const bool known_before : {false, true}) {
    testing::SyntheticNoise noise(22);
    double value = 0, squares = 0;
    Eigen::VectorXd errors = random_vector(&noise, kPoints);
    errors.array() -= errors.mean();  // the optimum is 0
    std::array<std::array<double, 3>, kPoints> points{};
    std::vector<double*> free;
    ceres::Problem problem;
    for (int p = 0; p < kPoints; ++p) {
      free.push_back(points[p].data());
      for (int k = 0; k < kEach; ++k)
        problem.AddResidualBlock(
            new LinearTerm({Eigen::VectorXd::Ones(1), Eigen::VectorXd::Zero(3)}, errors[p]),
            nullptr, &value, points[p].data());
      squares += errors[p] * errors[p];
    }
    if (known_before)
      problem.AddResidualBlock(new LinearTerm({Eigen::VectorXd::Ones(1)}, 0), nullptr, &value);
    const ReducedCovariance covariance = reduced_covariance(problem, {&value}, free, pool);
    const double n = kPoints * kEach + known_before;
    EXPECT_NEAR(covariance.matrix(0, 0), 1 / n, 1e-12);
    EXPECT_NEAR(covariance.variance[0],
                std::max(1 / n, (kEach * kEach * squares + known_before) / (n * n)), 1e-12);
    EXPECT_GT(covariance.variance[0], 1.2 / n) << "the correlation has no effect";
  }
}

// As above, with errors that eight images share: each image measures the number once at each of
// five points.
TEST(ReducedCovariance, AccountsForCorrelatedResidualsOfAGroup) {
  ThreadPool pool(2);
  constexpr int kPoints = 5, kGroups = 8;
  testing::SyntheticNoise noise(24);
  double value = 0;
  Eigen::VectorXd errors = random_vector(&noise, kGroups);
  errors.array() -= errors.mean();  // the optimum is 0, and errors of a point cancel
  std::array<std::array<double, 3>, kPoints> points{};
  std::vector<double*> free;
  ceres::Problem problem;
  ResidualGroups groups;
  for (auto& point : points) {
    free.push_back(point.data());
    for (int group = 0; group < kGroups; ++group)
      groups[problem.AddResidualBlock(
          new LinearTerm({Eigen::VectorXd::Ones(1), Eigen::VectorXd::Zero(3)}, errors[group]),
          nullptr, &value, point.data())] = group;
  }
  const double n = kPoints * kGroups;
  EXPECT_NEAR(reduced_covariance(problem, {&value}, free, pool, groups).variance[0],
              kPoints * kPoints * errors.squaredNorm() / (n * n), 1e-12);
  EXPECT_NEAR(reduced_covariance(problem, {&value}, free, pool).variance[0], 1 / n, 1e-12)
      << "without groups";
}

// A number is measured at 60 points, four times each with the same error of one sigma, under a
// Cauchy loss of scale two. The stated covariance equals the covariance of repetitions. (With the
// loss's weights as curvature it would be three quarters of it.)
TEST(ReducedCovariance, AgreesWithRepetitionsUnderRobustLosses) {
  ThreadPool pool(2);
  constexpr int kRepetitions = 400, kPoints = 60, kEach = 4;
  testing::SyntheticNoise noise(23);
  ceres::CauchyLoss loss(2);
  double squares = 0, stated = 0;
  for (int r = 0; r < kRepetitions; ++r) {
    const Eigen::VectorXd measured = random_vector(&noise, kPoints);
    double value = 0;
    for (int iteration = 0; iteration < 50; ++iteration) {  // weighted means
      double sum = 0, weights = 0;
      for (const double x : measured) {
        const double weight = 1 / (1 + (x - value) * (x - value) / 4);
        sum += weight * x;
        weights += weight;
      }
      value = sum / weights;
    }
    ceres::Problem::Options options;
    options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    ceres::Problem problem(options);
    std::array<std::array<double, 3>, kPoints> points{};
    std::vector<double*> free;
    for (int p = 0; p < kPoints; ++p) {
      free.push_back(points[p].data());
      for (int k = 0; k < kEach; ++k)
        problem.AddResidualBlock(
            new LinearTerm({Eigen::VectorXd::Ones(1), Eigen::VectorXd::Zero(3)}, measured[p]),
            &loss, &value, points[p].data());
    }
    stated += reduced_covariance(problem, {&value}, free, pool).variance[0] / kRepetitions;
    squares += value * value / kRepetitions;
  }
  EXPECT_NEAR(std::sqrt(stated / squares), 1, 0.12)
      << "400 repetitions measure a standard deviation to 3.5 %";
}

// Residuals that happen to agree, as with few points, do not lower the variance. Unmeasured
// parameters have one of 1e12.
TEST(ReducedCovariance, IsNoLessThanThatOfIndependentResiduals) {
  ThreadPool pool(2);
  std::array<double, 2> value{};
  std::array<double, 3> point{};
  ceres::Problem problem;
  for (int k = 0; k < 4; ++k)
    problem.AddResidualBlock(new LinearTerm({Eigen::Vector2d(0.5, 0), Eigen::VectorXd::Zero(3)}, 0),
                             nullptr, value.data(), point.data());
  const ReducedCovariance covariance =
      reduced_covariance(problem, {value.data()}, {point.data()}, pool);
  EXPECT_NEAR(covariance.variance[0], 1, 1e-9);
  EXPECT_GT(covariance.variance[1], 1e11);
}

}  // namespace
}  // namespace redrive
