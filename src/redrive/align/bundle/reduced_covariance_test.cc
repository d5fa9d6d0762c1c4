// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/reduced_covariance.h"

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

/// Adds a term of a number and a landmark, of which it measures the number alone.
void add_measurement(int number, int landmark, double value, const ceres::LossFunction* loss,
                     int group, LeastSquares* problem) {
  problem->add(
      {.cost = std::make_unique<LinearTerm>(
           std::vector<Eigen::VectorXd>{Eigen::VectorXd::Ones(1), Eigen::VectorXd::Zero(3)}, value),
       .loss = loss,
       .blocks = {number, LeastSquares::kOwnLandmark},
       .landmark = landmark,
       .group = group});
}

Eigen::VectorXd random_vector(testing::SyntheticNoise* noise, int size) {
  Eigen::VectorXd v(size);
  for (double& x : v) x = noise->normal();
  return v;
}

// Two blocks of the rig and four landmarks: compares with the block of the inverse of the normal
// matrix of all 17 parameters.
TEST(ReducedCovariance, EqualsTheBlockOfTheFullInverse) {
  ThreadPool pool(2);
  testing::SyntheticNoise noise(21);
  std::array<double, 2> first{};
  std::array<double, 3> second{};
  LeastSquares problem(pool);
  const int of_first = problem.add_block(first.data(), 2),
            of_second = problem.add_block(second.data(), 3);
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(17, 17);
  for (int point = 0; point < 4; ++point) {
    problem.add_landmark({});
    for (int row = 0; row < 8; ++row) {
      const std::vector<Eigen::VectorXd> a{random_vector(&noise, 2), random_vector(&noise, 3),
                                           random_vector(&noise, 3)};
      problem.add({.cost = std::make_unique<LinearTerm>(a, noise.normal()),
                   .blocks = {of_first, of_second, LeastSquares::kOwnLandmark},
                   .landmark = point});
      Eigen::VectorXd all = Eigen::VectorXd::Zero(17);
      all << a[0], a[1], Eigen::VectorXd::Zero(12);
      all.segment<3>(5 + 3 * point) = a[2];
      normal += all * all.transpose();
    }
  }
  const ReducedCovariance covariance = reduced_covariance(&problem, pool);
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
    LeastSquares problem(pool);
    const int number = problem.add_block(&value, 1);
    for (int p = 0; p < kPoints; ++p) {
      const int landmark = problem.add_landmark({});
      for (int k = 0; k < kEach; ++k)
        add_measurement(number, landmark, errors[p], nullptr, -1, &problem);
      squares += errors[p] * errors[p];
    }
    if (known_before)
      problem.add({.cost = std::make_unique<LinearTerm>(
                       std::vector<Eigen::VectorXd>{Eigen::VectorXd::Ones(1)}, 0),
                   .blocks = {number}});
    const ReducedCovariance covariance = reduced_covariance(&problem, pool);
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
  const double n = kPoints * kGroups;
  for (const bool grouped : {true, false}) {
    LeastSquares problem(pool);
    const int number = problem.add_block(&value, 1);
    for (int p = 0; p < kPoints; ++p) {
      const int landmark = problem.add_landmark({});
      for (int group = 0; group < kGroups; ++group)
        add_measurement(number, landmark, errors[group], nullptr, grouped ? group : -1, &problem);
    }
    EXPECT_NEAR(reduced_covariance(&problem, pool).variance[0],
                grouped ? kPoints * kPoints * errors.squaredNorm() / (n * n) : 1 / n, 1e-12);
  }
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
    LeastSquares problem(pool);
    const int number = problem.add_block(&value, 1);
    for (const double x : measured) {
      const int landmark = problem.add_landmark({});
      for (int k = 0; k < kEach; ++k) add_measurement(number, landmark, x, &loss, -1, &problem);
    }
    stated += reduced_covariance(&problem, pool).variance[0] / kRepetitions;
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
  LeastSquares problem(pool);
  const int block = problem.add_block(value.data(), 2), landmark = problem.add_landmark({});
  for (int k = 0; k < 4; ++k)
    problem.add(
        {.cost = std::make_unique<LinearTerm>(
             std::vector<Eigen::VectorXd>{Eigen::Vector2d(0.5, 0), Eigen::VectorXd::Zero(3)}, 0),
         .blocks = {block, LeastSquares::kOwnLandmark},
         .landmark = landmark});
  const ReducedCovariance covariance = reduced_covariance(&problem, pool);
  EXPECT_NEAR(covariance.variance[0], 1, 1e-9);
  EXPECT_GT(covariance.variance[1], 1e11);
}

}  // namespace
}  // namespace redrive
