// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align.h"

#include <cmath>
#include <functional>
#include <string>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/base/files/temporary_folder_testing.h"
#include "redrive/recording/formats/aimotive/aimotive.h"
#include "redrive/recording/lidar/las.h"
#include "redrive/scene/scene_testing.h"

namespace redrive {
namespace {

using ::testing::HasSubstr;
using ::testing::SizeIs;

/// A recording of frames 10 to 15 with a scan of 40 returns at (20, 5, 1) for each. `change`:
/// changes the bytes of the file of a frame.
Recording with_scans(const TemporaryFolder& folder,
                     const std::function<void(std::int64_t, std::string*)>& change = {}) {
  Recording recording = make_test_recording(folder.path);
  recording.reader = aimotive::make_reader(recording.frames);
  recording.lidars = {{"lidar", Rigid3d(Eigen::Translation3d(1, 0, 1.8))}};
  for (const FramePose& frame : recording.frames) {
    std::string bytes = make_las(std::vector<LidarRecord>(40, {{20, 5, 1}, frame.t_ns, 7}));
    if (change) change(frame.id, &bytes);
    const std::filesystem::path file = folder.path / (std::to_string(frame.id) + ".las");
    write_file(file, bytes);
    recording.lidar_files.push_back({frame.id, file});
  }
  return recording;
}

// Heads and ends are right, so only decoding finds the damage.
TEST(LoadAlignSamples, NamesScansThatAreFoundDamagedWhenTheyAreDecoded) {
  const TemporaryFolder folder;
  const Recording recording = with_scans(folder, [](std::int64_t id, std::string* bytes) {
    if (id == 12) (*bytes)[105] = 20;  // a record's length, which format 1 contradicts
  });
  ThreadPool pool(1);
  std::vector<Finding> damaged;
  EXPECT_FALSE(load_align_samples(recording, {}, pool, &damaged).empty());
  ASSERT_THAT(damaged, SizeIs(1));
  EXPECT_EQ(damaged[0].subject, "lidar");
  EXPECT_THAT(damaged[0].what, HasSubstr("1 of 6 records left out: frame 12: "));
}

TEST(LoadAlignSamples, CorrectsElevationsOfTheCalibration) {
  const TemporaryFolder folder;
  Recording recording = with_scans(folder);
  recording.lidars[0].elevation_rad = 0.003;
  ThreadPool pool(1);
  const std::vector<LidarSample> samples = load_align_samples(recording, {}, pool);
  ASSERT_FALSE(samples.empty());
  const Eigen::Vector3d in_lidar = samples[0].in_body - Eigen::Vector3d(1, 0, 1.8),
                        before(19, 5, -0.8);
  EXPECT_NEAR(in_lidar.norm(), before.norm(), 1e-5);
  EXPECT_NEAR(std::asin(in_lidar.z() / in_lidar.norm()),
              std::asin(before.z() / before.norm()) + 0.003, 1e-6);
  EXPECT_NEAR(std::atan2(in_lidar.y(), in_lidar.x()), std::atan2(before.y(), before.x()), 1e-6);
}

}  // namespace
}  // namespace redrive
