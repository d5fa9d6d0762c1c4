// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/tracks/tracks.h"
#include "redrive/image/image_io.h"

#include <set>

#include <gtest/gtest.h>

#include "redrive/align/textured_drive_testing.h"
#include "redrive/align/tracks/triangulate.h"

namespace redrive {
namespace {

constexpr int kFrames = 8;

std::vector<Track> tracks_in(const Recording& recording, ThreadPool& pool,
                             const TrackOptions& options = {}) {
  return find_tracks(load_track_images(recording, pool, options), pool, options);
}

/// One drive for all tests, since ray casting is slow.
class Tracks : public ::testing::Test {
 protected:
  static const Recording& drive() {
    static const TemporaryFolder folder;
    static const Recording recording = make_test_drive(folder.path, kFrames);
    return recording;
  }

  static const std::vector<Track>& tracks_of_drive() {
    static const std::vector<Track> tracks = [] {
      ThreadPool pool(2);
      return tracks_in(drive(), pool);
    }();
    return tracks;
  }

  /// Distances in pixels of all observations in `camera` from the true projection of the point that
  /// the track's first observation shows.
  static std::vector<double> errors(const std::vector<Track>& tracks, int camera,
                                    bool of_other_cameras) {
    std::vector<double> all;
    std::vector<Camera> cameras;
    for (const RecordedCamera& c : drive().cameras) cameras.push_back(make_camera(c.calibration));
    const auto pose = [&](const Observation& o) {
      return world_from_camera_at(drive(), Rigid3d::Identity(), o.camera, o.frame);
    };
    for (const Track& track : tracks) {
      const Observation& first = track.seen.front();
      const Eigen::Vector3d ray = *cameras[first.camera].unproject(first.pixel);
      const Eigen::Vector3d point =
          hit_street(pose(first).translation(), pose(first).linear() * ray);
      for (const Observation& o : track.seen) {
        if (o.camera != camera || (o.camera != first.camera) != of_other_cameras) continue;
        const auto residual = reprojection_residual(point, o, pose(o), cameras[camera]);
        all.push_back(residual ? residual->norm() : 1e3);
      }
    }
    std::ranges::sort(all);
    return all;
  }

  static int joined(const std::vector<Track>& tracks) {
    return static_cast<int>(std::ranges::count_if(tracks, [](const Track& track) {
      return std::ranges::any_of(track.seen,
                                 [&](const auto& o) { return o.camera != track.seen[0].camera; });
    }));
  }

  ThreadPool pool_{2};
};

TEST_F(Tracks, FollowPointsWithinATenthOfAPixel) {
  const std::vector<Track>& tracks = tracks_of_drive();
  for (const int camera : {0, 1}) {
    const std::vector<double> e = errors(tracks, camera, false);
    ASSERT_GT(e.size(), 2000u) << camera;
    EXPECT_LT(e[e.size() / 2], 0.1) << camera;
    EXPECT_LT(e[e.size() * 9 / 10], 0.3) << camera;
  }
  for (const Track& track : tracks) {
    std::set<std::pair<int, int>> images;
    for (const Observation& o : track.seen) images.insert({o.camera, o.frame});
    EXPECT_EQ(images.size(), track.seen.size());  // at most one observation per image
    EXPECT_GE(track.seen.size(), 3u);
  }
}

TEST_F(Tracks, MatchPointsAcrossCameras) {
  const std::vector<Track>& tracks = tracks_of_drive();
  EXPECT_GT(joined(tracks), 100);
  const std::vector<double> e =
      errors(tracks, 0, true);  // FRONT's points: FISHEYE's are too coarse for FRONT
  ASSERT_GT(e.size(), 200u);
  EXPECT_LT(e[e.size() / 2], 0.2);
  EXPECT_LT(e[e.size() * 9 / 10], 0.6);
}

TEST_F(Tracks, AreInsensitiveToErrorsOfPosesAndCalibration) {
  Recording wrong = drive();
  Rigid3d& extrinsics = wrong.cameras[0].calibration.body_from_sensor;
  extrinsics.rotate(Eigen::AngleAxisd(0.0175, Eigen::Vector3d(1, 2, -1).normalized()));
  extrinsics.translation() += Eigen::Vector3d(0.3, -0.3, 0.2);
  wrong.cameras[0].calibration.time_offset_ns = 0;
  for (int n = 0; n < kFrames; ++n)
    wrong.frames[n].global_from_body.translate(
        0.1 * Eigen::Vector3d(std::sin(5 * n), std::cos(7 * n), std::sin(3 * n)));
  const std::vector<Track> tracks = tracks_in(wrong, pool_);
  EXPECT_GT(joined(tracks), 100);
  for (const auto& [camera, other] : {std::pair(0, false), {0, true}, {1, false}}) {
    const std::vector<double> e = errors(tracks, camera, other);
    ASSERT_GT(e.size(), 100u) << camera << other;
    EXPECT_LT(e[e.size() / 2], 0.2) << camera << other;
    EXPECT_LT(e[e.size() * 9 / 10], 0.7) << camera << other;
  }
}

TEST_F(Tracks, DoNotDependOnTheNumberOfThreads) {
  ThreadPool one(1);
  const std::vector<Track>& a = tracks_of_drive();
  const std::vector<Track> b = tracks_in(drive(), one);
  ASSERT_EQ(a.size(), b.size());
  for (std::size_t t = 0; t < a.size(); ++t) {
    ASSERT_EQ(a[t].seen.size(), b[t].seen.size());
    for (std::size_t i = 0; i < a[t].seen.size(); ++i)
      EXPECT_EQ(a[t].seen[i].pixel, b[t].seen[i].pixel);
  }
}

TEST_F(Tracks, AvoidMaskedPixels) {
  const TemporaryFolder masks;
  Image8 mask{200, 140, std::vector<std::uint8_t>(3 * 200 * 140, 255)};
  for (int y = 0; y < 140; ++y) std::fill_n(&mask.rgb[3 * 200 * y], 3 * 100, 0);  // the left half
  write_image(masks.path / "FRONT.png", mask);
  const std::vector<Track> tracks = tracks_in(drive(), pool_, {.masks = masks.path});
  int right = 0;
  for (const Track& track : tracks)
    for (const Observation& o : track.seen)
      if (o.camera == 1) {
        EXPECT_GE(o.pixel.x(), 100);
        ++right;
      }
  EXPECT_GT(right, 100);
}

TEST_F(Tracks, NeedTexture) {
  const TemporaryFolder folder;
  EXPECT_TRUE(tracks_in(make_test_drive(folder.path, 3, false), pool_).empty());
}

TEST_F(Tracks, NeedTwoImages) {
  Recording one = drive();
  one.frames.resize(1);
  one.cameras.resize(1);
  one.cameras[0].images.resize(1);
  EXPECT_TRUE(tracks_in(one, pool_).empty());
}

TEST(StreetTracks, AgreeWithGroundTruth) {
  Recording recording = open_recording(REDRIVE_SAMPLES "/street");
  const Recording ground_truth =
      open_recording(REDRIVE_SAMPLES "/street", PoseSource::kGroundTruth);
  recording.frames.resize(6);
  for (RecordedCamera& camera : recording.cameras) camera.images.resize(6);
  ThreadPool pool(2);
  const std::vector<Track> tracks = tracks_in(recording, pool);
  std::vector<Camera> cameras;
  for (const RecordedCamera& c : ground_truth.cameras)
    cameras.push_back(make_camera(c.calibration));
  std::vector<std::vector<double>> errors(cameras.size());
  int joined = 0;
  for (const Track& track : tracks) {
    std::vector<Rigid3d> poses;
    for (const Observation& o : track.seen)
      poses.push_back(world_from_camera_at(
          ground_truth, ground_truth.frames[0].global_from_body.inverse(), o.camera, o.frame));
    joined += track.seen.front().camera != track.seen.back().camera;
    if (const auto point = triangulate(track, poses, cameras))
      for (std::size_t i = 0; i < poses.size(); ++i) {
        const int c = track.seen[i].camera;
        const auto residual = reprojection_residual(*point, track.seen[i], poses[i], cameras[c]);
        errors[c].push_back(residual ? residual->norm() : 1e3);
      }
  }
  EXPECT_GT(joined, 100);
  for (std::vector<double>& e : errors) {
    ASSERT_GT(e.size(), 1000u);
    std::ranges::sort(e);
    EXPECT_LT(e[e.size() / 2], 0.12);
    EXPECT_LT(e[e.size() * 9 / 10], 0.3);
  }
}

}  // namespace
}  // namespace redrive
