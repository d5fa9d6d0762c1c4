// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/windows.h"

#include <cmath>

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <Eigen/Eigenvalues>

#include "redrive/align/bundle/synthetic_rig_testing.h"
#include "redrive/align/textured_drive_testing.h"
#include "redrive/base/error.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using testing::make_synthetic_rig;
using testing::SyntheticRig;

TEST(CutWindows, CoverAllFramesAndOverlapByAFifth) {
  for (const int most : {10, 25, 150})
    for (int frames = 1; frames < 1000; frames += 7) {
      const std::vector<FrameWindow> windows = cut_windows(frames, most);
      EXPECT_EQ(windows.front().begin, 0);
      EXPECT_EQ(windows.back().end, frames);
      EXPECT_EQ(windows.size() == 1, frames <= most);
      for (std::size_t k = 0; k < windows.size(); ++k) {
        EXPECT_LE(windows[k].size(), most);
        if (k > 0) {
          EXPECT_EQ(windows[k - 1].end - windows[k].begin, most / 5);
        }
        if (k > 1) {
          EXPECT_LE(windows[k - 2].end, windows[k].begin) << "a frame is in two windows at most";
        }
      }
    }
}

TEST(JoinTrajectories, TheLargerCovarianceBoundsBothInEveryDirection) {
  Vector6d a, b;
  a << 1, 4, 9, 1e-6, 4e-6, 9e-6;
  b << 2, 3, 9, 5e-6, 1e-6, 1e-8;
  EXPECT_TRUE(larger_covariance(a.asDiagonal(), b.asDiagonal())
                  .isApprox(Matrix6d(a.cwiseMax(b).asDiagonal()), 1e-12));
  EXPECT_TRUE(larger_covariance(Matrix6d::Zero(), b.asDiagonal()).isZero(0));
  Matrix6d mix;
  for (int i = 0; i < 36; ++i) mix(i) = std::sin(1.0 + i);  // a fixed invertible matrix
  const Matrix6d c = mix * b.asDiagonal() * mix.transpose(),
                 larger = larger_covariance(a.asDiagonal(), c);
  for (const Matrix6d& one : {Matrix6d(a.asDiagonal()), c}) {
    const Eigen::SelfAdjointEigenSolver<Matrix6d> more(larger - one);
    EXPECT_GT(more.eigenvalues().minCoeff(), -1e-9);
  }
}

// Frames a metre apart whose errors are independent, of 0.02 m and 0.001 rad; the robust covariance
// is four times the other.
TEST(JoinTrajectories, VariancesAreThoseOfTheLargerCovariance) {
  const auto variance_of = [](double of_matrix, double of_robust, int overlap) {
    std::vector<WindowTrajectory> windows;
    for (const FrameWindow& frames : {FrameWindow{0, 20 + overlap}, FrameWindow{20, 40}}) {
      std::vector<FramePose> poses;
      for (int f = frames.begin; f < frames.end; ++f)
        poses.push_back({f, 100'000'000ll * f, Rigid3d(Eigen::Translation3d(f, 0, 0))});
      const int n = frames.size();
      Vector6d sigma;
      sigma << 0.02, 0.02, 0.02, 0.001, 0.001, 0.001;
      Eigen::MatrixXd covariance = Eigen::MatrixXd::Zero(6 * n, 6 * n);
      for (int i = 0; i < n; ++i) covariance.diagonal().segment<6>(6 * i) = sigma.cwiseAbs2();
      windows.push_back(window_trajectory(frames, poses, of_matrix * covariance,
                                          of_robust * covariance, frames.begin > 0 ? overlap : 0,
                                          frames.begin > 0 ? 0 : overlap, Rigid3d::Identity()));
    }
    double sum = 0;
    for (const Vector6d& variance : join_trajectories(windows, Rigid3d::Identity()).variance)
      sum += variance.head<3>().sum();
    return sum;
  };
  EXPECT_NEAR(variance_of(1, 4, 4), variance_of(4, 1, 4), 1e-9 * variance_of(1, 4, 4));
  EXPECT_NEAR(variance_of(1, 4, 4), variance_of(4, 4, 4), 1e-9 * variance_of(1, 4, 4));
  EXPECT_GT(variance_of(1, 4, 4), 2 * variance_of(1, 1, 4));
}

// Two observations of 0.1 and a prior of 0.3 about 0: weights 100, 100, 11.1.
TEST(CombineEstimates, CountsThePriorOnce) {
  const auto with_prior = [](double observed) {
    const double own = 1 / 0.01, prior = 1 / 0.09;
    return NumberEstimate{observed * own / (own + prior), 1 / std::sqrt(own + prior)};
  };
  const auto found = combine_estimates({with_prior(0.5), with_prior(0.52)}, 0.3, false, 1);
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->change, 200 * 0.51 / (200 + 1 / 0.09), 1e-12);
  EXPECT_NEAR(found->sigma, 1 / std::sqrt(200 + 1 / 0.09), 1e-12);
  // Counted twice on average, the observations weigh half as much.
  EXPECT_NEAR(combine_estimates({with_prior(0.5), with_prior(0.52)}, 0.3, false, 2)->sigma,
              1 / std::sqrt(100 + 1 / 0.09), 1e-12);
  // They disagree by 10 deviations: chi^2 is 2 (0.5 / 0.1)^2 = 50 with one degree of freedom.
  EXPECT_NEAR(combine_estimates({with_prior(0), with_prior(1)}, 0.3, false, 1)->sigma,
              1 / std::sqrt(200 / 50. + 1 / 0.09), 1e-12);
  EXPECT_FALSE(combine_estimates({}, 0.3, false, 1));
}

/// 48 frames of the synthetic street, in three windows.
struct LongDrive {
  SyntheticRig rig = make_synthetic_rig({.frames = 48, .points = 400, .lidar_points = 14'000});
  AlignOptions options = [] {
    AlignOptions o;
    o.window = 20;
    return o;
  }();

  /// Aligns a window from the tracks and LiDAR points that it has.
  AlignResult part(const FrameWindow& window, const Recording& part, const AlignOptions& by) const {
    std::vector<Track> tracks;
    for (const Track& track : rig.tracks) {
      Track inside;
      for (Observation seen : track.seen)
        if (seen.frame >= window.begin && seen.frame < window.end) {
          seen.frame -= window.begin;
          inside.seen.push_back(seen);
        }
      if (inside.seen.size() >= 2) tracks.push_back(inside);
    }
    std::vector<LidarSample> lidar;
    for (const LidarSample& sample : rig.lidar)
      if (sample.t_ns >= part.frames.front().t_ns && sample.t_ns <= part.frames.back().t_ns)
        lidar.push_back(sample);
    ThreadPool pool(2);
    return align_with(part, tracks, lidar, by, pool);
  }

  /// `put_together`: receives the first alignments of the windows, one behind the other.
  AlignResult in_windows(std::vector<FramePose>* put_together) const {
    return align_in_windows(
        rig.recording, options,
        [&](const FrameWindow& window, const Recording& of, const AlignOptions& by) {
          AlignResult aligned = part(window, of, by);
          for (const FramePose& frame : aligned.frames)
            if (put_together->empty() || frame.id > put_together->back().id)
              put_together->push_back(frame);
          return aligned;
        });
  }
};

/// Error of the motion from each frame to the next one, metres and degrees.
std::vector<Eigen::Vector2d> step_errors(const std::vector<FramePose>& frames,
                                         const std::vector<FramePose>& ground_truth) {
  std::vector<Eigen::Vector2d> errors;
  const auto step = [](const std::vector<FramePose>& of, std::size_t f) -> Rigid3d {
    return of[f - 1].global_from_body.inverse(Eigen::Isometry) * of[f].global_from_body;
  };
  for (std::size_t f = 1; f < frames.size(); ++f) {
    const Rigid3d error = step(ground_truth, f).inverse(Eigen::Isometry) * step(frames, f);
    errors.emplace_back(error.translation().norm(),
                        so3_log(error.linear()).norm() * kDegreesPerRadian);
  }
  return errors;
}

Eigen::Vector2d largest(const std::vector<Eigen::Vector2d>& errors) {
  Eigen::Vector2d most = Eigen::Vector2d::Zero();
  for (const Eigen::Vector2d& error : errors) most = most.cwiseMax(error);
  return most;
}

/// RMS of the stated deviations of poses, metres and degrees.
Eigen::Vector2d stated_rms(const AlignResult& result) {
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  for (const Correction& c : result.corrections)
    sum += Eigen::Vector2d(c.sigma.head<3>().squaredNorm(), c.sigma.tail<3>().squaredNorm());
  sum = (sum / static_cast<double>(result.corrections.size())).cwiseSqrt();
  return {sum.x(), sum.y() * kDegreesPerRadian};
}

TEST(AlignInWindows, AgreesWithOneBundleAndHasNoStepAtTheSeams) {
  const LongDrive drive;
  std::vector<FramePose> put_together;
  const AlignResult joined = drive.in_windows(&put_together);
  ThreadPool pool(2);
  const AlignResult whole =
      align_with(drive.rig.recording, drive.rig.tracks, drive.rig.lidar, drive.options, pool);
  const Eigen::Vector2d sigma = stated_rms(joined), of_whole = stated_rms(whole);
  const TrajectoryRegistration between = register_trajectories(joined.frames, whole.frames, "");
  EXPECT_LT(between.residual_m, 2 * std::hypot(sigma.x(), of_whole.x()));
  EXPECT_LT(between.residual_deg, 2 * std::hypot(sigma.y(), of_whole.y()));
  EXPECT_LT(joined.aligned_vs_ground_truth->residual_m, 3 * sigma.x());
  EXPECT_LT(joined.aligned_vs_ground_truth->residual_deg, 3 * sigma.y());
  EXPECT_LT(sigma.x(), 0.02);
  EXPECT_LT(sigma.y(), 0.03);
  ASSERT_FALSE(joined.remarks.empty());
  EXPECT_THAT(joined.remarks[0], HasSubstr("aligned in 3 windows"));
  for (std::size_t c = 0; c < joined.cameras.size(); ++c) {
    const CameraCorrection& k = joined.camera_corrections[c];
    ASSERT_TRUE(k.extrinsic_sigmas[5]) << c;
    EXPECT_NEAR(k.extrinsics[5], whole.camera_corrections[c].extrinsics[5],
                3 * *k.extrinsic_sigmas[5])
        << c;
    ASSERT_TRUE(k.offset_sigma_s) << c;
    EXPECT_NEAR(1e9 * k.offset_s, static_cast<double>(drive.rig.true_cameras[c].time_offset_ns),
                4e9 * *k.offset_sigma_s)
        << c;
  }
  EXPECT_EQ(joined.frames.size(), whole.frames.size());
  EXPECT_GT(joined.bundle.cameras[0].used, whole.bundle.cameras[0].used)
      << "those of overlaps twice";

  // Windows that are merely put one behind the other have steps of the egomotion's errors.
  const std::vector<FramePose>& exact = drive.rig.recording.ground_truth_frames;
  const Eigen::Vector2d with_steps = largest(step_errors(put_together, exact)),
                        without = largest(step_errors(joined.frames, exact));
  EXPECT_LT(without.x(), 0.4 * with_steps.x());
  EXPECT_LT(without.x(), 0.008);
  EXPECT_LT(without.y(), 0.02);
}

TEST(AlignInWindows, ReportsFramesThatDetermineNoPoses) {
  LongDrive drive;
  for (Track& track : drive.rig.tracks)
    std::erase_if(track.seen, [](const Observation& seen) { return seen.frame > 32; });
  std::erase_if(drive.rig.tracks, [](const Track& track) { return track.seen.size() < 2; });
  drive.rig.lidar.clear();
  try {
    std::vector<FramePose> unused;
    drive.in_windows(&unused);
    ADD_FAILURE() << "no InsufficientDataError";
  } catch (const InsufficientDataError& error) {
    EXPECT_THAT(error.what(), HasSubstr("frames 129:147 determine no poses"));
  }
}

// Windows of 3.6 m without LiDAR tell rotations, but no scale.
TEST(AlignInWindows, OfADriveWithImages) {
  TemporaryFolder folder;
  const Recording drive = make_test_drive(folder.path, 16);
  AlignOptions options;
  ThreadPool pool(2);
  const AlignResult whole = align(drive, options, pool);
  options.window = 10;
  const AlignResult joined = align(drive, options, pool);
  EXPECT_THAT(joined.remarks[0], HasSubstr("aligned in 2 windows of at most 10 frames"));
  ASSERT_EQ(joined.frames.size(), 16u);
  const TrajectoryRegistration between = register_trajectories(joined.frames, whole.frames, "");
  EXPECT_LT(between.residual_deg, 2 * std::hypot(stated_rms(joined).y(), stated_rms(whole).y()));
  EXPECT_GT(joined.bundle.cameras[1].used, 100);
}

}  // namespace
}  // namespace redrive
