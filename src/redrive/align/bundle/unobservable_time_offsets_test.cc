// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/bundle/unobservable_time_offsets.h"

#include <gtest/gtest.h>

namespace redrive {
namespace {

constexpr double kPrior_s = 2e-3;

/// Clocks that moved by so much, in a covariance that begins with them.
struct Clocks {
  RigModel model;
  BundleResult result;
  std::vector<int> used;

  Clocks(const std::vector<double>& moved_s, const Eigen::MatrixXd& covariance) {
    for (std::size_t c = 0; c < moved_s.size(); ++c) {
      RigModelCamera camera;
      camera.initial.time_offset_ns = 5'000'000;
      camera.offset_s = 5e-3 + moved_s[c];
      model.cameras.push_back(camera);
      result.offset_index.push_back(static_cast<int>(c));
      used.push_back(100);
    }
    result.covariance = covariance;
    result.variance = covariance.diagonal();
  }
  std::vector<int> unobservable(bool lidar = true) const {
    std::vector<int> cameras;
    for (const UnobservableTimeOffset& clock :
         unobservable_time_offsets(model, result, used, kPrior_s, lidar))
      cameras.push_back(clock.camera);
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

// 0.99 ms are less than half of 2; 1.01 are not, unless the clock has moved by three times that.
TEST(UntoldClocks, AreThoseKnownHardlyBetterThanBefore) {
  const Clocks clocks({0, 0, 3.0e-3, 3.1e-3, -3.1e-3},
                      independent({0.99e-3, 1.01e-3, 1.01e-3, 1.01e-3, 1.01e-3}));
  EXPECT_EQ(clocks.unobservable(), (std::vector<int>{1, 2}));
  const std::vector<UnobservableTimeOffset> found =
      unobservable_time_offsets(clocks.model, clocks.result, clocks.used, kPrior_s, true);
  EXPECT_NEAR(found[1].offset_s, 8e-3, 1e-12);
  EXPECT_NEAR(found[1].sigma_s, 1.01e-3, 1e-12);
}

TEST(UntoldClocks, LeaveOutWhatTheLidarTellsAndWhatWasNotSought) {
  Clocks clocks({0, 0, 0}, independent({2e-3, 2e-3, 2e-3}));
  EXPECT_EQ(clocks.unobservable().size(), 3u);
  clocks.result.contrast.resize(3);
  clocks.result.contrast[0].observable = true;
  clocks.used[1] = 0;
  EXPECT_EQ(clocks.unobservable(), (std::vector<int>{2}));
  clocks.result.offset_index[2].reset();
  EXPECT_TRUE(clocks.unobservable().empty());
}

// All are off by the same unknown 10 ms, and the third by some of its own. The first two are known,
// against the mean of the others, to half of that.
TEST(UntoldClocks, AreToldAgainstTheOthers) {
  const Eigen::MatrixXd common = Eigen::MatrixXd::Constant(3, 3, 100e-6);
  for (const bool lidar : {false, true}) {
    EXPECT_TRUE(Clocks({-7e-3, -7e-3, -7e-3}, common + independent({0.1e-3, 0.1e-3, 0.8e-3}))
                    .unobservable(lidar)
                    .empty());
    EXPECT_EQ(Clocks({-7e-3, -7e-3, -7e-3}, common + independent({0.1e-3, 0.1e-3, 1.2e-3}))
                  .unobservable(lidar),
              (std::vector<int>{2}));
    EXPECT_TRUE(Clocks({-7e-3, -7e-3, -2e-3}, common + independent({0.1e-3, 0.1e-3, 1.2e-3}))
                    .unobservable(lidar)
                    .empty());
  }
}

TEST(UntoldClocks, OneAloneIsToldByTheLidarOrByDefinition) {
  const Clocks alone({-7e-3}, Eigen::MatrixXd::Constant(1, 1, 100e-6));
  EXPECT_EQ(alone.unobservable(true), (std::vector<int>{0}));
  EXPECT_TRUE(alone.unobservable(false).empty());
}

}  // namespace
}  // namespace redrive
