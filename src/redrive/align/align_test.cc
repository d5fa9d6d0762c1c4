// SPDX-License-Identifier: Apache-2.0
#include "redrive/align/align.h"

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

// Heads and ends are right, so only decoding finds the damage.
TEST(LoadAlignSamples, NamesScansThatAreFoundDamagedWhenTheyAreDecoded) {
  const TemporaryFolder folder;
  Recording recording = make_test_recording(folder.path);  // frames 10..15
  recording.reader = aimotive::make_reader(recording.frames);
  recording.body_from_lidar = Rigid3d(Eigen::Translation3d(1, 0, 1.8));
  for (const FramePose& frame : recording.frames) {
    std::string bytes = make_las(std::vector<LidarRecord>(40, {{20, 5, 1}, frame.t_ns, 7}));
    if (frame.id == 12) bytes[105] = 20;  // a record's length, which format 1 contradicts
    const std::filesystem::path file = folder.path / (std::to_string(frame.id) + ".las");
    write_file(file, bytes);
    recording.lidar_files.push_back({frame.id, file});
  }
  ThreadPool pool(1);
  std::vector<Finding> damaged;
  EXPECT_FALSE(load_align_samples(recording, {}, pool, &damaged).empty());
  ASSERT_THAT(damaged, SizeIs(1));
  EXPECT_EQ(damaged[0].subject, "lidar");
  EXPECT_THAT(damaged[0].what, HasSubstr("1 of 6 records left out: frame 12: "));
}

}  // namespace
}  // namespace redrive
