// SPDX-License-Identifier: Apache-2.0
// align, train --poses and --align, and the copy of the poses that a run keeps.
#include "redrive/recording/formats/pose_files.h"
#include "redrive/train/run.h"
#include "tests/e2e/end_to_end.h"

namespace redrive::testing {
namespace {

using ::testing::HasSubstr;

// The drive has no texture to track and no LiDAR.
TEST_F(EndToEnd, AlignSaysWhyItFails) {
  const fs::path out = folder_ / "aligned";
  ProgramResult ended = redrive({"align", drive_.string(), "--out", out.string()});
  EXPECT_EQ(ended.exit_code, kExitInsufficientData) << ended.err;
  EXPECT_THAT(ended.err, HasSubstr("cannot be aligned: too few observations"));
  EXPECT_THAT(ended.err, HasSubstr("4 frames"));
  EXPECT_FALSE(fs::exists(out));
  ended = redrive(train_arguments(folder_ / "run", {"--align"}));
  EXPECT_EQ(ended.exit_code, kExitInsufficientData) << ended.err;
  EXPECT_FALSE(fs::exists(folder_ / "run"));
}

TEST_F(EndToEnd, AlignTakesReadoutTimesAsTrainDoes) {
  for (const char* const wrong : {"30ms", "NONE:estimate", "201"}) {
    const ProgramResult ended = redrive(
        {"align", drive_.string(), "--rolling-shutter", std::string("12,estimate,") + wrong});
    EXPECT_EQ(ended.exit_code, kExitUsage) << wrong;
    EXPECT_THAT(ended.err, HasSubstr("--rolling-shutter")) << wrong;
    EXPECT_THAT(ended.err, HasSubstr(wrong));
  }
  const ProgramResult ended =
      redrive({"align", "--rolling-shutter", "12,estimate", drive_.string()});
  EXPECT_EQ(ended.exit_code, kExitInsufficientData) << ended.err << "the folder is no readout";
}

TEST_F(EndToEnd, AlignRejectsWindowsOfFewFrames) {
  const ProgramResult ended = redrive({"align", drive_.string(), "--window", "9"});
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr("--window 9: must be 0 or 10 frames at least"));
}

TEST_F(EndToEnd, TrainKeepsInitialPoses) {
  const fs::path aligned = folder_ / "aligned", run = folder_ / "run";
  write_pose_files(aligned, read_pose_files(open_recording(drive_), drive_));
  edit_json(tiny_egomotion(aligned), [](nlohmann::json& poses) {
    poses["101"]["RT_ECEF_body"][2][3] = poses["101"]["RT_ECEF_body"][2][3].get<double>() + 0.125;
  });
  edit_json(tiny_calibration(aligned), [](nlohmann::json& sensors) {
    sensors[kTinyLeft]["time_offset_s"] = -0.012;
    sensors[kTinyLeft]["readout_s"] = 0.02;
  });
  trained("run", 4, {"--poses", aligned.string()});
  fs::remove_all(aligned);
  const auto opened = open_run(run);
  const Recording own = open_recording(drive_);
  EXPECT_NEAR(opened.recording.frames[1].global_from_body.translation().z() -
                  own.frames[1].global_from_body.translation().z(),
              0.125, 1e-9);
  EXPECT_EQ(opened.recording.find_camera(kTinyLeft)->calibration.time_offset_ns, -12'000'000);
  EXPECT_EQ(opened.recording.find_camera(kTinyLeft)->calibration.readout_ns, 20'000'000);
  EXPECT_EQ(redrive({"eval", run.string(), "--max-images", "1"}).exit_code, kExitOk);
  EXPECT_EQ(redrive({"resume", run.string(), "--max-steps", "6"}).exit_code, kExitOk);
  fs::remove_all(run / "poses");
  const ProgramResult ended = redrive({"eval", run.string()});
  EXPECT_EQ(ended.exit_code, kExitBadInput);
  EXPECT_THAT(ended.err, HasSubstr("poses"));
}

TEST_F(EndToEnd, RefusesTwoSourcesOfPoses) {
  ProgramResult ended =
      redrive(train_arguments(folder_ / "run", {"--poses", drive_.string(), "--align"}));
  EXPECT_EQ(ended.exit_code, kExitUsage);
  EXPECT_THAT(ended.err, HasSubstr("exclude each other"));
  ended = redrive(train_arguments(folder_ / "run", {"--poses", (folder_ / "nothing").string()}));
  EXPECT_EQ(ended.exit_code, kExitBadInput);
  EXPECT_FALSE(fs::exists(folder_ / "run"));
}

}  // namespace
}  // namespace redrive::testing
