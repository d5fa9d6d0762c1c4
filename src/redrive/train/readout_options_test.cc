// SPDX-License-Identifier: Apache-2.0
// --rolling-shutter of train and align.
#include "redrive/recording/core/readout_options.h"

#include <gtest/gtest.h>

#include "redrive/base/error.h"
#include "redrive/train/files/options.h"

namespace redrive {
namespace {

TEST(ReadoutOptions, AreForAllCamerasOrForEach) {
  TrainOptions options;
  options.recording = REDRIVE_SAMPLES "/analytic";
  const auto readouts = [&](std::vector<std::string> given) {
    options.rolling_shutter = std::move(given);
    std::vector<std::int64_t> out;
    for (const RecordedCamera& camera : open_recording(options).cameras)
      out.push_back(camera.calibration.readout_ns);
    return out;
  };
  const Recording recording = open_recording(options);
  const std::size_t cameras = recording.cameras.size();
  EXPECT_EQ(readouts({}), std::vector<std::int64_t>(cameras, 0));
  EXPECT_EQ(readouts({"30"}), std::vector<std::int64_t>(cameras, 30'000'000));
  std::vector<std::int64_t> one(cameras, 0);
  one.back() = -12'500'000;
  EXPECT_EQ(readouts({recording.cameras.back().calibration.name + ":-12.5"}), one);
  EXPECT_EQ(readouts({"30", recording.cameras.back().calibration.name + ":-12.5"}).back(),
            -12'500'000);
  for (const char* wrong :
       {"", "x", "30ms", "NONE:30", "201", "nan", ":", "NONE:estimate", "estimated"})
    EXPECT_THROW(readouts({wrong}), UsageError) << wrong;
}

TEST(ReadoutOptions, AreEstimatedByAlign) {
  Recording recording = open_recording(REDRIVE_SAMPLES "/analytic");
  const std::string last = recording.cameras.back().calibration.name;
  for (RecordedCamera& camera : recording.cameras) camera.calibration.readout_ns = 20'000'000;
  const std::size_t n = recording.cameras.size();
  ASSERT_GT(n, 1u);
  EXPECT_EQ(apply_readout_options({"estimate"}, &recording), std::vector<bool>(n, true));
  EXPECT_EQ(recording.cameras[0].calibration.readout_ns, 20'000'000)
      << "the calibration's initial value";
  std::vector<bool> but_last(n, true);
  but_last.back() = false;
  EXPECT_EQ(apply_readout_options({"estimate", last + ":7"}, &recording), but_last);
  EXPECT_EQ(recording.cameras.back().calibration.readout_ns, 7'000'000);
  EXPECT_EQ(apply_readout_options({last + ":estimate"}, &recording)[n - 1], true);
  EXPECT_EQ(apply_readout_options({last + ":9", "estimate"}, &recording),
            std::vector<bool>(n, true))
      << "the last one counts";
  EXPECT_EQ(recording.cameras.back().calibration.readout_ns, 7'000'000);

  TrainOptions options;
  options.recording = REDRIVE_SAMPLES "/analytic";
  options.rolling_shutter = {"30", last + ":estimate"};
  EXPECT_THROW(validate(options), UsageError) << "without --align";
  options.align = true;
  validate(options);
}

// A readout time of --rolling-shutter overrides the one that align estimated.
TEST(ReadoutOptions, OverrideThoseOfExternalPoses) {
  TrainOptions options;
  options.recording = REDRIVE_SAMPLES "/analytic";
  options.align = true;
  Recording recording = open_recording(options);
  const std::string last = recording.cameras.back().calibration.name;
  std::vector<CameraCalibration> aligned;
  for (const RecordedCamera& camera : recording.cameras) {
    aligned.push_back(camera.calibration);
    aligned.back().readout_ns = 15'000'000;
  }
  const PoseFiles files = recording.reader->make_pose_files(recording, recording.frames, aligned);
  options.rolling_shutter = {"estimate", last + ":7"};
  use_external_poses(files, "aligned", options, &recording);
  EXPECT_EQ(recording.cameras[0].calibration.readout_ns, 15'000'000);
  EXPECT_EQ(recording.cameras.back().calibration.readout_ns, 7'000'000);
}

}  // namespace
}  // namespace redrive
