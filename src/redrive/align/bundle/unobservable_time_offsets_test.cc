// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_time_offsets.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr double kPrior_s = 2e-3;

/// A model whose time offsets were corrected by the given seconds, with their covariance.
struct TimeOffsets {
  RigModel model;
  BundleResult result;
  std::vector<int> used;

  TimeOffsets(const std::vector<double>& corrections_s, const Eigen::MatrixXd& covariance) {
    for (std::size_t c = 0; c < corrections_s.size(); ++c) {
      RigModelCamera camera;
      camera.initial.time_offset_ns = 5'000'000;
      camera.offset_s = 5e-3 + corrections_s[c];
      model.cameras.push_back(camera);
      result.offset_index.push_back(static_cast<int>(c));
      used.push_back(100);
    }
    result.covariance = covariance;
    result.variance = covariance.diagonal();
  }
  std::vector<int> unobservable(bool lidar = true) const {
    std::vector<int> cameras;
    for (const UnobservableTimeOffset& offset :
         unobservable_time_offsets(model, result, used, kPrior_s, lidar))
      cameras.push_back(offset.camera);
    return cameras;
  }
};

Eigen::MatrixXd independent(const std::vector<double>& sigmas_s) {
  return Eigen::Map<const Eigen::ArrayXd>(sigmas_s.data(),
                                          static_cast<Eigen::Index>(sigmas_s.size()))
      .square()
      .matrix()
      .asDiagonal();
}

// A sigma of 0.99 ms is less than half of the prior's 2 ms. One of 1.01 ms is not: the offset is
// observable only if its correction is three times that.
TEST(UnobservableTimeOffsets, HaveNearlyThePriorsSigma) {
  const TimeOffsets offsets({0, 0, 3.0e-3, 3.1e-3, -3.1e-3},
                            independent({0.99e-3, 1.01e-3, 1.01e-3, 1.01e-3, 1.01e-3}));
  EXPECT_EQ(offsets.unobservable(), (std::vector<int>{1, 2}));
  const std::vector<UnobservableTimeOffset> found =
      unobservable_time_offsets(offsets.model, offsets.result, offsets.used, kPrior_s, true);
  EXPECT_NEAR(found[1].offset_s, 8e-3, 1e-12);
  EXPECT_NEAR(found[1].sigma_s, 1.01e-3, 1e-12);
}

TEST(UnobservableTimeOffsets, LeaveOutOffsetsThatTheLidarObservesOrThatAreFixed) {
  TimeOffsets offsets({0, 0, 0}, independent({2e-3, 2e-3, 2e-3}));
  EXPECT_EQ(offsets.unobservable().size(), 3u);
  offsets.result.contrast.resize(3);
  offsets.result.contrast[0].observable = true;
  offsets.used[1] = 0;
  EXPECT_EQ(offsets.unobservable(), (std::vector<int>{2}));
  offsets.result.offset_index[2].reset();
  EXPECT_TRUE(offsets.unobservable().empty());
}

// All offsets share an unknown error of 10 ms, and the third has one of its own. Relative to the
// mean of the others the first two have half of the latter's sigma.
TEST(UnobservableTimeOffsets, AreMeasuredRelativeToTheOthers) {
  const Eigen::MatrixXd common = Eigen::MatrixXd::Constant(3, 3, 100e-6);
  for (const bool lidar : {false, true}) {
    EXPECT_TRUE(TimeOffsets({-7e-3, -7e-3, -7e-3}, common + independent({0.1e-3, 0.1e-3, 0.8e-3}))
                    .unobservable(lidar)
                    .empty());
    EXPECT_EQ(TimeOffsets({-7e-3, -7e-3, -7e-3}, common + independent({0.1e-3, 0.1e-3, 1.2e-3}))
                  .unobservable(lidar),
              (std::vector<int>{2}));
    EXPECT_TRUE(TimeOffsets({-7e-3, -7e-3, -2e-3}, common + independent({0.1e-3, 0.1e-3, 1.2e-3}))
                    .unobservable(lidar)
                    .empty());
  }
}

// Ties to the LiDAR's surfaces share 4 mm, which at 8 m/s are 0.5 ms; few ties do not count. A
// sigma is at most the prior's, or the correction.
TEST(UnobservableTimeOffsets, IncludeTheErrorThatTiesShare) {
  TimeOffsets offsets({0.1e-3, 0.1e-3, 0.1e-3, 7e-3}, independent({0.1e-3, 0.1e-3, 5e-3, 5e-3}));
  offsets.result.ties_of_camera = {60, 40, 60, 60};
  for (int f = 0; f < 3; ++f) {
    PosedFrame frame;
    frame.t_ns = 100'000'000 * f;
    frame.world_from_body = Eigen::Translation3d(0.8 * f, 0, 0);
    offsets.model.initial_frames.push_back(frame);
  }
  const auto sigma_s = [&](int camera) {
    return *time_offset_sigma(offsets.model, offsets.result, kPrior_s, camera);
  };
  EXPECT_NEAR(sigma_s(0), std::hypot(0.1e-3, 0.5e-3), 1e-12);
  EXPECT_NEAR(sigma_s(1), 0.1e-3, 1e-12);
  EXPECT_NEAR(sigma_s(2), kPrior_s, 1e-12);
  EXPECT_NEAR(sigma_s(3), std::hypot(5e-3, 0.5e-3), 1e-12);
  offsets.result.offset_index[0].reset();
  EXPECT_FALSE(time_offset_sigma(offsets.model, offsets.result, kPrior_s, 0));
}

TEST(UnobservableTimeOffsets, ASingleOffsetIsRelativeToTheLidarOrZeroByDefinition) {
  const TimeOffsets alone({-7e-3}, Eigen::MatrixXd::Constant(1, 1, 100e-6));
  EXPECT_EQ(alone.unobservable(true), (std::vector<int>{0}));
  EXPECT_TRUE(alone.unobservable(false).empty());
}

}  // namespace
}  // namespace redrive
