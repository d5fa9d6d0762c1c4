// SPDX-License-Identifier: Apache-2.0
// Errors of aligned poses and cameras of the street stay within two of the stated standard
// deviations. All of one, two and four cameras, with LiDAR and without, in a minute:
//   test_samples_align --gtest_also_run_disabled_tests --gtest_filter='*StreetSigmas*'
#include <algorithm>
#include <cmath>
#include <map>

#include <gtest/gtest.h>

#include "redrive/align/align.h"
#include "redrive/align/bundle/unobservable_extrinsics.h"
#include "redrive/math/angles.h"
#include "redrive/math/so3.h"

namespace redrive {
namespace {

constexpr double kSigmas = 2;

/// The first frames of the street with their tracks and LiDAR returns.
struct Street {
  Recording recording, ground_truth;
  std::vector<Track> tracks;
  std::vector<LidarSample> lidar;

  explicit Street(std::size_t frames) {
    const std::filesystem::path root = REDRIVE_SAMPLES "/street";
    recording = open_recording(root);
    ground_truth = open_recording(root, PoseSource::kGroundTruth);
    recording.frames.resize(frames);
    const std::int64_t last_id = recording.frames.back().id;
    for (RecordedCamera& camera : recording.cameras)
      std::erase_if(camera.images,
                    [&](const ImageFile& image) { return image.frame_id > last_id; });
    std::erase_if(recording.lidar_files,
                  [&](const FrameFile& file) { return file.frame_id > last_id; });
    ThreadPool pool(2);
    tracks = find_tracks(load_track_images(recording, pool), pool);
    const Scene scene = make_scene(recording, {});
    lidar = load_lidar_samples(recording, scene, read_moving_objects(recording, scene), pool);
  }
};

const Street& street(std::size_t frames) {
  static std::map<std::size_t, Street> all;
  return all.try_emplace(frames, frames).first->second;
}

/// The tracks as the chosen cameras see them.
std::vector<Track> tracks_of(const std::vector<Track>& all, const std::vector<int>& cameras) {
  std::vector<Track> tracks;
  for (const Track& of_all : all) {
    Track track;
    for (Observation seen : of_all.seen) {
      const auto at = std::ranges::find(cameras, seen.camera);
      if (at == cameras.end()) continue;
      seen.camera = static_cast<int>(at - cameras.begin());
      track.seen.push_back(seen);
    }
    if (track.seen.size() >= 2) tracks.push_back(std::move(track));
  }
  return tracks;
}

struct Choice {
  std::size_t frames = 0;
  std::vector<int> cameras;  ///< 0, 1: front; 2: left; 3: right
  bool lidar = true;
};

class StreetSigmas : public ::testing::TestWithParam<Choice> {};

TEST_P(StreetSigmas, ErrorsAreWithinTwo) {
  const auto& [frames, cameras, with_lidar] = GetParam();
  const Street& all = street(frames);
  Recording recording = all.recording;
  recording.cameras.clear();
  for (const int c : cameras) recording.cameras.push_back(all.recording.cameras[c]);
  ThreadPool pool(2);
  const AlignResult result =
      align_with(recording, tracks_of(all.tracks, cameras),
                 with_lidar ? all.lidar : std::vector<LidarSample>(), {}, pool);
  double squares_m = 0, squares_deg = 0;
  for (const Correction& pose : result.corrections) {
    squares_m += pose.sigma.head<3>().squaredNorm() / static_cast<double>(frames);
    squares_deg +=
        (kDegreesPerRadian * pose.sigma.tail<3>()).squaredNorm() / static_cast<double>(frames);
  }
  if (with_lidar) {  // else scale and heading are the egomotion's, which sigmas exclude
    EXPECT_LT(result.aligned_vs_ground_truth->residual_m, kSigmas * std::sqrt(squares_m));
  }
  EXPECT_LT(result.aligned_vs_ground_truth->residual_deg, kSigmas * std::sqrt(squares_deg));
  int estimated = 0;
  for (std::size_t c = 0; c < cameras.size(); ++c) {
    const CameraCalibration& exact = all.ground_truth.cameras[cameras[c]].calibration;
    const CameraCorrection& camera = result.camera_corrections[c];
    SCOPED_TRACE(camera.name);
    const Rigid3d& found = result.cameras[c].body_from_sensor;
    Vector6d error;
    error << found.translation() - exact.body_from_sensor.translation(),
        so3_log(found.linear() * exact.body_from_sensor.linear().transpose());
    for (int axis = 0; axis < kExtrinsicAxes; ++axis)
      if (const auto& sigma = camera.extrinsic_sigmas[axis]) {
        ++estimated;
        EXPECT_LT(std::abs(error[axis]), kSigmas * *sigma) << extrinsic_name(axis);
      }
    if (camera.offset_sigma_s) {
      ++estimated;
      EXPECT_LT(std::abs(camera.offset_s - 1e-9 * double(exact.time_offset_ns)),
                kSigmas * *camera.offset_sigma_s)
          << "time offset";
    }
  }
  EXPECT_GT(estimated, 0);
}

INSTANTIATE_TEST_SUITE_P(Short, StreetSigmas,
                         ::testing::Values(Choice{16, {1}, true}, Choice{16, {0, 1, 2, 3}, true}));
INSTANTIATE_TEST_SUITE_P(DISABLED_All, StreetSigmas,
                         ::testing::Values(Choice{30, {1}, true}, Choice{30, {1}, false},
                                           Choice{30, {0, 1}, true}, Choice{30, {0, 1}, false},
                                           Choice{30, {0, 1, 2, 3}, true},
                                           Choice{30, {0, 1, 2, 3}, false}));

}  // namespace
}  // namespace redrive
