// SPDX-License-Identifier: Apache-2.0
// Moving objects of recorded drives, found without their annotations and compared with these; real
// drives are skipped where they are missing.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "redrive/perception/find_moving.h"
#include "redrive/perception/masks.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

struct Comparison {
  std::vector<MovingObject> found;
  std::size_t annotated = 0, of_these_found = 0;  ///< pixels of all images
  std::size_t found_alone = 0, pixels = 0;
  double recall() const { return double(of_these_found) / double(annotated); }
  double wrong() const { return double(found_alone) / double(pixels); }
};

Comparison compare(const std::filesystem::path& root, PoseSource source) {
  const Recording recording = open_recording(root, source);
  SceneOptions options;
  options.downscale = std::max(1, recording.cameras[0].calibration.width / 400);
  const Scene scene = make_scene(recording, options);
  ThreadPool pool(2);
  const MovingObjects annotated = read_moving_objects(recording, scene), none;
  const LidarReturns returns = load_lidar_returns(recording, scene, none, pool);
  Comparison out;
  out.found = find_moving_objects(scene, returns, none, pool);
  const MovingObjects found(out.found);
  for (const View& view : scene.views) {
    const auto a = object_map(scene, view, annotated), b = object_map(scene, view, found);
    for (std::size_t i = 0; i < a.size(); ++i) {
      out.annotated += a[i] != 0;
      out.of_these_found += a[i] != 0 && b[i] != 0;
      out.found_alone += a[i] == 0 && b[i] != 0;
    }
    out.pixels += a.size();
  }
  std::printf("%s: %zu found; %.1f %% of the annotated pixels, %.2f %% of the others\n",
              root.filename().c_str(), out.found.size(), 100 * out.recall(), 100 * out.wrong());
  for (const MovingObject& object : out.found) {
    const auto &first = object.keys.front(), &last = object.keys.back();
    const Eigen::Vector3d from = first.world_from_box.translation(),
                          to = last.world_from_box.translation();
    std::printf("  %lld: %.1f x %.1f x %.1f m, %zu keys in %.1f s, %.1f m from %.1f %.1f %.1f\n",
                static_cast<long long>(object.id), object.size_m.x(), object.size_m.y(),
                object.size_m.z(), object.keys.size(), 1e-9 * double(last.t_ns - first.t_ns),
                (to - from).norm(), from.x(), from.y(), from.z());
  }
  std::fflush(stdout);
  return out;
}

TEST(FindMovingStreet, NothingMovesInTheStreet) {
  for (const PoseSource source : {PoseSource::kRecorded, PoseSource::kGroundTruth})
    EXPECT_TRUE(compare(REDRIVE_SAMPLES "/street", source).found.empty());
}

TEST(FindMovingStreet, FindsTheTrafficWithoutItsBoxes) {
  for (const PoseSource source : {PoseSource::kRecorded, PoseSource::kGroundTruth}) {
    const Comparison found = compare(REDRIVE_SAMPLES "/street_traffic", source);
    EXPECT_LE(found.found.size(), 2u) << "the parked car stays";
    EXPECT_GT(found.recall(), 0.4) << "the LiDAR has 16 beams";
    EXPECT_LT(found.wrong(), 0.005);
  }
}

TEST(FindMovingStreet, FindsNothingBesideTheBoxes) {
  const Recording recording = open_recording(REDRIVE_SAMPLES "/street_traffic");
  const Scene scene = make_scene(recording, {});
  ThreadPool pool(2);
  const MovingObjects annotated = read_moving_objects(recording, scene);
  const LidarReturns rest = load_lidar_returns(recording, scene, annotated, pool);
  EXPECT_TRUE(find_moving_objects(scene, rest, annotated, pool).empty());
}

std::string real_drive(const std::string& name) { return REDRIVE_SHARED "/data/" + name; }

TEST(RealDrives, FindsTheTwoCarsAhead) {
  const std::string root = real_drive("kitti/2011_09_26/2011_09_26_drive_0013_sync");
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  const Comparison found = compare(root, PoseSource::kRecorded);
  EXPECT_GT(found.recall(), 0.9);
  EXPECT_LT(found.wrong(), 0.05) << "margins of boxes";
}

TEST(RealDrives, FindsTwoCyclists) {
  const std::string root = real_drive("kitti/2011_09_26/2011_09_26_drive_0002_sync");
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  const Comparison found = compare(root, PoseSource::kRecorded);
  EXPECT_EQ(found.found.size(), 2u);
}

TEST(RealDrives, FindsVehiclesAtNight) {
  const std::string root = real_drive("aimotive_night");
  if (!std::filesystem::exists(root)) GTEST_SKIP() << root << " is not here";
  const Comparison found = compare(root, PoseSource::kRecorded);
  EXPECT_GT(found.recall(), 0.8);
  EXPECT_LT(found.wrong(), 0.03);
}

}  // namespace
}  // namespace redrive
