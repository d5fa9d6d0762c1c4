// SPDX-License-Identifier: Apache-2.0
#include "redrive/base/files/files.h"
#include "redrive/recording/formats/kitti/kitti.h"
#include "redrive/recording/formats/kitti/kitti_testing.h"
#include "redrive/recording/formats/recording_reader.h"

namespace redrive {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using testing::input_error;

/// Sequence 0003 of three frames at 10 m/s to the north, with one packet more; keys of the
/// calibration as the benchmark writes them, some without a colon.
class KittiTracking : public ::testing::Test {
 protected:
  KittiTracking() {
    folder_.write("training/calib/0003.txt",
                  "P0: 720 0 600 0 0 720 180 0 0 0 1 0\n"
                  "P2: 720 0 600 43.2 0 720 180 0 0 0 1 0\n"
                  "R_rect 1 0 0 0 1 0 0 0 1\n"
                  "Tr_velo_cam 0 -1 0 0 0 0 -1 -0.08 1 0 0 -0.25\n"
                  "Tr_imu_velo 1 0 0 -0.81 0 1 0 0.32 0 0 1 -0.8\n");
    std::string packets;
    for (int f = 0; f < 4; ++f) packets += testing::kitti_oxts(f);
    folder_.write("training/oxts/0003.txt", packets);
    for (const std::string name : {"000000", "000001", "000002"}) {
      folder_.write("training/image_02/0003/" + name + ".png", testing::png_head(1242, 375));
      folder_.write("training/velodyne/0003/" + name + ".bin",
                    testing::kitti_scan({{10, 0, 0, 1}, {0, 10, 0, 0.5f}}));
    }
    folder_.write("training/label_02/0003.txt", testing::kitti_label(1, 7, "Car", 12));
  }
  Recording opened(const std::string& below = "") const {
    return open_recording(folder_.path / "training" / below);
  }

  TemporaryFolder folder_;
};

TEST_F(KittiTracking, OpensASequence) {
  for (const char* below : {"", "0003", "image_02/0003"}) {
    const Recording recording = opened(below);
    EXPECT_EQ(recording.format, "kitti-tracking") << below;
    EXPECT_EQ(recording.frames.size(), 3u);
    ASSERT_EQ(recording.cameras.size(), 1u);
    EXPECT_EQ(recording.cameras[0].calibration.name, "image_02");
    EXPECT_EQ(recording.cameras[0].images.size(), 3u);
    EXPECT_EQ(recording.frames[2].t_ns, 200'000'000);
  }
}

// The same car and numbers as of the raw drive in kitti_testing.h.
TEST_F(KittiTracking, IsMountedAsARawDrive) {
  testing::write_kitti_drive(folder_);
  const Recording raw = open_recording(folder_.path / testing::kKittiDrive), recording = opened();
  EXPECT_TRUE(recording.cameras[0].calibration.body_from_sensor.isApprox(
      raw.cameras[1].calibration.body_from_sensor, 1e-12));
  EXPECT_TRUE(recording.lidars[0].body_from_lidar.isApprox(raw.lidars[0].body_from_lidar, 1e-12));
  // Frame 2 of the raw drive has its images' poses, 8 ms before the packets.
  EXPECT_NEAR((recording.frames[2].global_from_body.translation() -
               raw.frames[0].global_from_body.translation())
                  .norm(),
              0.08, 0.02);
}

TEST_F(KittiTracking, ReadsScansAndBoxes) {
  const Recording recording = opened();
  ASSERT_EQ(recording.lidar_files.size(), 3u);
  const auto points = recording.reader->read_lidar(recording.lidar_files[1]);
  ASSERT_EQ(points.size(), 2u);
  EXPECT_NEAR(double(points[1].t_ns), 100e6, 0.1e6) << "ahead: the middle of the revolution";
  EXPECT_NEAR(double(points[0].t_ns), 75e6, 0.1e6) << "to the left: a quarter earlier";
  ASSERT_EQ(recording.box_files.size(), 1u);
  const std::vector<Box> boxes = recording.reader->read_boxes(recording.box_files[0]);
  ASSERT_EQ(boxes.size(), 1u);
  EXPECT_EQ(boxes[0].object_id, 7);
}

TEST_F(KittiTracking, NamesWhatIsMissing) {
  folder_.write("training/image_02/0004/000000.png", testing::png_head(1242, 375));
  EXPECT_THAT(input_error([&] { opened(); }),
              AllOf(HasSubstr("sequences with images = 2"), HasSubstr("training/0003"),
                    HasSubstr("0003, 0004")));
  EXPECT_THAT(input_error([&] { opened("0004"); }), HasSubstr("calib/0004.txt"));
  folder_.write("training/calib/0004.txt", "P2: 50 0 40 0 0 50 30 0 0 0 1 0\n");
  EXPECT_THAT(input_error([&] { opened("0004"); }),
              AllOf(HasSubstr("0004.txt: R_rect: missing"), HasSubstr("tracking benchmark")));
  fs::copy_file(folder_.path / "training/calib/0003.txt", folder_.path / "training/calib/0004.txt",
                fs::copy_options::overwrite_existing);
  EXPECT_THAT(input_error([&] { opened("0004"); }), HasSubstr("oxts/0004.txt: missing"));
  fs::remove_all(folder_.path / "training/label_02");
  fs::remove_all(folder_.path / "training/velodyne");
  EXPECT_TRUE(opened("0003").box_files.empty());
}

}  // namespace
}  // namespace redrive
