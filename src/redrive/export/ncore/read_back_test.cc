// SPDX-License-Identifier: Apache-2.0
// Sequences of NCore that were written, as the program's reader of recordings opens them.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "redrive/base/files/files.h"
#include "redrive/export/made_drive_testing.h"

namespace redrive {
namespace {

class ReadNcoreBack : public MadeDrive {
 protected:
  ReadNcoreBack() {
    recording_.cameras[1].calibration.readout_ns = 32'000'000;
    for (FramePose& frame : recording_.frames) frame.t_ns += kBegin_ns;
    make_reader();
    reader_->has_ring = true;
    std::filesystem::create_directories(out_);
    write_ncore(out_, drive(), pool_, stop_);
    read_ = open_recording(out_);
  }
  Rigid3d global_from_body(std::int64_t t_ns) const { return pose_at(recording_.frames, t_ns); }

  static constexpr std::int64_t kBegin_ns = 1'600'000'000'000'000'000;
  static constexpr double kMicrosecond_m = 1e-4;  ///< way of the car, far from ECEF's origin
  Recording read_;
};

TEST_F(ReadNcoreBack, CamerasAndPoses) {
  EXPECT_EQ(read_.global_frame, recording_.global_frame);
  ASSERT_EQ(read_.cameras.size(), 2u);
  for (std::size_t c = 0; c < 2; ++c) {
    const RecordedCamera &was = recording_.cameras[c], &is = read_.cameras[c];
    EXPECT_EQ(is.calibration.name, was.calibration.name);
    ASSERT_EQ(is.images.size(), was.images.size());
    EXPECT_TRUE(is.calibration.body_from_sensor.isApprox(was.calibration.body_from_sensor, 1e-12));
    EXPECT_NEAR(double(is.calibration.readout_ns), double(was.calibration.readout_ns), 2000);
    for (std::size_t i = 0; i < is.images.size(); ++i) {
      const auto time_of = [i](const Recording& recording, const RecordedCamera& camera) {
        const auto frame =
            std::ranges::find(recording.frames, camera.images[i].frame_id, &FramePose::id);
        return frame->t_ns + camera.calibration.time_offset_ns;
      };
      const std::int64_t t_ns = time_of(recording_, was);
      EXPECT_NEAR(double(time_of(read_, is) - t_ns), 0, 1000);
      EXPECT_LT(
          (pose_at(read_.frames, t_ns).translation() - global_from_body(t_ns).translation()).norm(),
          kMicrosecond_m);
    }
  }
  // The pinhole is NCore's, its images are the recorded files; the other is resampled.
  const RecordedCamera &was = recording_.cameras[1], &is = read_.cameras[1];
  EXPECT_EQ(is.calibration.model, was.calibration.model);
  EXPECT_EQ(is.calibration.parameters, was.calibration.parameters);
  EXPECT_EQ(read_file(is.images[0].path), read_file(was.images[0].path));
  EXPECT_EQ(read_.cameras[0].calibration.model, "opencv_fisheye");
  EXPECT_FALSE(read_.cameras[0].images[0].mask.path.empty());
}

TEST_F(ReadNcoreBack, ScansAndBoxes) {
  ASSERT_EQ(read_.lidar_files.size(), recording_.lidar_files.size());
  for (std::size_t f = 0; f < read_.lidar_files.size(); ++f) {
    const auto was = recording_.read_lidar(recording_.lidar_files[f]),
               is = read_.read_lidar(read_.lidar_files[f]);
    ASSERT_EQ(is.size(), was.size());
    for (std::size_t i = 0; i < is.size(); ++i) {
      EXPECT_LT((is[i].in_body_m - was[i].in_body_m).norm(), 5e-6f);
      EXPECT_EQ(is[i].ring, 0) << "the row of the only beam";
      EXPECT_NEAR(double(is[i].t_ns - was[i].t_ns), 0, 1000);
      EXPECT_EQ(is[i].intensity, 257 * was[i].intensity) << "16 bits of 8";
    }
  }
  ASSERT_EQ(read_.box_files.size(), recording_.box_files.size());
  for (std::size_t f = 0; f < read_.box_files.size(); ++f) {
    std::vector<Box> was = recording_.reader->read_boxes(recording_.box_files[f]),
                     is = read_.reader->read_boxes(read_.box_files[f]);
    ASSERT_EQ(is.size(), was.size());
    for (std::size_t i = 0; i < is.size(); ++i) {
      EXPECT_EQ(is[i].size_m, was[i].size_m);
      EXPECT_LT((global_from_body(was[i].t_ns) * was[i].body_from_box.translation() -
                 pose_at(read_.frames, is[i].t_ns) * is[i].body_from_box.translation())
                    .norm(),
                kMicrosecond_m);
    }
  }
}

}  // namespace
}  // namespace redrive
